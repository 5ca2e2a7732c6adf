"""The index of a recording's file: its chunks, channels, attached files and metadata.

A closed file has its index at the end. Other files (damaged, still growing, or left by a killed process) are scanned
without decoding records. After a damaged part, the scan continues at the next intact chunk.
"""

from __future__ import annotations

import io
import os
import re
import zlib
from collections import Counter, defaultdict
from collections.abc import Container
from typing import BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Footer, Header, Metadata, MetadataIndex, Schema, Statistics
from zstandard import ZstdDecompressor

from recorder.mcap_writer import FREE, MAX_RATIO
from replay.errors import LogClosed
from replay.file.mcap_format import (
    CHANNEL_OFFSET,
    CHUNK_DAMAGE,
    CHUNK_HEAD,
    DAMAGE,
    DATA_END,
    FOOTER,
    HEADER,
    LENGTH,
    MAGIC,
    MAX_INFLATED,
    ChunkExtent,
    Extent,
    decompressed,
    framed,
    indexed_chunk,
)

_BLOCK: Final = 1 << 20  # maximum number of bytes of one read
_MAX_LENGTH: Final = 1 << 32  # number of bytes above which a record counts as damaged
#: A part of the head of each compressed chunk, by which the next chunk is found after damage.
_MARK: Final = re.compile(b"\x04\0\0\0zstd|\x03\0\0\0lz4")
_TOO_MUCH: Final = f"the chunks inflate to more than {MAX_RATIO} times the file"


class _Budget:
    """A limit for the bytes of all chunks together, because a malicious index may name a chunk many times."""

    def __init__(self) -> None:
        self._taken = 0
        self._takers: set[int] = set()

    def take(self, taker: int, size: int, most: int, cause: str) -> None:
        """Count the bytes of a chunk once; raise ValueError above the limit."""
        if taker not in self._takers:
            if self._taken + size > most:
                raise ValueError(cause)
            self._takers.add(taker)
            self._taken += size


