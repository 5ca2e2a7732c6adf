"""Damaged copies: no traceback, no hang, what can be read is delivered, and the exit code says that it isn't all."""

from __future__ import annotations

import json
import os
import random
import re
import time
from pathlib import Path

import pytest
from mcap.writer import Writer

import replay
from replay.cli.main import main
from tests.measures import seeded
from tests.replay.copies import CHUNK, container_records, zeroed

GOLDEN = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"
VERBS = (
    ("info",),
    ("log",),
    ("tree",),
    ("show", "9"),
    ("state", "last"),
    ("diff", "9", "last"),
    ("blame", "milk"),
    ("why",),
)
KINDS = ("cut", "flip", "remove", "overwrite", "empty", "rename")
MAGIC = 8
PATIENCE = 10.0  # s; a hundred times what a verb takes


def steps_by_chunk(file: Path) -> list[tuple[int, int, list[int]]]:
    """Start and end of each chunk, and the steps in it."""
    content = file.read_bytes()
    chunks = [(start, end) for opcode, start, end in container_records(content) if opcode == CHUNK]
    with replay.open(file) as log:
        return [
            (start, end, [record.seq for record in log._chunks.records(number)])
            for number, (start, end) in enumerate(chunks)
        ]


class Damager:
    """Makes damaged copies of a recording."""

    def __init__(self, file: Path, seed: int) -> None:
        self.content = file.read_bytes()
        self.chunks = steps_by_chunk(file)
        self.rng = random.Random(seed)

    def cut(self) -> tuple[bytes, set[int]]:
        at = self.rng.randrange(len(self.content))
        return self.content[:at], {step for _, end, steps in self.chunks if end <= at for step in steps}

    def flip(self) -> tuple[bytes, set[int]]:
        damaged = bytearray(self.content)
        at = self.rng.choice((self.rng.randrange(len(damaged)), self.rng.randrange(MAGIC)))
        damaged[at] ^= 1 << self.rng.randrange(8)
        return bytes(damaged), {s for start, end, steps in self.chunks if not start <= at < end for s in steps}

    def remove(self) -> tuple[bytes, set[int]]:
        """Takes a chunk out; nothing else is changed, so that the index points to wrong places."""
        gone = self.rng.randrange(len(self.chunks))
        start, end, _ = self.chunks[gone]
        kept = {step for number, (_, _, steps) in enumerate(self.chunks) if number != gone for step in steps}
        return self.content[:start] + self.content[end:], kept

    def overwrite(self) -> tuple[bytes, set[int]]:
        at, length = self.rng.randrange(MAGIC, len(self.content)), self.rng.randrange(1, 2000)
        noise = self.rng.randbytes(length)
        damaged = (self.content[:at] + noise + self.content[at + length :])[: len(self.content)]
        return damaged, {s for start, end, steps in self.chunks if end <= at or start >= at + length for s in steps}

    def empty(self) -> tuple[bytes, set[int]]:
        return self.content[: self.rng.randrange(MAGIC)], set()

    def rename(self) -> tuple[bytes, set[int]]:
        """Another release's message types, wherever they aren't compressed."""
        return self.content.replace(b"pycram.log.v1.", b"pycram.log.v9."), set()


def look(file: Path, capsys: pytest.CaptureFixture[str]) -> set[int]:
    """Runs every verb; returns the steps that were delivered."""
    delivered: set[int] = set()
    for verb, *rest in VERBS:
        start = time.monotonic()
        code = main([verb, str(file), *rest, "--json"])
        output = capsys.readouterr()
        assert time.monotonic() - start < PATIENCE, (verb, "hangs")
        assert "Traceback" not in output.err
        assert code in ((3,) if verb == "info" else (0, 3)), (verb, code, output.err)
        if code == 3:
            assert output.err.startswith("pycram-replay: ")
        for line in output.out.splitlines():
            data = json.loads(line)
            if verb == "log":
                delivered.add(data["step"])
    return delivered


def check(
    file: Path, original: dict[int, bytes], kind: str, damager: Damager, capsys: pytest.CaptureFixture[str]
) -> None:
    content, readable = getattr(damager, kind)()
    file.write_bytes(content)
    delivered = look(file, capsys)
    assert delivered >= readable
    if delivered:
        with replay.open(file) as log:
            for record in log:
                assert record.SerializeToString() == original[record.seq]


