"""Where the chunks of a file lie, and how its format frames them.

A recording of a million records has 20,000 of them, and a question needs a few. So what the file's summary says of a
chunk stays as it is until it is asked for.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

MAGIC: Final = b"\x89MCAP0\r\n"  # the first bytes, and the last
HEADER: Final = 9  # bytes of opcode and length before each MCAP record
LENGTH: Final = struct.Struct("<BQ")  # these two
DATA_END: Final = HEADER + 4  # bytes of the record that ends the data
FOOTER: Final = HEADER + 20  # bytes of the last record
CHANNEL_OFFSET: Final = struct.Struct("<HQ")
_CHUNK_INDEX: Final = struct.Struct("<QQQQI")  # start, end, offset, length; bytes of the map that follows
_MAP_LENGTH: Final = struct.Struct("<I")


class Place(NamedTuple):
    """Where an MCAP record's content lies: the file's offset, behind opcode and length, and its own length."""

    offset: int
    length: int


class ChunkPlace(NamedTuple):
    """A chunk: where its content lies, and which channels have messages in it.

    ``channels`` has 10 bytes for each channel, as MCAP's chunk index has them; None where nothing says it.
    """

    offset: int
    length: int
    channels: bytes | None

    def ids(self) -> Iterator[int]:
        """Ids of the channels that have messages in this chunk."""
        return (channel for channel, _ in CHANNEL_OFFSET.iter_unpack(self.channels or b""))


class ChunkPlaces:
    """The chunks in the file's order: those of its summary, or found by walking."""

    def __init__(self) -> None:
        self._summary = b""
        self._items: list[int | ChunkPlace] = []  # an int is the place in the summary

    def take_summary(self, summary: bytes, starts: Iterable[int]) -> None:
        """Takes all chunks of a file's summary.

        Args:
            summary: its bytes.
            starts: where in it the contents of the chunk indexes begin.
        """
        self._summary = summary
        self._items = list(starts)

    def append(self, place: ChunkPlace) -> None:
        """Adds the next chunk."""
        self._items.append(place)

    def tell_channels(self, channels: bytes) -> None:
        """Says of the last chunk which channels have messages in it."""
        self._items[-1] = self[-1]._replace(channels=channels)

    def clear(self) -> None:
        """Forgets all."""
        self._items.clear()

    def channel_maps(self) -> Iterator[bytes | None]:
        """What :class:`ChunkPlace` has as ``channels``, of each chunk."""
        summary = self._summary
        for item in self._items:
            if isinstance(item, ChunkPlace):
                yield item.channels
            else:
                first = item + _CHUNK_INDEX.size
                (length,) = _MAP_LENGTH.unpack_from(summary, first - _MAP_LENGTH.size)
                yield summary[first : first + length] or None

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, number: int) -> ChunkPlace:
        item = self._items[number]
        if isinstance(item, ChunkPlace):
            return item
        _, _, offset, size, length = _CHUNK_INDEX.unpack_from(self._summary, item)
        first = item + _CHUNK_INDEX.size
        return ChunkPlace(offset + HEADER, size - HEADER, self._summary[first : first + length] or None)
