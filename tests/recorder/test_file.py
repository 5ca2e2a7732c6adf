"""The file is sound by MCAP's own rules, whoever wrote into it; records are numbered without a gap."""

from __future__ import annotations

import threading
from collections import Counter
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex, Message, Statistics
from mcap.stream_reader import StreamReader

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder import journal
from recorder.records import Event, Run, Task
from recorder.span import span

if TYPE_CHECKING:
    from pathlib import Path


def record_something(file: Path) -> None:
    with recorder.record(file), BulletWorld() as world:
        Object("floor", "environment", "plane.urdf")
        Object("bowl", "bowl", "bowl.stl", [0, 0, 0.3])
        world.set_gravity([0, 0, -9.8])
        world.simulate(1.0)


def test_by_the_format_s_own_reader_everything_agrees(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    record_something(file)
    with file.open("rb") as stream:
        content = list(StreamReader(stream, validate_crcs=True, emit_chunks=False).records)
    with file.open("rb") as stream:
        chunks = [r for r in StreamReader(stream, emit_chunks=True, validate_crcs=True).records if isinstance(r, Chunk)]
    messages = [record for record in content if isinstance(record, Message)]
    (statistics,) = [record for record in content if isinstance(record, Statistics)]
    assert statistics.message_count == len(messages)
    assert statistics.channel_message_counts == Counter(message.channel_id for message in messages)
    assert statistics.chunk_count == len(chunks) == len([r for r in content if isinstance(r, ChunkIndex)])
    times = [message.log_time for message in messages]
    assert times == sorted(times)
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        topics = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        names = [attachment.name for attachment in reader.iter_attachments()]
    assert set(topics) == {"/run", "/mutation", "/tf", "/log"}
    assert topics["/run"] == 2
    assert len(names) == len(set(names))
    assert any(name.endswith("/bowl.urdf") for name in names)


def test_eight_threads_leave_no_gap_and_no_disorder(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"

    def work(number: int) -> None:
        for count in range(500):
            journal.emit(Event(name="tick", sender=f"{number}/{count}"))

    with recorder.record(file):
        threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    with replay.open(file) as log:
        assert [record.seq for record in log] == list(range(4002))
        for number in range(8):
            mine = [r.sender for r in log.records(Event) if r.sender.startswith(f"{number}/")]
            assert mine == [f"{number}/{count}" for count in range(500)]


def test_failures_and_nesting_are_recorded_and_pass_on(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with pytest.raises(KeyError, match="gone"), recorder.record(file, name="broken"):
        run_tasks()
    with replay.open(file) as log:
        assert log.complete
        outer, inner, inner_end, outer_end = log.records(Task)
        assert (outer.parent, inner.parent) == (0, outer.task)
        assert inner_end.failure.type == outer_end.failure.type == "KeyError"
        assert "run_tasks" in inner_end.failure.traceback
        assert outer.source_file.endswith("test_file.py")
        end = log[-1]
        assert isinstance(end, Run)
        assert not end.succeeded


def run_tasks() -> None:
    with span("plan", "outer"), span("motion", "inner", {"target": [1, 2, 3]}):
        raise KeyError("gone")


def test_what_is_no_recording_is_never_overwritten(tmp_path: Path) -> None:
    precious = tmp_path / "thesis.txt"
    precious.write_text("years of work")
    with pytest.raises(recorder.RecordingError, match="no recording"), recorder.record(precious):
        pass
    assert precious.read_text() == "years of work"
    file = tmp_path / "x.mcap"
    with recorder.record(file):
        with pytest.raises(recorder.RecordingError, match="another recording"), recorder.record(file):
            pass
        with recorder.record(tmp_path / "y.mcap") as second:
            journal.emit(Event(name="both"))
        assert second.length == 3
    record_something(file)  # an older recording is replaced
    with replay.open(file) as log:
        assert log.complete


@pytest.mark.parametrize("where", ["nowhere/x.mcap", "."])
def test_where_nothing_can_be_written(tmp_path: Path, where: str) -> None:
    ran = []
    with pytest.raises(recorder.RecordingError, match="can't record"), recorder.record(tmp_path / where):
        ran.append(True)
    assert not ran
