"""The file follows MCAP's own rules."""

from __future__ import annotations

import hashlib
import zlib
from collections import Counter
from io import BytesIO
from typing import TYPE_CHECKING

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
from recorder.mcap_writer import FREE, MAX_RATIO
from recorder.records import Task
from recorder.tracing.span import span

if TYPE_CHECKING:
    from pathlib import Path


def record_something(file: Path) -> None:
    with recorder.record(file), BulletWorld() as world:
        Object("floor", "environment", "plane.urdf")
        Object("bowl", "bowl", "bowl.stl", [0, 0, 0.3])
        world.set_gravity([0, 0, -9.8])
        world.simulate(1.0)


def test_messages_and_attachments_agree_with_the_statistics(tmp_path: Path) -> None:
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


def test_what_is_alike_inflates_to_no_more_than_readers_take(tmp_path: Path) -> None:
    """Costmaps of zeros take 20 times as much as the bound on what readers inflate, if all chunks are compressed."""
    file = tmp_path / "x.mcap"
    costmap = [[0.0] * 200 for _ in range(200)]
    with recorder.record(file):
        for _ in range(80):
            with span("action", "looking at the map", {"costmap": costmap}):
                pass
    with file.open("rb") as stream:
        chunks = [each for each in StreamReader(stream, emit_chunks=True).records if isinstance(each, Chunk)]
    inflated = sum(chunk.uncompressed_size for chunk in chunks)
    assert inflated > 2 * FREE
    assert inflated <= MAX_RATIO * file.stat().st_size
    assert file.stat().st_size < inflated / 8  # most are compressed
    with replay.open(file) as log:
        assert log.complete
        assert len(log) == 162
        assert sum(record.phase == Task.FINISHED for record in log.records(Task)) == 80


def record_at(content: bytes, offset: int) -> object:
    """The container's record at an offset."""
    stream = BytesIO(content[offset:])
    return next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)


def test_every_index_leads_to_its_record(tmp_path: Path) -> None:
    """What the format's own ``mcap doctor`` checks: indexes, offsets, sums, and the summary's groups."""
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
        chunk = record_at(content, index.chunk_start_offset)
        assert isinstance(chunk, Chunk)
        assert len(chunk.data) == index.compressed_size
        inside = zstandard.decompress(chunk.data, index.uncompressed_size)
        assert zlib.crc32(inside) == chunk.uncompressed_crc
        assert set(index.message_index_offsets) <= channels
        times = []
        for channel, offset in index.message_index_offsets.items():
            entries = record_at(content, offset)
            assert isinstance(entries, MessageIndex)
            assert entries.channel_id == channel
            for time_ns, offset_in_chunk in entries.records:
                message = record_at(inside, offset_in_chunk)
                assert isinstance(message, Message)
                assert (message.channel_id, message.log_time) == (channel, time_ns)
                times.append(time_ns)
        if times:
            assert (min(times), max(times)) == (index.message_start_time, index.message_end_time)
            assert len(times) == len([record for record in breakup_chunk(chunk) if isinstance(record, Message)])
    for index in records:
        if isinstance(index, AttachmentIndex):
            attachment = record_at(content, index.offset)
            assert isinstance(attachment, Attachment)
            assert (attachment.name, len(attachment.data)) == (index.name, index.data_size)
            assert hashlib.sha256(attachment.data).hexdigest() == attachment.name.partition("/")[0]
        elif isinstance(index, MetadataIndex):
            metadata = record_at(content, index.offset)
            assert isinstance(metadata, Metadata)
            assert metadata.name == index.name
        elif isinstance(index, SummaryOffset):
            assert content[index.group_start] == index.group_opcode
    groups = [record for record in records if isinstance(record, SummaryOffset)]
    assert sum(group.group_length for group in groups) == footer.summary_offset_start - footer.summary_start
