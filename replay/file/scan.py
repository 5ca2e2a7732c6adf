"""Scans a file that has no index: header by header, and past damage to the next intact chunk.

This is how recordings are read whose process was killed or is still running, and damaged ones.
"""

from __future__ import annotations

import io
import re
import zlib
from collections import defaultdict
from typing import TYPE_CHECKING, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Schema

from replay.file.mcap_format import (
    CHANNEL_OFFSET,
    CHUNK_HEAD,
    DAMAGE,
    DATA_END,
    FOOTER,
    HEADER,
    LENGTH,
    MAGIC,
    ChunkExtent,
    Extent,
)

if TYPE_CHECKING:
    from collections.abc import Container

    from replay.file.index import Index

_MAX_LENGTH: Final = 1 << 32  # bytes; what claims to be longer is damaged
_BLOCK: Final = 1 << 20
#: Part of the head of each compressed chunk, by which the next one is found after damage.
_MARK: Final = re.compile(b"\x04\0\0\0zstd|\x03\0\0\0lz4")


class Scan:
    """A scan of a file into an index, which can be resumed when the file has grown."""

    def __init__(self, file: BinaryIO, index: Index) -> None:
        self._file = file
        self._index = index
        self._next = len(MAGIC)
        self._counted: defaultdict[int, int] = defaultdict(int)  # messages of the last chunk, as far as indexed
        self._decoded = -1  # the chunk whose messages were counted by decoding it

    def resume(self) -> bool:
        """Scan on from where the last scan ended; return whether there is anything new."""
        index = self._index
        before = self._next
        size = index.size = self._file.seek(0, io.SEEK_END)
        at = self._next
        while at + HEADER <= size:
            opcode, extent = self._head(at)
            if opcode == Opcode.DATA_END and extent.length == 4:
                self._define_from_summary(extent.stop, size)
                index.closed = self._has_end(size)
                if index.closed:
                    index.data_end = at
                    index.whole = self._is_summary_intact(at, size)
                    at = size
                break
            beyond = extent.stop > size
            if beyond and not self._is_damaged(opcode, extent, size):
                break  # incomplete, or being written
            if not beyond and self._read(opcode, extent):
                at = extent.stop
                continue
            following = self._next_chunk(at + 1, size)
            if following is None:
                break
            index.damage.append(f"{following - at} bytes at byte {at} are damaged")
            at = following
        if index.chunks:
            self._count_last()  # its index may be cut off, or not written yet
        self._next = at
        index.incomplete_bytes = size - at
        return at > before

    def _has_end(self, size: int) -> bool:
        self._file.seek(max(size - len(MAGIC), 0))
        return self._file.read() == MAGIC

    def _is_summary_intact(self, data_end: int, size: int) -> bool:
        """Return whether the summary is intact, or absent because the recorder wrote none."""
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
        """Read the definitions of channels from the summary, in case the data's are lost; its offsets may be wrong."""
        while at + HEADER <= size:
            opcode, extent = self._head(at)
            at = extent.stop
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or at > size:
                return
            try:
                definition = self._definition(opcode, extent)
            except DAMAGE:
                return
            defined: Container[int] = self._index.schemas if isinstance(definition, Schema) else self._index.channels
            if definition.id not in defined:
                self._index.define(definition)

    def _definition(self, opcode: int, extent: Extent) -> Schema | Channel:
        return _parsed(opcode, self._index.read(extent))

    def _is_damaged(self, opcode: int, extent: Extent, size: int) -> bool:
        """Return whether a record that reaches beyond the end is damaged, rather than cut off."""
        if not Opcode.HEADER <= opcode <= Opcode.DATA_END or extent.length > _MAX_LENGTH:
            return True
        if opcode == Opcode.CHUNK and extent.offset + CHUNK_HEAD.size + 32 <= size:
            return not self._is_chunk(extent)
        # with whole chunks after it, it isn't the end that is cut off
        return self._next_chunk(extent.offset, size) is not None

    def _is_chunk(self, extent: Extent) -> bool:
        self._file.seek(extent.offset)
        head = self._file.read(CHUNK_HEAD.size + 32)
        if len(head) < CHUNK_HEAD.size + 8:
            return False
        name = CHUNK_HEAD.unpack_from(head)[4]
        at = CHUNK_HEAD.size + name
        return bool(name <= 16 and extent.length == at + 8 + int.from_bytes(head[at : at + 8], "little"))

    def _read(self, opcode: int, extent: Extent) -> bool:
        """Read a whole record into the index; return whether it is intact."""
        try:
            if opcode == Opcode.CHUNK:
                if extent.length < CHUNK_HEAD.size + 8 or not self._is_chunk(extent):
                    return False
                if self._index.chunks and self._index.chunks[-1].channels is None:
                    self._count_last()
                self._counted = defaultdict(int)
                self._index.chunks.append(ChunkExtent(*extent, None))
            elif opcode == Opcode.MESSAGE:
                self._index.loose.append(extent)
                self._file.seek(extent.offset)
                self._index.counts[int.from_bytes(self._file.read(2), "little")] += 1
            elif opcode == Opcode.MESSAGE_INDEX:
                return self._read_message_index(extent)
            elif opcode == Opcode.ATTACHMENT:
                return self._read_attachment(extent)
            elif opcode == Opcode.METADATA:
                self._index.read_metadata(extent)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._index.define(self._definition(opcode, extent))
        except DAMAGE:
            return False
        return Opcode.HEADER <= opcode <= Opcode.DATA_END

    def _read_message_index(self, extent: Extent) -> bool:
        self._file.seek(extent.offset)
        head = self._file.read(6)
        channel, length = int.from_bytes(head[:2], "little"), int.from_bytes(head[2:], "little")
        if extent.length != 6 + length or length % 16:
            return False
        if not self._index.chunks or not length or self._decoded == len(self._index.chunks) - 1:
            return True
        entry = CHANNEL_OFFSET.pack(channel, extent.offset)
        self._index.chunks.set_channels((self._index.chunks[-1].channels or b"") + entry)
        self._counted[channel] += length // 16
        self._index.counts[channel] += length // 16
        if channel not in self._index.channels:
            self._define_from(len(self._index.chunks) - 1)
        return True

    def _read_attachment(self, extent: Extent) -> bool:
        self._file.seek(extent.offset + 16)
        stream = ReadDataStream(self._file)
        name = stream.read_prefixed_string()
        stream.read_prefixed_string()
        size = stream.read8()
        if extent.length != 16 + stream.count + size + 4:
            return False
        self._index.attachments[name] = extent
        return True

    def _define_from(self, number: int) -> dict[int, int] | None:
        """Read the channels that a chunk defines; return its messages by channel, None if it is damaged."""
        counted: defaultdict[int, int] = defaultdict(int)
        try:
            contents = self._index.contents(number)[0]
            at = 0
            while at < len(contents):
                opcode, length = LENGTH.unpack_from(contents, at)
                content = contents[at + HEADER : at + HEADER + length]
                if opcode == Opcode.MESSAGE:
                    counted[int.from_bytes(content[:2], "little")] += 1
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._index.define(_parsed(opcode, content))
                at += HEADER + length
        except Exception:  # noqa: BLE001  decompressors' errors have no common base; reported when the chunk is read
            return None
        return counted

    def _count_last(self) -> None:
        """Count the last chunk's messages from itself."""
        number = len(self._index.chunks) - 1
        if number == self._decoded:
            return
        counted = self._define_from(number)
        if counted is None:
            return
        for channel in counted.keys() | self._counted.keys():
            self._index.counts[channel] += counted.get(channel, 0) - self._counted[channel]
        self._index.chunks.set_channels(b"".join(CHANNEL_OFFSET.pack(channel, 0) for channel in counted))
        self._decoded = number

    def _next_chunk(self, start: int, size: int) -> int | None:
        """Return the offset of the first intact chunk at or behind a byte; None if there is none."""
        at = start
        while at < size:
            self._file.seek(at)
            block = self._file.read(_BLOCK + 64)
            for mark in _MARK.finditer(block):
                offset = at + mark.start() - CHUNK_HEAD.size + 4 - HEADER
                if offset >= start and self._chunk_at(offset, size):
                    return offset
            at += _BLOCK
        return None

    def _chunk_at(self, offset: int, size: int) -> bool:
        opcode, extent = self._head(offset)
        return opcode == Opcode.CHUNK and extent.stop <= size and self._is_chunk(extent)

    def _head(self, offset: int) -> tuple[int, Extent]:
        """Return the opcode of the record at an offset, and the extent of its content."""
        self._file.seek(offset)
        opcode, length = LENGTH.unpack(self._file.read(HEADER))
        return opcode, Extent(offset + HEADER, length)


def _parsed(opcode: int, content: bytes) -> Schema | Channel:
    kind = Schema if opcode == Opcode.SCHEMA else Channel
    definition: Schema | Channel = kind.read(ReadDataStream(io.BytesIO(content)))
    return definition
