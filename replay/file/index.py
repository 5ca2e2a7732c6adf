"""Where everything lies in a recording's file: its chunks, channels, attached files and metadata.

A finished file says so at its end. Any other file is walked through once, header by header, and whatever is whole is
taken: nothing here needs the file to have been closed, or to be undamaged. No record is decoded.
"""

from __future__ import annotations

import io
import zlib
from collections import defaultdict
from typing import BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from replay.errors import LogClosed
from replay.file.layout import DATA_END, FOOTER, HEADER, LENGTH, MAGIC, ChunkPlace, ChunkPlaces, Place
from replay.file.recover import Walk
from replay.file.unpack import DAMAGE, Unpacking

_BLOCK: Final = 1 << 20  # bytes that are read at once


class Index:
    """What lies where in a file.

    Attributes:
        closed: whether the file was closed by its recorder.
        whole: whether its end is there and sound, so that nothing had to be searched for.
        damage: in words, the parts that had to be left out.
        chunks: in the file's order.
        channels: by their id.
        schemas: names of message types by their id.
        attachments: by name.
        metadata: what the recorder said, by name of the metadata.
        counts: messages of each channel; of a file that was cut, in all whole chunks.
        torn: bytes at the end that are no whole record, or not yet.
        data_end: where the record that ends the data begins; 0 if there is none, or it wasn't found.
        library: what wrote the file, by its own words; "" if that is damaged.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Reads the end of the file, or walks through it.

        Args:
            file: opened for reading.
        """
        self._file = file
        self._unpacking = Unpacking()
        self.closed = False
        self.whole = False
        self.damage: list[str] = []
        self.chunks = ChunkPlaces()
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, str] = {}
        self.attachments: dict[str, Place] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.counts: defaultdict[int, int] = defaultdict(int)
        self.torn = 0
        self.data_end = 0
        self._walk = Walk(file, self)
        self._file.seek(0)
        if self._file.read(len(MAGIC)) != MAGIC:
            self.damage.append("its first bytes are damaged")
        self.library = self._read_library()
        try:
            self._read_summary()
        except DAMAGE:
            self._forget()
            self.refresh()

    def _forget(self) -> None:
        self.chunks.clear()
        for found in (self.channels, self.schemas, self.attachments, self.metadata, self.counts):
            found.clear()

    def read(self, place: Place | ChunkPlace) -> bytes:
        """The content of a record, less if the file ends in it.

        Raises:
            LogClosed: the file was closed.
        """
        if self._file.closed:
            raise LogClosed(self._file.name)
        self._file.seek(place.offset)
        return self._file.read(place.length)

    def contents(self, number: int) -> bytes:
        """A chunk's messages, decompressed and checked against their sum.

        Args:
            number: of the chunk.

        Raises:
            Exception: it is damaged; what the decompressors raise has no common base.
        """
        return self._unpacking.contents(self.read(self.chunks[number]))

    def check(self) -> None:
        """Compares the sum of all bytes with that which the file tells, and notes in ``damage`` if it is another.

        It finds what nothing else does: wrong bytes in parts that are not needed for reading.
        """
        if not self.data_end:
            return
        self._file.seek(0)
        crc, left = 0, self.data_end
        while left and (block := self._file.read(min(left, _BLOCK))):
            crc = zlib.crc32(block, crc)
            left -= len(block)
        end = self._file.read(DATA_END)
        told = int.from_bytes(end[HEADER:], "little")
        if end[:1] != bytes([Opcode.DATA_END]) or (told and told != crc):
            self.damage = [*self.damage, "the sum of its bytes is not the one that it was closed with"]

    def refresh(self) -> bool:
        """Looks for what was written since.

        Returns:
            Whether there is anything new; never of a file that was closed.
        """
        return not self.closed and self._walk.go_on()

    def _read_library(self) -> str:
        self._file.seek(len(MAGIC))
        head = self._file.read(HEADER)
        if len(head) < HEADER or head[0] != Opcode.HEADER:
            return ""
        try:
            told: str = Header.read(ReadDataStream(self._file)).library
        except DAMAGE:
            return ""
        return told

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
        if footer.summary_crc and zlib.crc32(summary) != footer.summary_crc:
            raise EOFError
        self._take_summary(summary[: len(summary) - FOOTER + 4], sound=footer.summary_crc != 0)
        if (not self.chunks and self.counts) or not self.channels:
            raise EOFError  # written without an index of chunks
        self.data_end = footer.summary_start - DATA_END
        self.closed = self.whole = True

    def _take_summary(self, summary: bytes, *, sound: bool) -> None:
        starts = []
        at = 0
        while at < len(summary):
            opcode, length = LENGTH.unpack_from(summary, at)
            at += HEADER
            if opcode == Opcode.CHUNK_INDEX:  # by far the most
                starts.append(at)
            else:
                self._take_summary_record(opcode, ReadDataStream(io.BytesIO(summary[at : at + length])))
            at += length
        self.chunks.take_summary(summary, starts)
        if not sound:
            for number in range(len(self.chunks)):
                _ = self.chunks[number]

    def _take_summary_record(self, opcode: int, stream: ReadDataStream) -> None:
        if opcode == Opcode.SCHEMA:
            self.learn(Schema.read(stream))
        elif opcode == Opcode.CHANNEL:
            self.learn(Channel.read(stream))
        elif opcode == Opcode.STATISTICS:
            self.counts.update(Statistics.read(stream).channel_message_counts)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            attachment = AttachmentIndex.read(stream)
            self.attachments[attachment.name] = Place(attachment.offset + HEADER, attachment.length - HEADER)
        elif opcode == Opcode.METADATA_INDEX:
            metadata = MetadataIndex.read(stream)
            self.take_metadata(Place(metadata.offset + HEADER, metadata.length - HEADER))

    def take_metadata(self, place: Place) -> None:
        """Takes what a record of metadata says."""
        told = Metadata.read(ReadDataStream(io.BytesIO(self.read(place))))
        self.metadata[told.name] = told.metadata

    def learn(self, record: object) -> None:
        """Takes the definition of a channel or of a type of messages."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record.name
        elif isinstance(record, Channel):
            self.channels[record.id] = record