class Index:
    """The index of a file, from the end of the file or from a scan."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = os.fstat(file.fileno()).st_size  # size of the file in bytes at the last scan
        self._zstd = ZstdDecompressor()  # not thread-safe
        self.closed = False  # whether the recorder closed the file
        self.whole = False  # whether the summary is intact
        self.damage: list[str] = []  # damaged parts, as text
        self.chunks: list[ChunkExtent] = []  # the chunks, in the order of the file
        self.channels: dict[int, Channel] = {}  # channels by id
        self.schemas: dict[int, str] = {}  # names of message types, by id
        self.definitions: dict[str, bytes] = {}  # serialized definitions of message types, by name
        self.loose: list[Extent] = []  # messages outside of chunks; some programs write such messages
        self.attachments: dict[str, Extent] = {}  # positions and lengths of attached files, by name
        self.metadata: dict[str, dict[str, str]] = {}  # values in the metadata, by name of the metadata and key
        self.counts: defaultdict[int, int] = defaultdict(int)  # number of messages in whole chunks, by channel
        self.incomplete_bytes = 0  # size in bytes of an incomplete record at the end of the file
        self.data_end = 0  # offset of the record that ends the data; 0 if it is missing
        self._claimed = 0  # number of bytes of files and metadata, according to the summary
        self._stored = _Budget()  # budget of bytes that are read from the file
        self._inflated = _Budget()
        self._scan = FileScan(file, self)
        self._file.seek(0)
        if self._file.read(len(MAGIC)) != MAGIC:
            self.damage.append("its first bytes are damaged")
        self.library = self._read_library()  # the library that wrote the file; "" if the header is damaged
        damaged = len(self.damage)
        try:
            self._read_summary()
        except DAMAGE:
            self.chunks.clear()
            for table in (self.channels, self.schemas, self.definitions, self.attachments, self.metadata, self.counts):
                table.clear()
            self._stored, self._inflated = _Budget(), _Budget()
            del self.damage[damaged:]
            self.refresh()
            self.whole = self.whole and self._claimed <= self.size

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def ours(self) -> bool:
        """Whether PyCRAM wrote the file. Files of PyCRAM have all checksums, and steps in order."""
        return not self.library or self.library.startswith("pycram")

    def check_open(self) -> None:
        """Raise `LogClosed` if the file was closed."""
        if self._file.closed:
            raise LogClosed(self._file.name)

    def read(self, extent: Extent | ChunkExtent) -> bytes:
        """Return the content of a record. If the file ends within the record, the content is cut off.

        Raises:
            LogClosed: The file was closed.
            EOFError: The record isn't completely within the file.
        """
        self.check_open()
        offset, length = extent.offset, extent.length
        if not (0 <= offset <= self.size and length >= 0):
            raise EOFError(f"byte {offset} is not in the file, or {length} isn't a valid number of bytes")
        self._file.seek(offset)
        return self._file.read(min(length, self.size - offset))

    def contents(self, number: int) -> tuple[bytes, str, int | None]:
        """Return a chunk's decompressed messages, its difference from the index, and the number of messages.

        If the chunk's head differs from the index, the head in the index is used. The number comes from the index; None
        means that the index lacks the number. If the chunk is damaged, CHUNK_DAMAGE is raised.
        """
        self.check_open()
        extent = self.chunks[number]
        if extent.stated is None:
            return self._decompressed(number, memoryview(self.read(extent))), "", None
        size = min(extent.length + HEADER, self.size)
        self._stored.take(number, size, self.size, "according to the index, it overlaps other chunks")
        chunk = self.read(Extent(extent.offset - HEADER, extent.length + HEADER))
        head, tail, messages = extent.stated
        crc, data = len(head), len(head) + 4 + len(tail)
        fault = ""
        if chunk[crc : crc + 4] == b"\0\0\0\0" and self.ours:
            raise ValueError("its checksum is missing")
        if not chunk.startswith(head) or not chunk.startswith(tail, crc + 4):
            fault = "its header differs from the index"
            chunk = head + chunk[crc : crc + 4] + tail + chunk[data:]
        return self._decompressed(number, memoryview(chunk)[HEADER:]), fault, messages

    def _decompressed(self, number: int, chunk: memoryview) -> bytes:
        size = CHUNK_HEAD.unpack_from(chunk)[2]
        if size <= MAX_INFLATED:  # a chunk with more bytes is rejected before it is inflated
            self._inflated.take(number, size, max(FREE, MAX_RATIO * self.size), _TOO_MUCH)
        return decompressed(chunk, self._zstd)

    def check(self) -> None:
        """Compare the checksum of all bytes with the stored checksum; add a difference to ``damage``.

        The checksum also covers parts of the file that no reader needs.
        """
        if not self.data_end:
            return
        self._file.seek(0)
        crc, left = 0, self.data_end
        while left and (block := self._file.read(min(left, _BLOCK))):
            crc = zlib.crc32(block, crc)
            left -= len(block)
        end = self._file.read(DATA_END)
        stored = int.from_bytes(end[HEADER:], "little")
        if end[:HEADER] != LENGTH.pack(Opcode.DATA_END, 4) or (stored != crc if self.ours else stored not in (0, crc)):
            self.damage = [*self.damage, "its checksum differs from the stored checksum"]

    def refresh(self) -> bool:
        """Scan the new part of a growing file; return whether the file has grown. Closed files don't grow."""
        return not self.closed and self._scan.resume()

    def _read_library(self) -> str:
        self._file.seek(len(MAGIC))
        head = self._file.read(HEADER)
        if len(head) < HEADER or head[0] != Opcode.HEADER:
            return ""
        try:
            library: str = Header.read(ReadDataStream(self._file)).library
        except DAMAGE:
            return ""
        return library

    def _read_summary(self) -> None:
        size = self._file.seek(0, io.SEEK_END)
        self._file.seek(max(size - len(MAGIC) - FOOTER, 0))
        end = self._file.read()
        if len(end) != FOOTER + len(MAGIC) or not end.endswith(MAGIC) or end[0] != Opcode.FOOTER:
            raise EOFError
        footer = Footer.read(ReadDataStream(io.BytesIO(end[HEADER:FOOTER])))
        if not 0 < footer.summary_start < size:
            raise EOFError  # the file was closed, but has no index
        self._file.seek(footer.summary_start)
        summary = self._file.read(size - len(MAGIC) - 4 - footer.summary_start)
        if zlib.crc32(summary) != footer.summary_crc and (footer.summary_crc or self.ours):
            raise EOFError
        self._read_summary_records(summary[: len(summary) - FOOTER + 4])
        if (not self.chunks and self.counts) or not self.channels:
            raise EOFError  # the index of the file doesn't list chunks
        self.data_end = footer.summary_start - DATA_END
        self.closed = self.whole = True

    def _read_summary_records(self, summary: bytes) -> None:
        stop = 0
        for opcode, start, stop in framed(summary):
            if opcode == Opcode.CHUNK_INDEX:
                self.chunks.append(indexed_chunk(summary, start))
            else:
                stream = ReadDataStream(io.BytesIO(summary[start:stop]))
                if opcode == Opcode.SCHEMA:
                    self.define(Schema.read(stream))
                elif opcode == Opcode.CHANNEL:
                    self.define(Channel.read(stream))
                elif opcode == Opcode.STATISTICS:
                    self.counts.update(Statistics.read(stream).channel_message_counts)
                elif opcode == Opcode.ATTACHMENT_INDEX:
                    attachment = AttachmentIndex.read(stream)
                    self._claim(attachment.length)
                    self.attachments[attachment.name] = Extent(attachment.offset + HEADER, attachment.length - HEADER)
                elif opcode == Opcode.METADATA_INDEX:
                    self._read_stated_metadata(MetadataIndex.read(stream))
        if stop != len(summary):
            raise EOFError

    def _claim(self, length: int) -> None:
        """Reject a summary whose files and metadata have more bytes than the file, because the summary repeats them."""
        self._claimed += length
        if self._claimed > self.size:
            raise EOFError

    def _read_stated_metadata(self, stated: MetadataIndex) -> None:
        self._claim(stated.length)
        record = self.read(Extent(stated.offset, stated.length))
        whole = record.startswith(LENGTH.pack(Opcode.METADATA, stated.length - HEADER))
        try:
            name = self.take_metadata(record[HEADER:]) if whole else ""
        except DAMAGE:
            name = ""
        if name != stated.name:
            self.damage.append(f"the metadata {stated.name} is damaged")

    def take_metadata(self, content: bytes) -> str:
        """Add a record of metadata, and return its name."""
        metadata = Metadata.read(ReadDataStream(io.BytesIO(content)))
        self.metadata[metadata.name] = metadata.metadata
        name: str = metadata.name
        return name

    def define(self, record: object) -> None:
        """Add the definition of a channel or of a message type."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record.name
            self.definitions[record.name] = record.data
        elif isinstance(record, Channel):
            self.channels[record.id] = record


class FileScan:
    """A scan of a file that makes an index; the scan resumes when the file has grown."""

    def __init__(self, file: BinaryIO, index: Index) -> None:
        self._file = file
        self._index = index
        self._next = len(MAGIC)

    def resume(self) -> bool:
        """Continue the scan; return whether the file has grown."""
        index = self._index
        before = self._next
        size = index.size = self._file.seek(0, io.SEEK_END)
        at = self._next
        while at + HEADER <= size:
            opcode, extent = self._head(at)
            if opcode == Opcode.DATA_END and extent.length == 4:
                self._define_from_summary(extent.stop, size)
                self._file.seek(max(size - len(MAGIC), 0))
                index.closed = self._file.read() == MAGIC
                if index.closed:
                    index.data_end = at
                    index.whole = self._is_summary_intact(at, size)
                    at = size
                break
            beyond = extent.stop > size
            if beyond and not self._is_damaged(opcode, extent, size):
                break  # the record is still incomplete
            if not beyond and self._read(opcode, extent):
                at = extent.stop
                continue
            following = self._next_chunk(at + 1, size)
            if following is None:
                break
            index.damage.append(f"{following - at} bytes at byte {at} are damaged")
            at = following
        self._next = at
        index.incomplete_bytes = size - at
        return at > before

    def _is_summary_intact(self, data_end: int, size: int) -> bool:
        """Return whether the summary is intact. A missing summary also counts as intact."""
        behind = data_end + DATA_END
        self._file.seek(behind)
        end = self._file.read(size - behind)
        if len(end) < FOOTER + len(MAGIC):
            return False
        footer = Footer.read(ReadDataStream(io.BytesIO(end[-FOOTER - len(MAGIC) + HEADER :])))
        if not footer.summary_start:
            return len(end) == FOOTER + len(MAGIC)
        crc = zlib.crc32(end[: -len(MAGIC) - 4])
        intact = footer.summary_crc == crc or not (footer.summary_crc or self._index.ours)
        return intact and footer.summary_start == behind

    def _define_from_summary(self, at: int, size: int) -> None:
        """Read definitions of channels from the summary if the data has lost them."""
        while at + HEADER <= size:
            opcode, extent = self._head(at)
            at = extent.stop
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or at > size:
                return
            try:
                definition = _parsed(opcode, self._index.read(extent))
            except DAMAGE:
                return
            defined: Container[int] = self._index.schemas if isinstance(definition, Schema) else self._index.channels
            if definition.id not in defined:
                self._index.define(definition)

    def _is_damaged(self, opcode: int, extent: Extent, size: int) -> bool:
        """Return whether a record that ends beyond the file is damaged; otherwise the file was cut off."""
        if not Opcode.HEADER <= opcode <= Opcode.DATA_END or extent.length > _MAX_LENGTH:
            return True
        if opcode == Opcode.CHUNK and extent.offset + CHUNK_HEAD.size + 32 <= size:
            return not self._is_chunk(extent)
        return self._next_chunk(extent.offset, size) is not None  # intact chunks can't follow a cut

    def _is_chunk(self, extent: Extent) -> bool:
        self._file.seek(extent.offset)
        head = self._file.read(CHUNK_HEAD.size + 32)
        if len(head) < CHUNK_HEAD.size + 8:
            return False
        name = CHUNK_HEAD.unpack_from(head)[4]
        at = CHUNK_HEAD.size + name
        return bool(name <= 16 and extent.length == at + 8 + int.from_bytes(head[at : at + 8], "little"))

    def _read(self, opcode: int, extent: Extent) -> bool:
        """Read a whole record into the index; return whether the record is intact."""
        try:
            if opcode == Opcode.CHUNK:
                if extent.length < CHUNK_HEAD.size + 8 or not self._is_chunk(extent):
                    return False
                self._index.chunks.append(ChunkExtent(*extent))
                self._count_messages(len(self._index.chunks) - 1)
            elif opcode == Opcode.MESSAGE:
                self._index.loose.append(extent)
                self._file.seek(extent.offset)
                self._index.counts[int.from_bytes(self._file.read(2), "little")] += 1
            elif opcode == Opcode.MESSAGE_INDEX:
                self._file.seek(extent.offset + 2)
                length = int.from_bytes(self._file.read(4), "little")
                return extent.length == 6 + length and length % 16 == 0
            elif opcode == Opcode.ATTACHMENT:
                self._file.seek(extent.offset + 16)
                stream = ReadDataStream(self._file)
                name = stream.read_prefixed_string()
                stream.read_prefixed_string()
                size = stream.read8()
                if extent.length != 16 + stream.count + size + 4:
                    return False
                self._index.attachments[name] = extent
                return True
            elif opcode == Opcode.METADATA:
                self._index.take_metadata(self._index.read(extent))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._index.define(_parsed(opcode, self._index.read(extent)))
        except DAMAGE:
            return False
        return Opcode.HEADER <= opcode <= Opcode.DATA_END

    def _count_messages(self, number: int) -> None:
        """Count the messages of a chunk, and read the definitions of channels in it."""
        index, counted = self._index, Counter[int]()
        try:
            contents = index.contents(number)[0]
            for opcode, start, stop in framed(contents):
                if opcode == Opcode.MESSAGE:
                    counted[int.from_bytes(contents[start : min(start + 2, stop)], "little")] += 1
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    index.define(_parsed(opcode, contents[start:stop]))
        except CHUNK_DAMAGE:  # readers of this chunk will report the damage
            return
        for channel, count in counted.items():
            index.counts[channel] += count
        channels = b"".join(CHANNEL_OFFSET.pack(channel, 0) for channel in counted)
        index.chunks[number] = index.chunks[number]._replace(channels=channels)

    def _next_chunk(self, start: int, size: int) -> int | None:
        """Return the offset of the first intact chunk at or after a byte; None if there is none."""
        at = start
        while at < size:
            self._file.seek(at)
            for mark in _MARK.finditer(self._file.read(_BLOCK + 64)):
                offset = at + mark.start() - CHUNK_HEAD.size + 4 - HEADER
                if offset < start:
                    continue
                opcode, extent = self._head(offset)
                if opcode == Opcode.CHUNK and extent.stop <= size and self._is_chunk(extent):
                    return offset
            at += _BLOCK
        return None

    def _head(self, offset: int) -> tuple[int, Extent]:
        """Return the opcode of the record at an offset, and the position of its content."""
        self._file.seek(offset)
        opcode, length = LENGTH.unpack(self._file.read(HEADER))
        return opcode, Extent(offset + HEADER, length)


def _parsed(opcode: int, content: bytes) -> Schema | Channel:
    kind = Schema if opcode == Opcode.SCHEMA else Channel
    definition: Schema | Channel = kind.read(ReadDataStream(io.BytesIO(content)))
    return definition
