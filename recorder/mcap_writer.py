"""Write the MCAP container: chunks of messages with their indexes, attachments, metadata and the summary.

The ``mcap`` package serializes everything except messages, for which its own writer takes three times as long. Readers
refuse files that inflate too much, because such files may be decompression bombs. A chunk therefore stays uncompressed
if it would compress too well.
"""

from __future__ import annotations

import hashlib
import io
import re
import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import zstandard
from mcap.data_stream import RecordBuilder
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
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC: Final = b"\x89MCAP0\r\n"
MAX_RATIO: Final = 32  # inflated chunks have at most this many times the size of the file. Usual ratios are 3 to 13.
FREE: Final = 4 << 20  # number of bytes to which the chunks of any file may inflate
_MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length of the rest, channel, sequence, log time, publish time
_MESSAGE_OPCODE: Final = int(Opcode.MESSAGE)
_MESSAGE_HEAD: Final = 9  # number of bytes of the fields opcode and length
_MESSAGE_FIELDS: Final = _MESSAGE.size - _MESSAGE_HEAD
_INDEX: Final = struct.Struct("<BQHI")  # fields: opcode, length, channel, size of the entries in bytes
_FOOTER_START: Final = struct.Struct("<BQQQ")  # the first part of the footer, which the summary's CRC covers

#: Name of the metadata with the name (``file``) and hash (``sha256``) of the file of models that a recording shares.
MODELS_METADATA: Final = "pycram.models"
MODELS_NAME: Final = re.compile(r"models-[0-9a-f]{12}\.mcap")
MODELS_LIBRARY: Final = "pycram models"  # without the release number, so that equal models make equal files
_SOURCE: Final = ".py"  # suffix of the plan's source, which each recording contains


