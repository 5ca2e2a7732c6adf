"""The index of a recording's file: its chunks, channels, attached files and metadata.

A closed file has it at its end. Any other file is scanned once, header by header, and whatever is intact is indexed:
the file may be open or damaged. No record is decoded.
"""

from __future__ import annotations

import io
import os
import zlib
from collections import defaultdict
from typing import TYPE_CHECKING, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Footer, Header, Metadata, MetadataIndex, Schema, Statistics

from recorder.mcap.writer import FREE, MAX_RATIO
from replay.errors import LogClosed
from replay.file.chunks import Arrangement
from replay.file.mcap_format import (
    CHUNK_HEAD,
    CHUNK_INDEX,
    DAMAGE,
    DATA_END,
    FOOTER,
    HEADER,
    LENGTH,
    MAGIC,
    MAX_INFLATED,
    ChunkExtent,
    ChunkTable,
    Decompressor,
    Extent,
    StatedChunk,
)
from replay.file.scan import Scan

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from recorder.records import Record

_BLOCK: Final = 1 << 20  # bytes that are read at once
_TOO_MUCH: Final = f"the chunks inflate to more than {MAX_RATIO} times the file"


class _Budget:
    """Bytes that the chunks which are read may have in all; an index may name one and the same chunk very often."""

    def __init__(self) -> None:
        self._taken = 0
        self._takers: set[int] = set()

    def take(self, taker: int, size: int, most: int, cause: str) -> None:
        """Take what one needs, once.

        Raises:
            ValueError: all would have more than the most.
        """
        if taker not in self._takers:
            if self._taken + size > most:
                raise ValueError(cause)
            self._takers.add(taker)
            self._taken += size


