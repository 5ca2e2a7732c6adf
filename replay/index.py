"""Where everything lies in a recording's file: its chunks, channels, attached files and metadata.

A finished file says so at its end. Any other file is walked through once, header by header, and whatever is whole is
taken: nothing here needs the file to have been closed, or to be undamaged. No record is decoded.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import defaultdict
from typing import TYPE_CHECKING, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    Footer,
    Header,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import breakup_chunk

from replay.errors import LogClosed
from replay.packed import CHUNK_HEAD, Unpacking
from replay.places import CHANNEL_OFFSET, HEADER, ChunkPlace, ChunkPlaces, Place

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER: Final = HEADER + 20
_LIMIT: Final = 1 << 32  # no honest record is longer
_LENGTH: Final = struct.Struct("<BQ")
_DATA_END: Final = HEADER + 4
_BLOCK: Final = 1 << 20
#: Stands in the head of each compressed chunk: by this the next one is found behind a damaged part.
_MARKS: Final = (b"\x04\0\0\0zstd", b"\x03\0\0\0lz4")

#: What a damaged file can raise in the libraries that decode it.
DAMAGE: Final = (McapError, struct.error, ValueError, EOFError, OSError, LookupError, ArithmeticError, MemoryError)


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
        library: what wrote the file, by its own words; "" if that is damaged.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Reads the end of the file, or walks through it.

        Args:
            file: opened for reading.
        """
        self._file = file
        self._unpacking = Unpacking()
        self._next = len(MAGIC)
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
        self._counted: defaultdict[int, int] = defaultdict(int)  # messages of the last chunk, as far as indexed
        self._data_end = 0  # where the record that ends the data begins; 0 if there is none
        self._decoded = -1  # the chunk whose messages were counted by decoding it
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
        if not self._data_end:
            return
        self._file.seek(0)
        crc, left = 0, self._data_end
        while left and (block := self._file.read(min(left, _BLOCK))):
            crc = zlib.crc32(block, crc)
            left -= len(block)
        end = self._file.read(_DATA_END)
        told = int.from_bytes(end[HEADER:], "little")
        if end[:1] != bytes([Opcode.DATA_END]) or (told and told != crc):
            self.damage = [*self.damage, "the sum of its bytes is not the one that it was closed with"]

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

    # --- a finished file -------------------------------------------------------------------------------------------

    def _read_summary(self) -> None:
        size = self._file.seek(0, io.SEEK_END)
        self._file.seek(max(size - len(MAGIC) - _FOOTER, 0))
        end = self._file.read()
        if len(end) != _FOOTER + len(MAGIC) or not end.endswith(MAGIC) or end[0] != Opcode.FOOTER:
            raise EOFError
        footer = Footer.read(ReadDataStream(io.BytesIO(end[HEADER:_FOOTER])))
        if not 0 < footer.summary_start < size:
            raise EOFError  # closed, but without index
        self._file.seek(footer.summary_start)
        summary = self._file.read(size - len(MAGIC) - 4 - footer.summary_start)
        if footer.summary_crc and zlib.crc32(summary) != footer.summary_crc:
            raise EOFError
        self._take_summary(summary[: len(summary) - _FOOTER + 4], sound=footer.summary_crc != 0)
        if (not self.chunks and self.counts) or not self.channels:
            raise EOFError  # written without an index of chunks
        self._data_end = footer.summary_start - _DATA_END
        self.closed = self.whole = True

    def _take_summary(self, summary: bytes, *, sound: bool) -> None:
        starts = []
        at = 0
        while at < len(summary):
            opcode, length = _LENGTH.unpack_from(summary, at)
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
            self._learn(Schema.read(stream))
        elif opcode == Opcode.CHANNEL:
            self._learn(Channel.read(stream))
        elif opcode == Opcode.STATISTICS:
            self.counts.update(Statistics.read(stream).channel_message_counts)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            attachment = AttachmentIndex.read(stream)
            self.attachments[attachment.name] = Place(attachment.offset + HEADER, attachment.length - HEADER)
        elif opcode == Opcode.METADATA_INDEX:
            metadata = MetadataIndex.read(stream)
            self._take_metadata(Place(metadata.offset + HEADER, metadata.length - HEADER))

    def _take_metadata(self, place: Place) -> None:
        told = Metadata.read(ReadDataStream(io.BytesIO(self.read(place))))
        self.metadata[told.name] = told.metadata

    def _learn(self, record: object) -> None:
        if isinstance(record, Schema):
            self.schemas[record.id] = record.name
        elif isinstance(record, Channel):
            self.channels[record.id] = record

    # --- any other file --------------------------------------------------------------------------------------------

    def refresh(self) -> bool:
        """Walks on from where the last walk ended.

        Returns:
            Whether there is anything new; never of a file that was closed.
        """
        if self.closed:
            return False
        before = self._next
        size = self._file.seek(0, io.SEEK_END)
        at = self._next
        while at + HEADER <= size:
            self._file.seek(at)
            opcode, length = _LENGTH.unpack(self._file.read(HEADER))
            place = Place(at + HEADER, length)
            if opcode == Opcode.DATA_END and length == 4:
                self._learn_from_summary(place.offset + place.length, size)
                self.closed = self._has_end(size)
                if self.closed:
                    self._data_end = at
                    self.whole = self._ends_well(at, size)
                    at = size
                break
            beyond = place.offset + length > size
            if beyond and not self._is_damaged(opcode, place, size):
                break  # torn, or being written
            if not beyond and self._take(opcode, place):
                at = place.offset + length
                continue
            found = self._next_chunk(at + 1, size)
            if found is None:
                break
            self.damage.append(f"{found - at} bytes at byte {at} are damaged")
            at = found
        if self.chunks:
            self._count_last()  # its index may be torn off, or not be written yet
        self._next = at
        self.torn = size - at
        return at > before

    def _has_end(self, size: int) -> bool:
        self._file.seek(max(size - len(MAGIC), 0))
        return self._file.read() == MAGIC

    def _ends_well(self, data_end: int, size: int) -> bool:
        """Whether the summary is sound, or only missing because its writer wrote none."""
        behind = data_end + _DATA_END
        self._file.seek(behind)
        end = self._file.read(size - behind)
        if len(end) < _FOOTER + len(MAGIC):
            return False
        footer = Footer.read(ReadDataStream(io.BytesIO(end[-_FOOTER - len(MAGIC) + HEADER :])))
        if not footer.summary_start:
            return len(end) == _FOOTER + len(MAGIC)
        sound = footer.summary_crc in (0, zlib.crc32(end[: -len(MAGIC) - 4]))
        return sound and footer.summary_start == behind

    def _learn_from_summary(self, at: int, size: int) -> None:
        """Learns channels whose definitions are lost: the summary repeats them, also where its places are wrong."""
        while at + HEADER <= size:
            self._file.seek(at)
            opcode, length = _LENGTH.unpack(self._file.read(HEADER))
            place = Place(at + HEADER, length)
            at = place.offset + length
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or at > size:
                return
            try:
                told = (Schema if opcode == Opcode.SCHEMA else Channel).read(
                    ReadDataStream(io.BytesIO(self.read(place)))
                )
            except DAMAGE:
                return
            known: Container[int] = self.schemas if isinstance(told, Schema) else self.channels
            if told.id not in known:
                self._learn(told)

    def _is_damaged(self, opcode: int, place: Place, size: int) -> bool:
        """Whether a record that reaches beyond the end has a wrong head, rather than being cut."""
        if not Opcode.HEADER <= opcode <= Opcode.DATA_END or place.length > _LIMIT:
            return True
        if opcode == Opcode.CHUNK and place.offset + CHUNK_HEAD.size + 32 <= size:
            return not self._is_chunk(place)
        # with whole chunks behind it, it isn't the end that is torn
        return self._next_chunk(place.offset, size) is not None

    def _is_chunk(self, place: Place) -> bool:
        self._file.seek(place.offset)
        head = self._file.read(CHUNK_HEAD.size + 32)
        if len(head) < CHUNK_HEAD.size + 8:
            return False
        name = CHUNK_HEAD.unpack_from(head)[4]
        at = CHUNK_HEAD.size + name
        return bool(name <= 16 and place.length == at + 8 + int.from_bytes(head[at : at + 8], "little"))

    def _take(self, opcode: int, place: Place) -> bool:
        """Takes a whole record; False if it can't be what it says."""
        try:
            if opcode == Opcode.CHUNK:
                if place.length < CHUNK_HEAD.size + 8 or not self._is_chunk(place):
                    return False
                if self.chunks and self.chunks[-1].channels is None:
                    self._count_last()
                self._counted = defaultdict(int)
                self.chunks.append(ChunkPlace(*place, None))
            elif opcode == Opcode.MESSAGE_INDEX:
                return self._take_message_index(place)
            elif opcode == Opcode.ATTACHMENT:
                return self._take_attachment(place)
            elif opcode == Opcode.METADATA:
                self._take_metadata(place)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                kind = Schema if opcode == Opcode.SCHEMA else Channel
                self._learn(kind.read(ReadDataStream(io.BytesIO(self.read(place)))))
        except DAMAGE:
            return False
        return Opcode.HEADER <= opcode <= Opcode.DATA_END

    def _take_message_index(self, place: Place) -> bool:
        self._file.seek(place.offset)
        head = self._file.read(6)
        channel, length = int.from_bytes(head[:2], "little"), int.from_bytes(head[2:], "little")
        if place.length != 6 + length or length % 16:
            return False
        if not self.chunks or not length or self._decoded == len(self.chunks) - 1:
            return True
        entry = CHANNEL_OFFSET.pack(channel, place.offset)
        self.chunks.tell_channels((self.chunks[-1].channels or b"") + entry)
        self._counted[channel] += length // 16
        self.counts[channel] += length // 16
        if channel not in self.channels:
            self._learn_from(len(self.chunks) - 1)
        return True

    def _take_attachment(self, place: Place) -> bool:
        self._file.seek(place.offset + 16)
        stream = ReadDataStream(self._file)
        name = stream.read_prefixed_string()
        stream.read_prefixed_string()
        size = stream.read8()
        if place.length != 16 + stream.count + size + 4:
            return False
        self.attachments[name] = place
        return True

    def _learn_from(self, number: int) -> dict[int, int] | None:
        """Learns the channels that a chunk defines, and counts its messages; None if it is damaged."""
        counted: defaultdict[int, int] = defaultdict(int)
        try:
            chunk = Chunk.read(ReadDataStream(io.BytesIO(self.read(self.chunks[number]))))
            records = breakup_chunk(chunk, validate_crc=True)
        except Exception:  # noqa: BLE001  decompressors' errors have no common base; told when the chunk is read
            return None
        for record in records:
            self._learn(record)
            if isinstance(record, Message):
                counted[record.channel_id] += 1
        return counted

    def _count_last(self) -> None:
        """Counts the last chunk's messages from itself."""
        number = len(self.chunks) - 1
        if number == self._decoded:
            return
        counted = self._learn_from(number)
        if counted is None:
            return
        for channel in counted.keys() | self._counted.keys():
            self.counts[channel] += counted.get(channel, 0) - self._counted[channel]
        self.chunks.tell_channels(b"".join(CHANNEL_OFFSET.pack(channel, 0) for channel in counted))
        self._decoded = number

    def _next_chunk(self, start: int, size: int) -> int | None:
        """Offset of the first chunk at or behind a byte that is whole; None if there is none."""
        at = start
        while at < size:
            self._file.seek(at)
            block = self._file.read(_BLOCK + 64)
            found = sorted(i for mark in _MARKS for i in _all(block, mark))
            for i in found:
                offset = at + i - CHUNK_HEAD.size + 4 - HEADER
                if offset >= start and self._chunk_at(offset, size):
                    return offset
            at += _BLOCK
        return None

    def _chunk_at(self, offset: int, size: int) -> bool:
        self._file.seek(offset)
        opcode, length = _LENGTH.unpack(self._file.read(HEADER))
        place = Place(offset + HEADER, length)
        return opcode == Opcode.CHUNK and place.offset + length <= size and self._is_chunk(place)


def _all(block: bytes, mark: bytes) -> Iterator[int]:
    at = block.find(mark)
    while at >= 0:
        yield at
        at = block.find(mark, at + 1)
