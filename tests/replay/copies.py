"""Copies of recordings: as other programs write them, and as damage leaves them."""

from __future__ import annotations

import random
import struct
from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = 8
CHUNK, ATTACHMENT, METADATA = int(Opcode.CHUNK), int(Opcode.ATTACHMENT), int(Opcode.METADATA)


def rewritten_by_mcap(
    source: Path,
    target: Path,
    *,
    by_topic: bool = False,
    other_ids: bool = False,
    bare_channels: bool = False,
    numbered: bool = True,
    **options: Any,
) -> Path:
    """Copies a recording with the writer of the ``mcap`` library, whose options are given.

    Args:
        source: the recording.
        target: the copy.
        by_topic: one topic's messages after the other's.
        other_ids: with other numbers of channels, defined in another order.
        bare_channels: without the metadata of channels.
        numbered: with the messages' numbers.
        options: of the writer.
    """
    with source.open("rb") as stream, target.open("wb") as output:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        writer = Writer(output, **options)
        writer.start()
        channels = sorted(summary.channels.values(), key=lambda channel: channel.id)
        if other_ids:
            random.Random(1).shuffle(channels)
        schemas, ids = {}, {}
        for channel in channels:
            schema = summary.schemas[channel.schema_id]
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            metadata = {} if bare_channels else channel.metadata
            ids[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id], metadata
            )
        for metadata_record in reader.iter_metadata():
            writer.add_metadata(metadata_record.name, metadata_record.metadata)
        for file in reader.iter_attachments():
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        messages = [(ids[channel.id], message) for _, channel, message in reader.iter_messages()]
        if by_topic:
            messages.sort(key=lambda each: each[0])
        for channel_id, message in messages:
            number = message.sequence if numbered else 0
            writer.add_message(channel_id, message.log_time, message.data, message.publish_time, number)
        writer.finish()
    return target


def container_records(content: bytes, last: Opcode = Opcode.DATA_END) -> list[tuple[int, int, int]]:
    """Opcode, start and end of each record of the container, up to the first of a kind: the end of the data."""
    extents = []
    at = MAGIC
    while at + 9 <= len(content):
        opcode, length = struct.unpack_from("<BQ", content, at)
        extents.append((opcode, at, at + 9 + length))
        at += 9 + length
        if opcode == last:
            break
    return extents


def zeroed(content: bytes, start: int, end: int) -> bytes:
    """The content with a block overwritten by zeros, as a power cut leaves it."""
    return content[:start] + bytes(end - start) + content[end:]


def flipped(content: bytes, bit: int) -> bytes:
    """The content with one bit turned."""
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)