class Index:
    """The index of a file, read from its end, or else by scanning it.

    Attributes:
        closed: whether the file was closed by its recorder.
        whole: whether its summary is intact, so that no scan was needed.
        damage: the parts that were left out, in words.
        chunks: in the file's order.
        channels: by their id.
        schemas: names of message types by their id.
        attachments: by name.
        metadata: values by key, by name of the metadata.
        counts: number of messages of each channel in all whole chunks.
        incomplete_bytes: at the end, of a record that was cut off, or is being written.
        data_end: where the record that ends the data begins; 0 if there is none, or it wasn't found.
        library: the library that wrote the file, by its header; "" if that is damaged.
        definitions: of message types, as in the file, by their names.
        loose: messages outside of chunks, as some programs write them, in the file's order.
        size: bytes of the file, when it was looked at last.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = os.fstat(file.fileno()).st_size
        self._decompressor = Decompressor()
        self.closed = False
        self.whole = False
        self.damage: list[str] = []
        self.chunks = ChunkTable()
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, str] = {}
        self.definitions: dict[str, bytes] = {}
        self.loose: list[Extent] = []
        self.attachments: dict[str, Extent] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.counts: defaultdict[int, int] = defaultdict(int)
        self.incomplete_bytes = 0
        self.data_end = 0
        self._arrangement: Arrangement | None = None
        self._claimed = 0  # bytes of files and metadata, by the summary
        self._stored = _Budget()  # of the file's own bytes
        self._inflated = _Budget()
        self._scan = Scan(file, self)
        self._file.seek(0)
        if self._file.read(len(MAGIC)) != MAGIC:
            self.damage.append("its first bytes are damaged")
        self.library = self._read_library()
        damaged = len(self.damage)
        try:
            self._read_summary()
        except DAMAGE:
            self._clear()
            del self.damage[damaged:]
            self.refresh()
            self.whole = self.whole and self._claimed <= self.size

    def _clear(self) -> None:
        self.chunks.clear()
        for table in (self.channels, self.schemas, self.definitions, self.attachments, self.metadata, self.counts):
            table.clear()
        self._stored, self._inflated = _Budget(), _Budget()

    def close(self) -> None:
        """Close the file."""
        if self._arrangement is not None:
            self._arrangement.close()
        self._file.close()

    @property
    def ours(self) -> bool:
        """Whether PyCRAM wrote the file, as far as is known; then it has all checksums, and steps in their order."""
        return not self.library or self.library.startswith("pycram")

    def read(self, extent: Extent | ChunkExtent | StatedChunk) -> bytes:
        """Return the content of a record, less if the file ends in it.

        Raises:
            LogClosed: the file was closed.
            EOFError: it is not in the file.
        """
        if self._file.closed:
            raise LogClosed(self._file.name)
        offset, length = extent.offset, extent.length
        if not (0 <= offset <= self.size and length >= 0):
            raise EOFError(f"byte {offset} is not in the file, or {length} bytes are no length")
        self._file.seek(offset)
        return self._file.read(min(length, self.size - offset))

    def contents(self, number: int) -> tuple[bytes, str, int | None]:
        """Return a chunk's messages, decompressed and checked; how the chunk isn't what the index says of it, or "".

        What only its head has wrong is put right by the index. The third is how many messages it has by the index, None
        if that isn't known.

        Raises:
            Exception: it is damaged; what the decompressors raise has no common base.
        """
        if self._file.closed:
            raise LogClosed(self._file.name)
        if self._arrangement is not None:
            return self._arrangement.contents(number), "", None
        stated = self.chunks.stated(number)
        if stated is None:
            return self._decompressed(number, memoryview(self.read(self.chunks[number]))), "", None
        self._stored.take(number, min(stated.length, self.size), self.size, "it overlaps others, by the index")
        chunk = self.read(stated)
        _, _, head, tail, messages = stated
        crc, data = len(head), len(head) + 4 + len(tail)
        fault = ""
        if chunk[crc : crc + 4] == b"\0\0\0\0" and self.ours:
            raise ValueError("its checksum is missing")
        if not chunk.startswith(head) or not chunk.startswith(tail, crc + 4):
            fault = "its head differs from the index"
            chunk = head + chunk[crc : crc + 4] + tail + chunk[data:]
        return self._decompressed(number, memoryview(chunk)[HEADER:]), fault, messages

    def _decompressed(self, number: int, chunk: memoryview) -> bytes:
        size = CHUNK_HEAD.unpack_from(chunk)[2]
        if size <= MAX_INFLATED:  # others are refused without being inflated
            self._inflated.take(number, size, max(FREE, MAX_RATIO * self.size), _TOO_MUCH)
        return self._decompressor.contents(chunk)

    def arrange(self, kinds_of: Callable[[Index], Mapping[int, type[Record]]]) -> None:
        """Put the records of a file that another program wrote in the order of their steps; see :class:`Arrangement`.

        Args:
            kinds_of: returns types of record by channel.
        """
        if not self.ours:
            self._arrangement = Arrangement.of(self, kinds_of(self))
            if self._arrangement is not None:
                self.chunks.arrange(self._arrangement.chunks)

    def check(self) -> None:
        """Compare the checksum of all bytes with the stored one, and add a difference to ``damage``.

        This also finds wrong bytes in parts that are not needed for reading.
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
            self.damage = [*self.damage, "its checksum differs from the one that it was closed with"]

    def refresh(self) -> bool:
        """Look for what was written since; return whether there is anything new: never in a file that was closed."""
        return not self.closed and self._arrangement is None and self._scan.resume()

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
            raise EOFError  # closed, but without index
        self._file.seek(footer.summary_start)
        summary = self._file.read(size - len(MAGIC) - 4 - footer.summary_start)
        if zlib.crc32(summary) != footer.summary_crc and (footer.summary_crc or self.ours):
            raise EOFError
        self._read_summary_records(summary[: len(summary) - FOOTER + 4], checked=footer.summary_crc != 0)
        if (not self.chunks and self.counts) or not self.channels:
            raise EOFError  # written without an index of chunks
        self.data_end = footer.summary_start - DATA_END
        self.closed = self.whole = True

    def _read_summary_records(self, summary: bytes, *, checked: bool) -> None:
        starts = []
        at = 0
        while at < len(summary):
            opcode, length = LENGTH.unpack_from(summary, at)
            at += HEADER
            if opcode == Opcode.CHUNK_INDEX:  # by far the most
                if length < CHUNK_INDEX.size:
                    raise EOFError
                starts.append(at)
            else:
                self._read_summary_record(opcode, ReadDataStream(io.BytesIO(summary[at : at + length])))
            at += length
        if at != len(summary):
            raise EOFError
        self.chunks.take_summary(summary, starts)
        if not checked:
            for number in range(len(self.chunks)):
                _ = self.chunks[number]

    def _read_summary_record(self, opcode: int, stream: ReadDataStream) -> None:
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

    def _claim(self, length: int) -> None:
        """Refuse a summary by which files and metadata have more bytes than the file: it names the same ones often."""
        self._claimed += length
        if self._claimed > self.size:
            raise EOFError

    def _read_stated_metadata(self, stated: MetadataIndex) -> None:
        self._claim(stated.length)
        record = self.read(Extent(stated.offset, stated.length))
        whole = record.startswith(LENGTH.pack(Opcode.METADATA, stated.length - HEADER))
        try:
            name = self._take_metadata(record[HEADER:]) if whole else ""
        except DAMAGE:
            name = ""
        if name != stated.name:
            self.damage.append(f"the metadata {stated.name} is damaged")

    def read_metadata(self, extent: Extent) -> None:
        """Read a record of metadata."""
        self._take_metadata(self.read(extent))

    def _take_metadata(self, content: bytes) -> str:
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
