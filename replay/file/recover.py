"""A walk through a file that says nothing of itself: header by header, past damage to the next sound chunk.

So is found what lies where in a recording whose process was killed or still runs, and in a damaged one.
"""

from __future__ import annotations

import io
import zlib
from collections import defaultdict
from typing import TYPE_CHECKING, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Message, Schema
from mcap.stream_reader import breakup_chunk

from replay.file.layout import CHANNEL_OFFSET, DATA_END, FOOTER, HEADER, LENGTH, MAGIC, ChunkPlace, Place
from replay.file.unpack import CHUNK_HEAD, DAMAGE

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from replay.file.index import Index

_LIMIT: Final = 1 << 32  # no honest record is longer
_BLOCK: Final = 1 << 20
#: Stands in the head of each compressed chunk: by this the next one is found behind a damaged part.
_MARKS: Final = (b"\x04\0\0\0zstd", b"\x03\0\0\0lz4")


class Walk:
    """A walk that goes on when there is more.

    Args:
        file: opened for reading.
        index: what it finds goes there.
    """

    def __init__(self, file: BinaryIO, index: Index) -> None:
        self._file = file
        self._index = index
        self._next = len(MAGIC)
        self._counted: defaultdict[int, int] = defaultdict(int)  # messages of the last chunk, as far as indexed
        self._decoded = -1  # the chunk whose messages were counted by decoding it

    def go_on(self) -> bool:
        """Walks on from where the last walk ended.

        Returns:
            Whether there is anything new.
        """
        index = self._index
        before = self._next
        size = self._file.seek(0, io.SEEK_END)
        at = self._next
        while at + HEADER <= size:
            self._file.seek(at)
            opcode, length = LENGTH.unpack(self._file.read(HEADER))
            place = Place(at + HEADER, length)
            if opcode == Opcode.DATA_END and length == 4:
                self._learn_from_summary(place.offset + place.length, size)
                index.closed = self._has_end(size)
                if index.closed:
                    index.data_end = at
                    index.whole = self._ends_well(at, size)
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
            index.damage.append(f"{found - at} bytes at byte {at} are damaged")
            at = found
        if index.chunks:
            self._count_last()  # its index may be torn off, or not be written yet
        self._next = at
        index.torn = size - at
        return at > before

    def _has_end(self, size: int) -> bool:
        self._file.seek(max(size - len(MAGIC), 0))
        return self._file.read() == MAGIC

    def _ends_well(self, data_end: int, size: int) -> bool:
        """Whether the summary is sound, or only missing because its writer wrote none."""
        behind = data_end + DATA_END
        self._file.seek(behind)
        end = self._file.read(size - behind)
        if len(end) < FOOTER + len(MAGIC):
            return False
        footer = Footer.read(ReadDataStream(io.BytesIO(end[-FOOTER - len(MAGIC) + HEADER :])))
        if not footer.summary_start:
            return len(end) == FOOTER + len(MAGIC)
        sound = footer.summary_crc in (0, zlib.crc32(end[: -len(MAGIC) - 4]))
        return sound and footer.summary_start == behind

    def _learn_from_summary(self, at: int, size: int) -> None:
        """Learns channels whose definitions are lost: the summary repeats them, also where its places are wrong."""
        while at + HEADER <= size:
            self._file.seek(at)
            opcode, length = LENGTH.unpack(self._file.read(HEADER))
            place = Place(at + HEADER, length)
            at = place.offset + length
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or at > size:
                return
            try:
                told = (Schema if opcode == Opcode.SCHEMA else Channel).read(
                    ReadDataStream(io.BytesIO(self._index.read(place)))
                )
            except DAMAGE:
                return
            known: Container[int] = self._index.schemas if isinstance(told, Schema) else self._index.channels
            if told.id not in known:
                self._index.learn(told)

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
                if self._index.chunks and self._index.chunks[-1].channels is None:
                    self._count_last()
                self._counted = defaultdict(int)
                self._index.chunks.append(ChunkPlace(*place, None))
            elif opcode == Opcode.MESSAGE_INDEX:
                return self._take_message_index(place)
            elif opcode == Opcode.ATTACHMENT:
                return self._take_attachment(place)
            elif opcode == Opcode.METADATA:
                self._index.take_metadata(place)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                kind = Schema if opcode == Opcode.SCHEMA else Channel
                self._index.learn(kind.read(ReadDataStream(io.BytesIO(self._index.read(place)))))
        except DAMAGE:
            return False
        return Opcode.HEADER <= opcode <= Opcode.DATA_END

    def _take_message_index(self, place: Place) -> bool:
        self._file.seek(place.offset)
        head = self._file.read(6)
        channel, length = int.from_bytes(head[:2], "little"), int.from_bytes(head[2:], "little")
        if place.length != 6 + length or length % 16:
            return False
        if not self._index.chunks or not length or self._decoded == len(self._index.chunks) - 1:
            return True
        entry = CHANNEL_OFFSET.pack(channel, place.offset)
        self._index.chunks.tell_channels((self._index.chunks[-1].channels or b"") + entry)
        self._counted[channel] += length // 16
        self._index.counts[channel] += length // 16
        if channel not in self._index.channels:
            self._learn_from(len(self._index.chunks) - 1)
        return True

    def _take_attachment(self, place: Place) -> bool:
        self._file.seek(place.offset + 16)
        stream = ReadDataStream(self._file)
        name = stream.read_prefixed_string()
        stream.read_prefixed_string()
        size = stream.read8()
        if place.length != 16 + stream.count + size + 4:
            return False
        self._index.attachments[name] = place
        return True

    def _learn_from(self, number: int) -> dict[int, int] | None:
        """Learns the channels that a chunk defines, and counts its messages; None if it is damaged."""
        counted: defaultdict[int, int] = defaultdict(int)
        try:
            chunk = Chunk.read(ReadDataStream(io.BytesIO(self._index.read(self._index.chunks[number]))))
            records = breakup_chunk(chunk, validate_crc=True)
        except Exception:  # noqa: BLE001  decompressors' errors have no common base; told when the chunk is read
            return None
        for record in records:
            self._index.learn(record)
            if isinstance(record, Message):
                counted[record.channel_id] += 1
        return counted

    def _count_last(self) -> None:
        """Counts the last chunk's messages from itself."""
        number = len(self._index.chunks) - 1
        if number == self._decoded:
            return
        counted = self._learn_from(number)
        if counted is None:
            return
        for channel in counted.keys() | self._counted.keys():
            self._index.counts[channel] += counted.get(channel, 0) - self._counted[channel]
        self._index.chunks.tell_channels(b"".join(CHANNEL_OFFSET.pack(channel, 0) for channel in counted))
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
        opcode, length = LENGTH.unpack(self._file.read(HEADER))
        place = Place(offset + HEADER, length)
        return opcode == Opcode.CHUNK and place.offset + length <= size and self._is_chunk(place)


def _all(block: bytes, mark: bytes) -> Iterator[int]:
    at = block.find(mark)
    while at >= 0:
        yield at
        at = block.find(mark, at + 1)
