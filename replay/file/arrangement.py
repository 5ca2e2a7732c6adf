"""The records of a file that another program has written, in the order of their steps.

Such a copy of a recording may have other chunks or none, and its messages in any order. It is read once, for where each
record is; then its records are handed out as chunks like those that the recorder makes. What its own chunks hold is
kept meanwhile in a temporary file: inflated anew for each record, a large chunk could take hours.
"""

from __future__ import annotations

import struct
from array import array
from typing import TYPE_CHECKING, Final

from google.protobuf.message import DecodeError
from mcap.opcode import Opcode

from replay.errors import LogClosed
from replay.file.mcap_format import CHANNEL_OFFSET, HEADER, LENGTH, ChunkExtent, Extent, describe
from replay.file.payloads import decode

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.records import Record
    from replay.file.index import Index

_MESSAGES: Final = 100  # of a chunk
_IN_MEMORY: Final = 16 << 20  # bytes of the file's chunks
_CHANNEL: Final = struct.Struct("<HI")  # channel, sequence
_FIELDS: Final = 22  # bytes of a message's fields, of which these are the first
_LOOSE: Final = -1
_NUMBER: Final = 40  # bits of a message's number, below its step


class _Places:
    """Where the messages of a file are, as compactly as millions of them need it.

    Attributes:
        keys: the step of each, and its number in the file.
        channels: of each.
        chunks: the number of its chunk, or -1.
        offsets: where it begins in that, or in the file.
        lengths: its bytes.
        sorted: whether records are in the order of their steps.
    """

    def __init__(self) -> None:
        self.keys: list[int] = []
        self.channels, self.chunks = array("H"), array("l")
        self.offsets, self.lengths = array("Q"), array("Q")
        self.sorted = True
        self._last = -1

    def add(self, step: int, channel: int, chunk: int, extent: Extent, *, is_record: bool) -> None:
        """Add the next message."""
        if is_record:
            self.sorted = self.sorted and self._last <= step
            self._last = step
        self.keys.append(step << _NUMBER | len(self.keys))
        self.channels.append(channel)
        self.chunks.append(chunk)
        self.offsets.append(extent.offset)
        self.lengths.append(extent.length)


class Arrangement:
    """The records of a file in the order of their steps.

    Attributes:
        chunks: what takes the place of the file's.
    """

    def __init__(self, index: Index, places: _Places) -> None:
        from tempfile import SpooledTemporaryFile  # noqa: PLC0415  slow to import, and seldom needed

        self._index = index
        self._places = places
        self._inflated = SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115  close() closes it
        self._starts: dict[int, int] = {}  # of chunks in it
        for number in range(len(index.chunks)):
            if (contents := _contents(index, number, [])) is not None:
                self._starts[number] = self._inflated.tell()
                self._inflated.write(contents)
        numbers = array("Q", (key & ((1 << _NUMBER) - 1) for key in sorted(places.keys)))
        self._groups = [numbers[start : start + _MESSAGES] for start in range(0, len(numbers), _MESSAGES)]
        self.chunks = [
            ChunkExtent(
                0, 0, b"".join(CHANNEL_OFFSET.pack(channel, 0) for channel in {places.channels[at] for at in group})
            )
            for group in self._groups
        ]

    @classmethod
    def of(cls, index: Index, kinds: Mapping[int, type[Record]]) -> Arrangement | None:
        """Return the arrangement of a file; None if it needs none: its chunks have all records in their order.

        Args:
            index: of the file; what is damaged is added to it if there is an arrangement.
            kinds: types of record by channel.
        """
        damage: list[str] = []
        places = _places(index, kinds, damage)
        if not index.loose and places.sorted:
            return None  # what is damaged is found when it is read
        index.damage += damage
        return cls(index, places)

    def close(self) -> None:
        """Remove the temporary file."""
        self._inflated.close()

    def contents(self, number: int) -> bytes:
        """Return the messages of a chunk."""
        return b"".join(map(self._message, self._groups[number]))

    def _message(self, at: int) -> bytes:
        chunk, extent = self._places.chunks[at], Extent(self._places.offsets[at], self._places.lengths[at])
        if chunk == _LOOSE:
            return self._index.read(extent)
        self._inflated.seek(self._starts[chunk] + extent.offset)
        return self._inflated.read(extent.length)


def _places(index: Index, kinds: Mapping[int, type[Record]], damage: list[str]) -> _Places:
    places = _Places()
    for chunk, offset, message in _messages(index, damage):
        try:
            channel, step = _CHANNEL.unpack_from(message, HEADER)  # a message for other tools has its record's number
            is_record = channel in kinds
            if is_record:  # a record tells its own; not all programs keep that of its message
                step = decode(kinds[channel], message[HEADER + _FIELDS :]).seq
            places.add(step, channel, chunk, Extent(offset, len(message)), is_record=is_record)
        except (DecodeError, struct.error) as error:
            where = f"byte {offset}" if chunk == _LOOSE else f"byte {offset} of chunk {chunk}"
            damage.append(f"the message at {where} is damaged ({describe(error)})")
    return places


def _messages(index: Index, damage: list[str]) -> Iterator[tuple[int, int, bytes]]:
    """Yield all messages, with the numbers of their chunks and where they begin in these, or in the file."""
    for number in range(len(index.chunks)):
        contents = _contents(index, number, damage)
        try:
            for offset, message in _divided(contents or b""):
                yield number, offset, message
        except struct.error as error:
            damage.append(f"chunk {number} is damaged ({describe(error)})")
    for extent in index.loose:
        whole = Extent(extent.offset - HEADER, extent.length + HEADER)
        yield _LOOSE, whole.offset, index.read(whole)


def _contents(index: Index, number: int, damage: list[str]) -> bytes | None:
    try:
        return index.contents(number)[0]
    except LogClosed:
        raise
    except Exception as error:  # noqa: BLE001  decompressors' errors have no common base
        damage.append(f"chunk {number} is damaged ({describe(error)})")
        return None


def _divided(contents: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the messages of a chunk, with where they begin."""
    at = 0
    while at < len(contents):
        opcode, length = LENGTH.unpack_from(contents, at)
        behind = at + HEADER + length
        if opcode == Opcode.MESSAGE:
            yield at, contents[at:behind]
        at = behind