class McapWriter:
    """A writer of one MCAP file, for one thread at a time. ``library`` names the writing software."""

    def __init__(self, file: BinaryIO, library: str) -> None:
        self._file = file
        self.size = 0  # number of written bytes, without the open chunk
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor(level=1)  # higher levels take longer and save nothing
        self._chunk: list[bytes] = []
        self._chunk_size = 0
        self._inflated = 0  # size in bytes of all chunks before compression
        self._entries: defaultdict[int, list[int]] = defaultdict(list)  # log time and offset of each message by channel
        self._first_ns = self._last_ns = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._write(MAGIC)
        self._write(_packed(Header(profile="", library=library)))

    def move(self, file: BinaryIO, start: bytes) -> None:
        """Write ``start``, the content so far, into another file, and continue in this file."""
        file.write(start)
        file.flush()
        self._file = file

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add the definition of a message type, and return its id."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
        self._append(_packed(self._schemas[-1]))
        return len(self._schemas)

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str] | None = None) -> int:
        """Add a channel for messages of one type (schema id), and return its id."""
        self._channels.append(
            Channel(
                id=len(self._channels) + 1,
                topic=topic,
                message_encoding=encoding,
                metadata=dict(metadata or {}),
                schema_id=schema,
            )
        )
        self._append(_packed(self._channels[-1]))
        return len(self._channels)

    def add_messages(self, messages: Sequence[tuple[int, int, int, bytes]]) -> None:
        """Add messages to the chunk, as tuples of channel id, number, time and bytes.

        Only the lowest 32 bits of the number are kept. Times are in ns since the Unix epoch, and must not decrease.
        """
        pack, chunk, entries, size = _MESSAGE.pack, self._chunk, self._entries, self._chunk_size
        for channel, sequence, time_ns, payload in messages:
            if not entries:
                self._first_ns = time_ns
            self._last_ns = time_ns
            entries[channel] += (time_ns, size)
            length = _MESSAGE_FIELDS + len(payload)
            chunk += (pack(_MESSAGE_OPCODE, length, channel, sequence & 0xFFFFFFFF, time_ns, time_ns), payload)
            size += _MESSAGE_HEAD + length
        self._chunk_size = size

    def add_attachment(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Close the chunk and write a file; the time is in ns since the Unix epoch."""
        self.flush()
        file = Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data)
        at, packed = self.size, _packed(file)
        self._write(packed)
        self._attachments.append(
            AttachmentIndex(
                offset=at,
                length=len(packed),
                create_time=time_ns,
                log_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Close the chunk and write metadata about the file."""
        self.flush()
        at, packed = self.size, _packed(Metadata(name=name, metadata=dict(data)))
        self._write(packed)
        self._metadata.append(MetadataIndex(offset=at, length=len(packed), name=name))

    def flush(self) -> None:
        """Close the chunk, and hand all bytes to the operating system."""
        if self._chunk:
            self._end_chunk()
        self._file.flush()

    def _end_chunk(self) -> None:
        content = b"".join(self._chunk)
        compression, data = "zstd", self._compressor.compress(content)
        self._inflated += len(content)
        if self._inflated > max(FREE, MAX_RATIO * (self.size + len(data))):
            compression, data = "", content
        first_ns, last_ns = (self._first_ns, self._last_ns) if self._entries else (0, 0)
        chunk = Chunk(
            compression=compression,
            data=data,
            message_start_time=first_ns,
            message_end_time=last_ns,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        at, packed = self.size, _packed(chunk)
        offsets: dict[int, int] = {}
        indexes: list[bytes] = []
        end = at + len(packed)
        for channel, entries in self._entries.items():
            offsets[channel] = end
            size = 8 * len(entries)
            indexes.append(_INDEX.pack(Opcode.MESSAGE_INDEX, size + 6, channel, size))
            indexes.append(struct.pack(f"<{len(entries)}Q", *entries))
            end += _INDEX.size + size
            self._counts[channel] += len(entries) // 2
        self._write(b"".join((packed, *indexes)))
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(packed),
                chunk_start_offset=at,
                compression=compression,
                compressed_size=len(data),
                message_end_time=last_ns,
                message_index_length=end - at - len(packed),
                message_index_offsets=offsets,
                message_start_time=first_ns,
                uncompressed_size=len(content),
            )
        )
        self._chunk.clear()
        self._chunk_size = 0
        self._entries.clear()

    def finish(self) -> None:
        """Write the summary, which ends the file."""
        self.flush()
        self._write(_packed(DataEnd(data_section_crc=self._crc)))
        summary_start = self.size
        groups: list[tuple[int, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        summary = offsets = b""
        for opcode, records in groups:
            if records:
                group = b"".join(map(_packed, records))
                at = summary_start + len(summary)
                offsets += _packed(SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(group)))
                summary += group
        offsets_start = summary_start + len(summary)
        crc = zlib.crc32(summary + offsets + _FOOTER_START.pack(Opcode.FOOTER, 20, summary_start, offsets_start))
        footer = _packed(Footer(summary_start=summary_start, summary_offset_start=offsets_start, summary_crc=crc))
        self._write(summary + offsets + footer + MAGIC)
        self._file.flush()

    def _statistics(self) -> Statistics:
        filled = [index for index in self._chunks if index.message_index_offsets]
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((index.message_end_time for index in filled), default=0),
            message_start_time=min((index.message_start_time for index in filled), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _append(self, packed: bytes) -> None:
        self._chunk.append(packed)
        self._chunk_size += len(packed)

    def _write(self, packed: bytes) -> None:
        self._file.write(packed)
        self.size += len(packed)
        self._crc = zlib.crc32(packed, self._crc)


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


@dataclass(frozen=True, slots=True)
class SharedModels:
    """A file of models that recordings of a folder share. Its name has its hash, so equal models make the same file."""

    file: str
    sha256: str  # hash of the file's content, hexadecimal
    keys: frozenset[str]  # names of the attachments, ``<sha256>/<name>``

    @classmethod
    def of(cls, path: Path) -> SharedModels:
        """Read an existing file of shared models."""
        from mcap.reader import SeekingReader  # noqa: PLC0415  recordings are read by another reader

        content = path.read_bytes()
        keys = frozenset(each.name for each in SeekingReader(io.BytesIO(content)).iter_attachments())
        return cls(path.name, hashlib.sha256(content).hexdigest(), keys)


def share_models(recording: Path) -> SharedModels | None:
    """Write the models of a complete recording into a file in its folder. Return None if there are no models."""
    from mcap.reader import SeekingReader  # noqa: PLC0415  as above

    with recording.open("rb") as file:
        found = SeekingReader(file).iter_attachments()
        models = sorted((each.name, each.media_type, each.data) for each in found if not each.name.endswith(_SOURCE))
    if not models:
        return None
    content = io.BytesIO()
    writer = McapWriter(content, MODELS_LIBRARY)
    for name, media_type, data in models:
        writer.add_attachment(0, name, media_type, data)
    writer.finish()
    text = content.getvalue()
    digest = hashlib.sha256(text).hexdigest()
    path = recording.with_name(f"models-{digest[:12]}.mcap")
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(text)
    part.replace(path)
    return SharedModels(path.name, digest, frozenset(name for name, _, _ in models))
