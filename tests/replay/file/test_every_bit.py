"""Whatever bit of a closed recording is turned, and whatever block is overwritten by zeros: it is found, or says nothing.

The file has checksums of all its bytes, which ``info`` and ``verify`` read; other verbs read only what they need, so they
find what is wrong in that.
"""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Keyframe, Mutation
from replay.cli.main import main
from replay.restore.verify import verify
from replay.state.integrity import verify_static
from tests.measures import seeded
from tests.replay.copies import CHUNK, container_records, flipped, zeroed
from tests.replay.hostile import rewritten

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from recorder.records import Record

GOLDEN = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"
VERBS = ("log", "tree", "state 0", "state 60", "state last", "show 9", "diff 9 last", "blame milk", "why", "source")
FLIPS, BLOCKS = 500, 100


class Sound:
    """What verbs say of the sound file."""

    def __init__(self, capsys: pytest.CaptureFixture[str], file: Path) -> None:
        self._capsys = capsys
        self.file = file
        self.content = GOLDEN.read_bytes()
        file.write_bytes(self.content)
        self.said = {verb: self.ask(verb) for verb in VERBS}

    def ask(self, verb: str) -> tuple[int, str]:
        name, *rest = verb.split()
        code = main([name, str(self.file), *rest, "--json"])
        return code, self._capsys.readouterr().out

    def check(self, content: bytes, verb: str, place: str) -> None:
        """Checks that a damaged copy is called so by all that check all of it, and that no verb is wrong about it."""
        self.file.write_bytes(content)
        for judge in ("info", "verify --static"):
            code, said = self.ask(judge)
            assert code == 3, (place, judge, said)
        code, said = self.ask(verb)
        assert code == 3 or (code, said) == self.said[verb], (place, verb, code)


@pytest.fixture
def sound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Sound:
    return Sound(capsys, tmp_path / "x.mcap")


def changed(content: bytes, seeds: range) -> Iterator[tuple[bytes, str]]:
    """Copies with one bit turned, and, one in six, with a block of zeros; and where."""
    for seed in seeds:
        rng = random.Random(seed)
        if seed % 6:
            bit = rng.randrange(8 * len(content))
            yield flipped(content, bit), f"bit {bit}"
        else:
            start, length = rng.randrange(len(content)), rng.choice((1, 16, 512, 4096))
            while not any(content[start : start + length]):  # else nothing is changed
                start = rng.randrange(len(content))
            yield zeroed(content, start, min(start + length, len(content))), f"zeros at {start}, {length}"


@seeded("changed bits and zeroed blocks", range(FLIPS + BLOCKS), 60)
def test_every_changed_bit_and_zeroed_block_is_found(
    sound: Sound, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    for seed, (content, place) in zip(seeds, changed(sound.content, seeds), strict=True):
        sound.check(content, VERBS[seed % len(VERBS)], f"seed {seed}: {place}")
    record_property("copies", len(seeds))


@pytest.mark.slow
def test_a_zeroed_chunk_is_damage_to_every_verb_that_reads_it(sound: Sound) -> None:
    """What a power cut leaves, in each of the file's chunks, one after the other."""
    with replay.open(sound.file) as log:
        steps = range(len(log))
        keyframe = next(record.seq for record in log.backwards(-1, Keyframe))
    chunks = [(start, end) for opcode, start, end in container_records(sound.content) if opcode == CHUNK]
    for start, end in chunks[1:]:  # the first one has definitions only, which the index has too
        sound.file.write_bytes(zeroed(sound.content, start, end))
        assert sound.ask("log")[0] == 3
        with replay.open(sound.file) as log:
            lost = set(steps) - {record.seq for record in log}
            assert lost
            assert not log.complete
            if min(lost):
                assert not log.state_at(min(lost) - 1).uncertainty
            if max(lost) > keyframe and max(lost) < len(log):
                assert str(min(lost)) in log.state_at("last").uncertainty


def test_a_zeroed_chunk_is_found_at_its_step(sound: Sound) -> None:
    """In each of the chunks that have records; behind the last records, nothing tells how many there were."""
    with replay.open(sound.file) as log:
        steps = set(range(len(log)))
    chunks = [(start, end) for opcode, start, end in container_records(sound.content) if opcode == CHUNK]
    for start, end in chunks[1:]:
        sound.file.write_bytes(zeroed(sound.content, start, end))
        with replay.open(sound.file) as log:
            first = min(steps - {record.seq for record in log})
            verdict = verify_static(log) if end != chunks[-1][1] else verify(log)
        assert not verdict.sound
        assert "damaged" in verdict.damage
        assert (verdict.steps if verdict.problem is None else verdict.problem.step) == first


def test_a_recording_that_is_damaged_and_differs_is_damaged(sound: Sound) -> None:
    """Where a record differs, nothing is made again behind it; what is damaged there is told all the same."""

    def change(records: list[Record], _: dict[str, bytes]) -> None:
        moved = next(record for record in records if isinstance(record, Mutation) and record.HasField("move_body"))
        moved.effect.bodies[0].position[0] += 1

    different = rewritten(GOLDEN, sound.file, change).read_bytes()
    assert sound.ask("verify")[0] == 1
    start, end = next((a, b) for code, a, b in container_records(different)[::-1] if code == CHUNK)
    sound.file.write_bytes(zeroed(different, start, end))
    code, said = sound.ask("verify")
    verdict = json.loads(said)
    assert code == 3
    assert verdict["damage"]
    assert "another effect" in verdict["problem"]["cause"]


@pytest.mark.parametrize("name", ["opcode", "length", "times", "size", "checksum", "compression", "data"])
def test_a_chunk_is_held_against_the_index(sound: Sound, name: str) -> None:
    """What a chunk says of itself stands in the index, too; what only its head has wrong is read all the same."""
    chunk, _ = [(a, b) for code, a, b in container_records(sound.content) if code == CHUNK][4]
    offset = {"opcode": 0, "length": 1, "times": 9, "size": 25, "checksum": 33, "compression": 41, "data": 60}[name]
    sound.file.write_bytes(flipped(sound.content, 8 * (chunk + offset)))
    code, said = sound.ask("log")
    assert code == 3
    assert (said == sound.said["log"][1]) == (name not in ("checksum", "data"))
