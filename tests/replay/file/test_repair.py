"""``repair``: whatever can be read of a recording becomes a sound one, and what is lost is said, now and later."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

import recorder
import replay
from replay.cli.main import main
from replay.restore.verify import verify
from tests.measures import seeded
from tests.replay.copies import ATTACHMENT, CHUNK, container_records, flipped, zeroed
from tests.replay.doctor import diagnosis

if TYPE_CHECKING:
    from collections.abc import Callable

GOLDEN = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"

#: Moves a cup until it is killed, in tasks and without.
VICTIM = """
import sys
import recorder
from pycram.bullet_world import BulletWorld, Object
from recorder.tracing.span import span
with recorder.record(sys.argv[1]), BulletWorld(name="table") as world:
    cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
    for number in range(100_000):
        print(number, flush=True)
        with span("motion", "lift", {"number": number}):
            cup.set_position([0, 0, 1 + number % 7])
        if number % 5 == 0:
            world.simulate(0.02)
"""


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """A recording with a zeroed chunk in its middle, and a damaged attached file."""
    content = GOLDEN.read_bytes()
    extents = container_records(content)
    chunks = [(start, end) for opcode, start, end in extents if opcode == CHUNK]
    content = zeroed(content, *chunks[8])
    start, end = next(
        (a, b) for opcode, a, b in extents if opcode == ATTACHMENT and b"carton.stl" in content[a : a + 130]
    )
    file = tmp_path / "damaged.mcap"
    file.write_bytes(flipped(content, 4 * (start + end)))
    return file


def sums_and_indexes(file: Path) -> list[int]:
    """The numbers of all messages, read by the library with and without the index, checksums compared."""
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        indexed = [message.sequence for _, _, message in reader.iter_messages()]
        assert list(reader.iter_metadata())
    with file.open("rb") as stream:
        streamed = [
            each.sequence
            for each in StreamReader(stream, validate_crcs=True, emit_chunks=False).records
            if type(each).__name__ == "Message"
        ]
    assert sorted(indexed) == sorted(streamed)
    return indexed


def test_a_damaged_recording_becomes_a_sound_one(
    damaged: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", str(damaged)]) == 3
    readable = capsys.readouterr().out
    before = damaged.read_bytes()
    assert main(["repair", str(damaged)]) == 3
    said = capsys.readouterr()
    copy = tmp_path / "damaged.sound.mcap"
    assert said.out.splitlines()[:3] == [
        f"{copy}: 128 records, 5 attached files",
        "lost   steps 123-140",
        "lost   chunk 8: its checksum is missing",
    ]
    assert "lost   the attached file" in said.out
    assert "carton.stl: its checksum differs" in said.out
    assert damaged.read_bytes() == before
    assert sums_and_indexes(copy)
    with replay.open(damaged) as old, replay.open(copy) as new:
        assert list(old) == list(new)
        assert not new.damage
        assert new.lost_before == (range(123, 141),)
        assert new.problems == "steps 123-140 were lost before it was repaired"
        with pytest.raises(replay.Damaged, match="step 130"):
            _ = new[130]
        assert "123-140" in new.state_at("last").uncertainty
    assert main(["log", str(copy)]) == 3, "an answer may lack what is lost"
    assert capsys.readouterr().out == readable


@pytest.mark.slow
def test_what_is_left_of_a_repaired_recording_verifies(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Behind what is lost, a world goes on from its next keyframe."""
    content = GOLDEN.read_bytes()
    chunks = [(start, end) for opcode, start, end in container_records(content) if opcode == CHUNK]
    for number in range(3, len(chunks)):
        file = tmp_path / f"{number}.mcap"
        file.write_bytes(zeroed(content, *chunks[number]))
        assert main(["repair", str(file)]) == 3
        with replay.open(tmp_path / f"{number}.sound.mcap") as log:
            verdict = verify(log)
            assert log.check_file() == verdict.incomplete
        assert verdict.sound, (number, verdict)
        assert "were lost before it was repaired" in verdict.incomplete
    capfd.readouterr()
    assert main(["verify", str(tmp_path / "5.sound.mcap")]) == 3
    assert capfd.readouterr().out.startswith("sound  129 steps, up to the last record: steps ")


def test_a_sound_recording_is_copied_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "copy.mcap"
    assert main(["repair", str(GOLDEN), "-o", str(copy), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["records"], said["files"], said["steps"], said["chunks"]) == (146, 6, [], {})
    assert sums_and_indexes(copy) == sums_and_indexes(GOLDEN)
    with replay.open(copy) as log, replay.open(GOLDEN) as original:
        assert list(log) == list(original)
        assert dict(log.assets) == dict(original.assets)
        assert log.complete
        assert verify(log).exact


def test_nothing_is_overwritten_without_saying_so(
    damaged: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other, notes = tmp_path / "other.mcap", tmp_path / "notes.mcap"
    other.write_bytes(GOLDEN.read_bytes())
    notes.write_text("my notes")

    def refused(target: Path, *options: str) -> str:
        before = target.read_bytes()
        assert main(["repair", str(damaged), "-o", str(target), *options]) == 2
        assert target.read_bytes() == before
        return capsys.readouterr().err

    assert "exists; name another file, or add --overwrite" in refused(other)
    assert "isn't a recording" in refused(notes, "--overwrite")
    assert "is the recording itself" in refused(damaged, "--overwrite")
    assert main(["repair", str(damaged), "-o", str(other), "--overwrite"]) == 3
    assert f"{other} already existed; the copy replaces it" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.part"))
    with recorder.record(tmp_path / "running.mcap"):
        assert main(["repair", str(tmp_path / "running.mcap")]) == 3
    assert "still being written" in capsys.readouterr().err


@seeded("killed and repaired", range(50), 10, always=0)
def test_killed_recordings_are_repaired(
    tmp_path: Path, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    for seed in seeds:
        check_killed(tmp_path / f"{seed}.mcap", random.Random(seed))
    record_property("recordings", len(seeds))


@pytest.mark.slow
def test_a_killed_recording_is_repaired(tmp_path: Path) -> None:
    for seed in (100, 101):
        check_killed(tmp_path / f"{seed}.mcap", random.Random(seed))


def check_killed(file: Path, rng: random.Random) -> None:
    """Kills a plan after a number of its motions that is drawn; what is left of it is repaired, and verifies."""
    victim = subprocess.Popen([sys.executable, "-c", VICTIM, str(file)], stdout=subprocess.PIPE)
    assert victim.stdout is not None
    for _ in range(rng.randrange(1, 400)):
        assert victim.stdout.readline()
    victim.kill()
    victim.wait()
    victim.stdout.close()
    copy = file.with_suffix(".sound.mcap")
    assert main(["repair", str(file), "-o", str(copy)]) == 3
    assert sums_and_indexes(copy)
    assert diagnosis(copy) == []
    with replay.open(file) as log, replay.open(copy) as repaired:
        assert list(log) == list(repaired)
        assert repaired.complete
        verdict = verify(repaired)
    assert verdict.exact, verdict
    assert main(["verify", "--static", str(copy)]) == 0