def originals(file: Path) -> dict[int, bytes]:
    with replay.open(file) as log:
        return {record.seq: record.SerializeToString() for record in log}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_copies_give_their_readable_part(
    small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    damager = Damager(small_log, 1)
    original = originals(small_log)
    for _ in range(3):
        check(tmp_path / "x.mcap", original, kind, damager, capsys)


@seeded("damaged copies", range(500), 10)
def test_500_damaged_copies(small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], seeds: range) -> None:
    original = originals(small_log)
    damager = Damager(small_log, seeds[0])
    for number in seeds:
        check(tmp_path / "x.mcap", original, KINDS[number % len(KINDS)], damager, capsys)


def test_empty_and_foreign_files_are_reported_as_such(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.mcap"

    def complaint(code: int = 2) -> str:
        assert main(["info", str(file)]) == code
        output = capsys.readouterr()
        assert not output.out
        return output.err

    assert "No such file" in complaint()
    file.write_bytes(b"")
    assert "is empty" in complaint(3)
    file.write_bytes(b"\x89MCAP")
    assert "cut off within its first bytes" in complaint(3)
    file.write_bytes(b"hello")
    assert "isn't an MCAP file" in complaint()
    with file.open("wb") as stream:
        foreign(stream, "sensor_msgs/Image")
    assert "not a recording of PyCRAM" in complaint()
    with file.open("wb") as stream:
        foreign(stream, "pycram.log.v9.Mutation")
    assert "whose recordings this release can't read" in complaint(3)
    file.unlink()
    file.mkdir()
    assert "folder without recordings" in complaint()
    file.rmdir()
    os.mkfifo(file)
    assert "isn't a regular file" in complaint()


def test_damaged_magic_bytes_lose_no_record(
    small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = small_log.read_bytes()
    file = tmp_path / "x.mcap"
    for damaged in (b"\x89MCAP1\r\n" + content[8:8000], b"12345678" + content[8:]):
        file.write_bytes(damaged)
        assert main(["info", str(file)]) == 3
        assert "its first bytes are damaged" in capsys.readouterr().err
    with replay.open(small_log) as log, replay.open(file) as copy:
        assert list(copy) == list(log)


def zeroed_chunks(file: Path, *numbers: int) -> None:
    content = GOLDEN.read_bytes()
    chunks = [(start, end) for opcode, start, end in container_records(content) if opcode == CHUNK]
    for number in numbers:
        content = zeroed(content, *chunks[number])
    file.write_bytes(content)


def test_why_does_not_call_unfinished_what_ended_in_the_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The branch of step 22 ended at 24, its block at 25, and the run at 145."""
    file = tmp_path / "x.mcap"

    def why() -> list[str]:
        assert main(["why", str(file)]) == 3
        return capsys.readouterr().out.splitlines()

    zeroed_chunks(file, 6)
    said = why()
    assert "Unfinished at the end of the recording" not in said
    at = said.index("Unfinished, or finished in a lost record")
    assert said[at + 1].endswith("in par block  [since step 22]")
    zeroed_chunks(file, 8, 9, 10)
    assert why() == ["The end of the recording of plan is lost; the last readable step is 122."]
    assert main(["diff", str(GOLDEN), str(file)]) == 3
    assert "the second lost its end" in capsys.readouterr().out
    assert main(["info", str(file)]) == 3
    assert re.search(r"^outcome +lost$", capsys.readouterr().out, re.MULTILINE)
    zeroed_chunks(file, 10)
    with replay.open(file) as log:
        assert log.why().run.outcome == "lost"
        assert not log.why().endless


def test_diff_with_an_unreadable_recording_exits_with_3(
    small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "x.mcap"
    file.write_bytes(b"")
    assert main(["diff", str(small_log), str(file)]) == 3
    assert "is empty" in capsys.readouterr().err


def foreign(stream: object, schema: str) -> None:
    writer = Writer(stream)
    writer.start()
    channel = writer.register_channel("/mutation", "protobuf", writer.register_schema(schema, "protobuf", b""))
    writer.add_message(channel, 0, b"x", 0)
    writer.finish()


def test_a_state_reports_its_uncertainty(tmp_path: Path) -> None:
    """A chunk of changes is lost: states behind it say so, until a keyframe tells all again.

    It is one of the golden recording: where chunks end depends on how fast a plan runs.
    """
    damager = Damager(GOLDEN, 0)
    start, end, steps = max(damager.chunks, key=lambda chunk: len(chunk[2]))
    content = bytearray(damager.content)
    content[(start + end) // 2] ^= 0xFF
    file = tmp_path / "x.mcap"
    file.write_bytes(content)
    with replay.open(file) as log:
        assert f"{steps[0]}-{steps[-1]}" in log.state_at(steps[-1] + 1).uncertainty
        assert not log.state_at(steps[0] - 1).uncertainty
        with pytest.raises(replay.Damaged, match=f"step {steps[1]}"):
            _ = log[steps[1]]
