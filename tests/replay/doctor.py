"""What `mcap doctor` complains of, found by another reader than PyCRAM's: the records are parsed by the ``mcap`` package.

The messages are those of the official tool (foxglove/mcap, ``go/cli/mcap/cmd/doctor.go``), errors and warnings alike;
what stands below :meth:`Doctor.beyond` is by the specification of the format, which that tool doesn't look at (its
successor, ``rust/cli/src/commands/doctor.rs``, does check the sums of data and summary). Where the tool lets something
pass, as fields that nobody knows at a record's end, or stops at once, there is a complaint here.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from typing import TYPE_CHECKING, Any, Final

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from tests.replay.copies import container_records

if TYPE_CHECKING:
    from pathlib import Path

MAGIC: Final = b"\x89MCAP0\r\n"
_HEAD: Final = 9  # bytes of a record before its content
_TYPES: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.MESSAGE: Message,
    Opcode.CHUNK: Chunk,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.DATA_END: DataEnd,
}


def diagnosis(file: Path) -> list[str]:
    """What is wrong with a file; nothing if all is well."""
    doctor = Doctor(file.read_bytes())
    doctor.examine()
    doctor.beyond()
    return doctor.complaints


class Doctor:
    """Examines one file."""

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.complaints: list[str] = []
        self.at: dict[int, tuple[Any, int]] = {}  # records with their end, by where they begin
        self.data: dict[type, dict[int, Any]] = {Schema: {}, Channel: {}}  # defined before the summary, by id
        self.summary: dict[type, dict[int, Any]] = {Schema: {}, Channel: {}}
        self.chunks: dict[int, Counter[int]] = {}  # messages of each channel, by where the chunk begins
        self.times: list[int] = []

    def expect(self, is_so: object, complaint: str) -> None:
        if not is_so:
            self.complaints.append(complaint)

    def all(self, kind: type) -> dict[int, Any]:
        return {at: record for at, (record, _) in self.at.items() if isinstance(record, kind)}

    def parsed(self, opcode: int, content: bytes) -> Any:
        """A record of which each byte is accounted for, else None: the package reads what is there of a cut text."""
        kind = _TYPES[opcode]
        stream = ReadDataStream(io.BytesIO(content[_HEAD:]))
        builder = RecordBuilder()
        try:
            record = kind.read(stream, len(content) - _HEAD) if kind is Message else kind.read(stream)
            record.write(builder)
        except (McapError, UnicodeDecodeError, OverflowError, struct.error) as error:
            self.complaints.append(f"Failed to parse {kind.__name__}: {error!r}")
            return None
        of_fields = len(content) - (4 if kind is Attachment else 0)  # before an attachment's checksum
        if builder.end()[:of_fields] != content[:of_fields]:
            self.complaints.append(f"Failed to parse {kind.__name__}: its fields are shorter or longer than the record")
            return None
        return record

    def container(self) -> None:
        content = self.content
        self.expect(content.startswith(MAGIC) and content.endswith(MAGIC), "Failed to read next token: bad magic")
        for opcode, start, end in container_records(content, Opcode.FOOTER):
            if end > len(content):
                self.complaints.append("Failed to read next token: unexpected EOF")
                break
            known = opcode in _TYPES and opcode != Opcode.MESSAGE
            self.expect(known, f"record at {start} is of the unknown kind {opcode}, or outside of a chunk")
            record = self.parsed(opcode, content[start:end]) if known else None
            if record is not None:
                self.at[start] = record, end
        for at in self.all(Footer):
            self.expect(self.at[at][1] + len(MAGIC) == len(content), "Failed to read next token: more than the footer")

    def examine(self) -> None:
        self.container()
        for kind in (DataEnd, Footer):
            self.expect(self.all(kind), f"File does not contain a {kind.__name__} record")
        indexes: dict[int, dict[int, MessageIndex]] = {}
        chunk = None
        in_summary = False
        for at, (record, _) in self.at.items():
            if isinstance(record, MessageIndex):
                self.expect(chunk is not None, "Message index found but no chunk before it")
                of_chunk = indexes.setdefault(-1 if chunk is None else chunk, {})
                self.expect(record.channel_id not in of_chunk, "Duplicate message index found for channel")
                of_chunk[record.channel_id] = record
                continue
            chunk = at if isinstance(record, Chunk) else None
            in_summary = in_summary or isinstance(record, DataEnd)
            if isinstance(record, Schema | Channel):
                self.define(record, in_summary=in_summary)
            elif isinstance(record, Chunk):
                self.chunk(at, record, self.message_indexes_behind(at))
            elif isinstance(record, Header):
                self.expect(record.library, "Set the Header.library field to a value that identifies the software")
                self.expect(record.profile in ("", "ros1", "ros2"), "Header.profile field is not a well-known profile")
        self.chunk_indexes()
        self.statistics()

    def message_indexes_behind(self, chunk: int) -> dict[int, MessageIndex]:
        found = {}
        at = self.at[chunk][1]
        while at in self.at and isinstance(self.at[at][0], MessageIndex):
            record, at = self.at[at]
            found[record.channel_id] = record
        return found

    def define(self, record: Schema | Channel, *, in_summary: bool) -> None:
        name, before = type(record).__name__, self.data[type(record)].get(record.id)
        if isinstance(record, Schema):
            self.expect(record.encoding, "Schema has empty Encoding")
            self.expect(record.id, "Schema.ID 0 is reserved")
        else:
            known = not record.schema_id or record.schema_id in self.data[Schema]
            self.expect(known, "Encountered Channel with unknown Schema")
        self.expect(before in (None, record), f"Two {name} records with same ID but different content")
        if in_summary:
            self.expect(before, f"{name} in summary section does not exist in data section")
            self.summary[type(record)][record.id] = record
        else:
            self.expect(before is None, f"Duplicate {name} records in data section")
            self.data[type(record)][record.id] = record

    def chunk(self, at: int, chunk: Chunk, indexes: dict[int, MessageIndex]) -> None:
        counts = self.chunks[at] = Counter()
        self.expect(chunk.compression == "zstd", "Unsupported compression format")
        try:
            content = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=1 << 30)
        except zstandard.ZstdError as error:
            self.complaints.append(f"Could not decompress: {error}")
            return
        self.expect(len(content) == chunk.uncompressed_size, "Uncompressed chunk data size != Chunk.uncompressed_size")
        self.expect(zlib.crc32(content) == chunk.uncompressed_crc, "invalid CRC")
        times: list[int] = []
        entries = {channel: dict(map(reversed, index.records)) for channel, index in indexes.items()}
        content = MAGIC + content
        end = len(MAGIC)
        for opcode, start, end in container_records(content, Opcode.FOOTER):
            if end > len(content):
                break
            legal = opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
            self.expect(legal, "Illegal record in chunk")
            message = self.parsed(opcode, content[start:end]) if legal else None
            if message is None:
                continue
            if opcode != Opcode.MESSAGE:
                self.define(message, in_summary=False)
                continue
            known = message.channel_id in self.data[Channel]
            self.expect(known, "Got a Message record for channel before a channel record.")
            in_order = not self.times or message.log_time >= self.times[-1]
            self.expect(in_order, "Message.log_time is less than the latest log time")
            self.expect(message.channel_id in indexes, "No MessageIndex record found for channel")
            entry = entries.get(message.channel_id, {}).pop(start - len(MAGIC), None)
            self.expect(entry is not None, "No MessageIndex entry found for message")
            self.expect(entry in (None, message.log_time), "MessageIndex entry has another timestamp than the message")
            times.append(message.log_time)
            self.times.append(message.log_time)
            counts[message.channel_id] += 1
        self.expect(end == len(content), "Failed to read next token: unexpected end of the chunk")
        self.expect(not any(entries.values()), "MessageIndex entry without a message")
        if times:
            first, last = "Chunk.message_start_time does not match", "Chunk.message_end_time does not match"
            self.expect(chunk.message_start_time == min(times), first)
            self.expect(chunk.message_end_time == max(times), last)

    def chunk_indexes(self) -> None:
        found: Counter[int] = Counter()
        for index in self.all(ChunkIndex).values():
            offset = index.chunk_start_offset
            found[offset] += 1
            chunk, end = self.at.get(offset, (None, 0))
            if not isinstance(chunk, Chunk):
                self.complaints.append("Chunk index points to offset but the record at this offset is another")
                continue
            for channel in self.chunks[offset]:
                self.expect(channel in self.summary[Channel], "channel not duplicated in summary section")
                schema = self.data[Channel][channel].schema_id if channel in self.data[Channel] else 0
                self.expect(schema in self.summary[Schema], "schema not duplicated in summary section")
            self.expect(index.chunk_length == end - offset, "Chunk index length mismatch")
            for what, has, says in (
                ("message start time", chunk.message_start_time, index.message_start_time),
                ("message end time", chunk.message_end_time, index.message_end_time),
                ("compression", chunk.compression, index.compression),
                ("compressed size", len(chunk.data), index.compressed_size),
                ("uncompressed size", chunk.uncompressed_size, index.uncompressed_size),
            ):
                self.expect(has == says, f"Chunk has {what}, but its chunk index has another")
            behind = self.message_indexes_behind(offset)
            self.expect(set(index.message_index_offsets) == set(behind), "Chunk index names other message indexes")
            for channel, place in index.message_index_offsets.items():
                right = place in self.at and self.at[place][0] == behind.get(channel)
                self.expect(right, "Chunk index has another offset of a message index")
            length = sum(_HEAD + 6 + 16 * len(each.records) for each in behind.values())
            self.expect(index.message_index_length == length, "Chunk index has another length of message indexes")
        self.expect(all(count == 1 for count in found.values()), "Multiple chunk indexes found for chunk")
        self.expect(set(found) == set(self.chunks), "a chunk isn't in the index")

    def statistics(self) -> None:
        records = list(self.all(Statistics).values())
        self.expect(len(records) == 1, "File contains multiple Statistics records, or none")
        counts = sum(self.chunks.values(), Counter())
        for record in records:
            for what, has, says in (
                ("message start time", min(self.times, default=0), record.message_start_time),
                ("message end time", max(self.times, default=0), record.message_end_time),
                ("message count", counts.total(), record.message_count),
                ("message count for channel", dict(counts), record.channel_message_counts),
                ("schemas", len(self.data[Schema]), record.schema_count),
                ("channels", len(self.data[Channel]), record.channel_count),
                ("chunks", len(self.chunks), record.chunk_count),
                ("attachments", len(self.all(Attachment)), record.attachment_count),
                ("metadata", len(self.all(Metadata)), record.metadata_count),
            ):
                self.expect(has == says, f"Statistics has {what} {says}, but actual is {has}")

    def beyond(self) -> None:
        """What the tool doesn't look at: checksums of the parts, and the other indexes."""
        content = self.content
        for at, end in self.all(DataEnd).items():
            self.expect(zlib.crc32(content[:at]) == end.data_section_crc, "invalid CRC of the data section")
        for at, footer in self.all(Footer).items():
            summary = content[footer.summary_start : at + _HEAD + 16]
            self.expect(zlib.crc32(summary) == footer.summary_crc, "invalid CRC of the summary")
            offsets = self.all(SummaryOffset)
            self.expect(min(offsets, default=0) == footer.summary_offset_start, "summary offsets begin elsewhere")
            groups = {each.group_start: each.group_start + each.group_length for each in offsets.values()}
            ends = [footer.summary_start, *sorted(groups.values())]
            starts = [*sorted(groups), footer.summary_offset_start]
            self.expect(ends == starts, "summary offsets don't cover the summary")
            for each in offsets.values():
                inside = range(each.group_start, each.group_start + each.group_length)
                kinds = {content[at] for at in self.at if at in inside}
                self.expect(kinds == {each.group_opcode}, "a summary offset names another group")
        files, indexed = self.all(Attachment), {each.offset: each for each in self.all(AttachmentIndex).values()}
        self.expect(set(files) == set(indexed), "attachments aren't those of the index")
        for at in set(files) & set(indexed):
            file, index, end = files[at], indexed[at], self.at[at][1]
            crc = int.from_bytes(content[end - 4 : end], "little")
            self.expect(crc == zlib.crc32(content[at + _HEAD : end - 4]), "invalid CRC of an attachment")
            same = (file.name, file.media_type, file.log_time, file.create_time, len(file.data), end - at)
            says = (index.name, index.media_type, index.log_time, index.create_time, index.data_size, index.length)
            self.expect(same == says, "an attachment isn't what its index says")
        texts = {(at, self.at[at][1] - at, text.name) for at, text in self.all(Metadata).items()}
        says = {(index.offset, index.length, index.name) for index in self.all(MetadataIndex).values()}
        self.expect(texts == says, "metadata isn't what its index says")
