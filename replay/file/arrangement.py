"""The records of a file that another program has written, in the order of their steps.

Such a copy of a recording may have other chunks or none, and its messages in any order. It is read once, for where each
record is; then its records are handed out as chunks like those that the recorder makes.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

from google.protobuf.message import DecodeError
from mcap.opcode import Opcode

from replay.errors import LogClosed
from replay.file.mcap_format import CHANNEL_OFFSET, HEADER, LENGTH, ChunkExtent, Extent, describe

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.records import Record
    from replay.file.index import Index

_MESSAGES: Final = 100  # of a chunk
_CACHED: Final = 16  # chunks of the file
_CHANNEL: Final = struct.Struct("<HI")  # channel, sequence
_FIELDS: Final = 22  # bytes of a message's fields, of which these are the first
_LOOSE: Final = -1


class _Place(NamedTuple):
    """A record: its step; its chunk's number, or -1; where its message begins in that, or in the file; its length."""

    step: int
    chunk: int
    offset: int
    length: int
    channel: int


class Arrangement:
    """The records of a file in the order of their steps.

    Attributes:
        chunks: what takes the place of the file's.
    """

    def __init__(self, index: Index, places: list[_Place]) -> None:
        self._index = index
        self._file_chunks = [index.chunks[number] for number in range(len(index.chunks))]
        self._groups = [places[start : start + _MESSAGES] for start in range(0, len(places), _MESSAGES)]
        self._decompressed = lru_cache(_CACHED)(lambda number: index.decompressed(self._file_chunks[number]))
        self.chunks = [
            ChunkExtent(0, 0, b"".join(CHANNEL_OFFSET.pack(channel, 0) for channel in {each.channel for each in group}))
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
        places = list(_places(index, kinds, damage))
        records = [place.step for place in places if place.channel in kinds]
        if not index.loose and all(a <= b for a, b in pairwise(records)):
            return None  # what is damaged is found when it is read
        index.damage += damage
        return cls(index, sorted(places))

    def contents(self, number: int) -> bytes:
        """Return the messages of a chunk."""
        return b"".join(map(self._message, self._groups[number]))

    def _message(self, place: _Place) -> bytes:
        if place.chunk == _LOOSE:
            return self._index.read(Extent(place.offset, place.length))
        return self._decompressed(place.chunk)[place.offset : place.offset + place.length]


def _places(index: Index, kinds: Mapping[int, type[Record]], damage: list[str]) -> Iterator[_Place]:
    for chunk, offset, message in _messages(index, damage):
        try:
            channel, step = _CHANNEL.unpack_from(message, HEADER)  # a message for other tools has its record's number
            if channel in kinds:  # a record tells its own; not all programs keep that of its message
                step = kinds[channel].FromString(message[HEADER + _FIELDS :]).seq
            yield _Place(step, chunk, offset, len(message), channel)
        except (DecodeError, struct.error) as error:
            where = f"byte {offset}" if chunk == _LOOSE else f"byte {offset} of chunk {chunk}"
            damage.append(f"the message at {where} is damaged ({describe(error)})")


def _messages(index: Index, damage: list[str]) -> Iterator[tuple[int, int, bytes]]:
    """Yield all messages, with the numbers of their chunks and where they begin in these, or in the file."""
    for number in range(len(index.chunks)):
        try:
            contents = index.contents(number)[0]
            for offset, message in _divided(contents):
                yield number, offset, message
        except LogClosed:
            raise
        except Exception as error:  # noqa: BLE001  decompressors' errors have no common base
            damage.append(f"chunk {number} is damaged ({describe(error)})")
    for extent in index.loose:
        whole = Extent(extent.offset - HEADER, extent.length + HEADER)
        yield _LOOSE, whole.offset, index.read(whole)


def _divided(contents: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the messages of a chunk, with where they begin."""
    at = 0
    while at < len(contents):
        opcode, length = LENGTH.unpack_from(contents, at)
        behind = at + HEADER + length
        if opcode == Opcode.MESSAGE:
            yield at, contents[at:behind]
        at = behind
