"""The file is sound by MCAP's own rules, whoever wrote into it; records are numbered without a gap."""

from __future__ import annotations

import contextvars
import hashlib
import threading
import zlib
from collections import Counter
from io import BytesIO
from typing import TYPE_CHECKING

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Footer,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader, breakup_chunk

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder import RecordingError
from recorder.records import Event, Keyframe, Mutation, Run, Task
from recorder.tracing import journal
from recorder.tracing.span import span

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.records import Record
    from recorder.records.asset import AssetFile


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
    messages = [record for record in content if isinstance(record, Message)]
    (statistics,) = [record for record in content if isinstance(record, Statistics)]
    assert statistics.message_count == len(messages)
    assert statistics.channel_message_counts == Counter(message.channel_id for message in messages)
    times = [message.log_time for message in messages]
    assert times == sorted(times)
    assert (statistics.message_start_time, statistics.message_end_time) == (times[0], times[-1])
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        topics = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        names = [attachment.name for attachment in reader.iter_attachments()]
    assert set(topics) == {"/run", "/mutation", "/tf", "/log"}
    assert topics["/run"] == 2
    assert len(names) == len(set(names)) == statistics.attachment_count
    assert any(name.endswith("/bowl.urdf") for name in names)


def at(content: bytes, offset: int) -> object:
    """The record of the container at an offset of the file."""
    stream = BytesIO(content[offset:])
    return next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)


def test_every_offset_leads_to_what_it_says(tmp_path: Path) -> None:
    """What the format's own ``mcap doctor`` looks at: indexes, their offsets and sums, and the summary's groups."""
    file = tmp_path / "x.mcap"
    record_something(file)
    content = file.read_bytes()
    with file.open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    footer = records[-1]
    assert isinstance(footer, Footer)
    assert zlib.crc32(content[footer.summary_start : -len(b"\x89MCAP0\r\n") - 4]) == footer.summary_crc
    channels = {record.id for record in records if isinstance(record, Channel)}
    chunks = [record for record in records if isinstance(record, ChunkIndex)]
    assert len(chunks) == len([record for record in records if isinstance(record, Chunk)]) > 1
    for index in chunks:
        chunk = at(content, index.chunk_start_offset)
        assert isinstance(chunk, Chunk)
        assert len(chunk.data) == index.compressed_size
        inside = zstandard.decompress(chunk.data, index.uncompressed_size)
        assert zlib.crc32(inside) == chunk.uncompressed_crc
        assert set(index.message_index_offsets) <= channels
        times = []
        for channel, offset in index.message_index_offsets.items():
            entries = at(content, offset)
            assert isinstance(entries, MessageIndex)
            assert entries.channel_id == channel
            for time_ns, place in entries.records:
                message = at(inside, place)
                assert isinstance(message, Message)
                assert (message.channel_id, message.log_time) == (channel, time_ns)
                times.append(time_ns)
        if times:
            assert (min(times), max(times)) == (index.message_start_time, index.message_end_time)
            assert len(times) == len([record for record in breakup_chunk(chunk) if isinstance(record, Message)])
    for index in records:
        if isinstance(index, AttachmentIndex):
            attachment = at(content, index.offset)
            assert isinstance(attachment, Attachment)
            assert (attachment.name, len(attachment.data)) == (index.name, index.data_size)
            assert hashlib.sha256(attachment.data).hexdigest() == attachment.name.partition("/")[0]
        elif isinstance(index, MetadataIndex):
            metadata = at(content, index.offset)
            assert isinstance(metadata, Metadata)
            assert metadata.name == index.name
        elif isinstance(index, SummaryOffset):
            assert content[index.group_start] == index.group_opcode
    groups = [record for record in records if isinstance(record, SummaryOffset)]
    assert sum(group.group_length for group in groups) == footer.summary_offset_start - footer.summary_start


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


def test_a_recording_that_begins_late_begins_each_world_with_its_keyframe(tmp_path: Path) -> None:
    """Another thread changes a world while its recording begins: what came before its keyframe is part of that."""
    file = tmp_path / "x.mcap"
    with BulletWorld() as world, BulletWorld():
        cup = Object("cup", "cup", "cup.stl", world=world)
        stop, changed = threading.Event(), threading.Semaphore(0)

        def change() -> None:
            count = 0
            while not stop.is_set():
                count += 1
                cup.set_position([count, 0, 1])
                changed.release()

        thread = threading.Thread(target=change)
        thread.start()
        try:
            for _ in range(10):
                with recorder.record(file):
                    while changed.acquire(blocking=False):
                        pass
                    for _ in range(20):
                        changed.acquire()
                with replay.open(file) as log:
                    kinds = [type(record) for record in log if record.world == world.name]
                    assert kinds[0] is Keyframe
                    assert kinds.count(Mutation) >= 10
                    assert [record.seq for record in log] == list(range(len(log)))
        finally:
            stop.set()
            thread.join()


def test_a_clock_that_goes_back_doesn_t_take_the_log_with_it() -> None:
    clock = iter([50, 40, 60, 10])
    sink = Times()
    log = journal.Journal([sink], clock_ns=lambda: next(clock))
    for _ in range(4):
        log.append(Event(name="tick"))
    assert sink.times == [50, 50, 60, 60]


class Times:
    def __init__(self) -> None:
        self.times: list[int] = []

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self.times.append(record.wall_time_ns)

    def attach(self, asset: AssetFile) -> None:
        pass

    def close(self) -> None:
        pass


def test_tasks_keep_their_parent_across_threads(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"

    def work() -> None:
        with span("motion", "inner"):
            journal.emit(Event(name="inside"))

    with recorder.record(file), span("plan", "outer"):
        thread = threading.Thread(target=contextvars.copy_context().run, args=(work,))
        thread.start()
        thread.join()
    with replay.open(file) as log:
        outer, inner, *_ = log.records(Task)
        (event,) = log.records(Event)
        assert (inner.parent, event.task) == (outer.task, inner.task)
        assert inner.thread != outer.thread


def test_a_full_disk_is_an_error_at_once(tmp_path: Path) -> None:
    full = tmp_path / "full.mcap"
    full.symlink_to("/dev/full")
    ran = []
    with pytest.raises(recorder.RecordingError, match="No space left"), recorder.record(full):
        ran.append(True)
    assert not ran


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


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"path": None}, "no path"),
        ({"path": "a\0b"}, "no path"),
        ({"name": 5}, "name is 5"),
        ({"live": 5}, "live is 5"),
        ({"arguments": None}, "arguments are None"),
        ({"source": "nowhere.py"}, "no source"),
    ],
)
def test_what_can_t_be_recorded_to_is_refused(tmp_path: Path, arguments: dict[str, object], told: str) -> None:
    file = tmp_path / "x.mcap"
    with pytest.raises(RecordingError, match=told), recorder.record(**{"path": file, **arguments}):
        pass
    assert not file.exists()
