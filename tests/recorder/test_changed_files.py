"""Another program changes the file during a recording: reported at the next chunk and at the end."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import cli
from recorder import RecordingError
from recorder.mcap_sink import McapSink
from recorder.records import Event
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def delete(file: Path) -> None:
    file.unlink()


def replace(file: Path) -> None:
    other = file.with_name("other")
    other.write_bytes(file.read_bytes())
    other.replace(file)


def move(file: Path) -> None:
    file.rename(file.with_name("elsewhere.mcap"))


def truncate(file: Path) -> None:
    os.truncate(file, 100)


def append(file: Path) -> None:
    with file.open("ab") as opened:
        opened.write(b"x")


def go_on(file: Path, change: Callable[[Path], None], steps: list[int]) -> None:
    """Records on after a change, and counts what is taken."""
    change(file)
    for step in range(200):
        journal.emit(Event(name="tick"))
        steps.append(step)


CHANGES = pytest.mark.parametrize(
    ("change", "message"),
    [
        (delete, "deleted"),
        (replace, "replaced"),
        (move, "moved the file away"),
        (truncate, "truncated the file: it has 100 bytes instead of"),
        (append, "written to the file"),
    ],
)


@CHANGES
def test_a_file_that_others_change_is_an_error_at_the_next_chunk(
    tmp_path: Path, change: Callable[[Path], None], message: str
) -> None:
    file = tmp_path / "x.mcap"
    steps: list[int] = []
    with pytest.raises(RecordingError, match=message) as raised, recorder.record(file):
        go_on(file, change, steps)
    assert len(steps) <= 50, "a chunk has 50 records"
    assert raised.value.path == str(file)
    assert "run again" in str(raised.value)


@CHANGES
def test_a_file_that_others_change_last_is_an_error_at_the_end(
    tmp_path: Path, change: Callable[[Path], None], message: str
) -> None:
    file = tmp_path / "x.mcap"
    with pytest.raises(RecordingError, match=message), recorder.record(file):
        change(file)


def test_a_failure_of_the_plan_does_not_hide_that_its_recording_is_gone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, plan = tmp_path / "x.mcap", tmp_path / "plan.py"
    plan.write_text(f"import os\nos.remove({str(file)!r})\nraise ValueError('of the plan')")
    assert cli.main(["run", str(plan), "--log", str(file)]) == 1
    said = capsys.readouterr().err
    assert f"recorder: can't record to {file}: another program has deleted the file" in said
    assert "the plan has an error: ValueError: of the plan" in said
    assert "recorded to" not in said


def test_another_working_directory_is_no_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with recorder.record("x.mcap"):
        (tmp_path / "inner").mkdir()
        os.chdir(tmp_path / "inner")
        journal.emit(Event(name="tick"))
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.complete


def test_a_pipe_that_nobody_reads_is_refused(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(RecordingError, match="without a reader; start its reader first"), recorder.record(pipe):
        pass


def test_a_pipe_that_somebody_reads_gets_the_recording(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with recorder.record(pipe, source=__file__):
        journal.emit(Event(name="tick"))
    with open(reader, "rb") as opened:  # noqa: PTH123  it is open already
        (tmp_path / "x.mcap").write_bytes(opened.read())
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.complete
        assert [record.name for record in log.records(Event)] == ["tick"]


@pytest.mark.parametrize("durable", [False, True])
def test_each_chunk_of_a_durable_recording_waits_for_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, durable: bool
) -> None:
    file = tmp_path / "x.mcap"
    synced: list[int] = []
    sync = os.fdatasync

    def fdatasync(number: int) -> None:
        sync(number)
        synced.append(os.fstat(number).st_size)

    monkeypatch.setattr(os, "fdatasync", fdatasync)
    chunks = []
    with recorder.record(file, durable=durable) as recording:
        for _ in range(3):
            journal.emit(Event(name="tick"))
            recording.journal.flush()
            chunks.append(file.stat().st_size)
    if durable:
        assert set(chunks) < set(synced), "each chunk"
        assert synced[-1] == file.stat().st_size, "and the end"
    else:
        assert not synced


def test_a_disk_that_fails_to_sync_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(number: int) -> None:
        raise OSError(5, "Input/output error")

    sink = McapSink(tmp_path / "x.mcap", {}, durable=True)
    monkeypatch.setattr(os, "fdatasync", fails)
    with pytest.raises(RecordingError, match="Input/output error"):
        sink.close()
