"""The records in a recording's chunks: they are decompressed on demand, and found by binary search.

Damaged parts are noted and left out.
"""

from __future__ import annotations

import math
import struct
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from google.protobuf.message import DecodeError
from mcap.opcode import Opcode

from recorder.records import PACKAGE, TOPICS, Envelope, Keyframe, Mutation, Query, Record, known_definitions
from recorder.records.beliefs import is_look
from replay.file.index import Index
from replay.file.lifetimes import Owner
from replay.file.mcap_format import CHUNK_DAMAGE, HEADER, LENGTH, ChunkExtent, Extent, decode, describe, framed

Kinds: TypeAlias = type[Record] | tuple[type[Record], ...]

KINDS: Final[Mapping[str, type[Record]]] = {topic.removeprefix("/"): kind for kind, topic in TOPICS.items()}
MAX_STEP: Final = 1 << 40  # all steps are below this number. Larger numbers are damage.
_CACHED: Final = 64  # largest number of cached chunks
#: Maximum number of cached bytes, not counting the last chunk. Decoded chunks may need fifty times as much memory.
_CACHED_BYTES: Final = 2 << 20
_MAX_DIGITS: Final = 9  # maximum number of digits in the lifetime of a world
_PACKAGE: Final = f"{PACKAGE}."
_OPCODE: Final = int(Opcode.MESSAGE)
_MESSAGE: Final = struct.Struct("<BQH")  # the fields opcode, length and channel of an MCAP message
_CHANNEL: Final = struct.Struct("<HI")  # the first fields of an MCAP message: channel, sequence
_FIELDS: Final = 22  # size in bytes of the fields of an MCAP message
_PAYLOAD: Final = HEADER + _FIELDS  # number of bytes before the payload of an MCAP message
_MESSAGES: Final = 100  # number of messages in each chunk of sorted messages
_IN_MEMORY: Final = 16 << 20  # number of bytes up to which an inflated chunk stays in memory
_OFFSET: Final = 40  # number of low bits of a sort key that contain an offset in a file; other bits contain the step


@dataclass(slots=True)
class _Entries:
    """The records of a chunk: channels, payloads, decoded records by index, and size in bytes."""

    channels: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)
    decoded: dict[int, Record | None] = field(default_factory=dict)
    size: int = 0


class Chunks:
    """The chunks of a file."""

    def __init__(self, index: Index) -> None:
        self._index = index
        self._cache: OrderedDict[int, _Entries] = OrderedDict()
        self._cached = 0  # number of bytes of all cached chunks
        self._spans: dict[int, tuple[int, int]] = {}  # first and last step of each chunk that was already read
        self.damaged: dict[int, str] = {}  # causes of known damage, by number of the chunk
        self._sorted = None if index.ours else SortedMessages(index, kinds_of(index))
        if self._sorted is not None and self._sorted.in_order:
            self._sorted.close()
            self._sorted = None
        if self._sorted is not None:
            index.damage += self._sorted.damage
            index.chunks[:] = self._sorted.chunks
        self.refresh(0)

    def __len__(self) -> int:
        return len(self._index.chunks)

    def close(self) -> None:
        """Remove the temporary file, if there is one."""
        if self._sorted is not None:
            self._sorted.close()

    def contents(self, number: int) -> tuple[bytes, str, int | None]:
        """Return the messages of a chunk, as :meth:`replay.file.index.Index.contents` does."""
        if self._sorted is None:
            return self._index.contents(number)
        self._index.check_open()
        return self._sorted.contents(number), "", None

    def grow(self) -> bool:
        """Read new chunks of a growing file; return whether there were new chunks."""
        last = len(self) - 1
        if self._sorted is not None or not self._index.refresh():
            return False
        self.refresh(last)
        return True

    def channel_maps(self) -> Iterator[bytes | None]:
        """Return the field ``channels`` of each chunk (:class:`replay.file.mcap_format.ChunkExtent`)."""
        return (chunk.channels for chunk in self._index.chunks)

    def refresh(self, number: int) -> None:
        """Drop the caches of a chunk and of all later chunks."""
        for cache in (self._cache, self._spans, self.damaged):
            for key in [cached for cached in cache if cached >= number]:
                del cache[key]
        self._cached = sum(entries.size for entries in self._cache.values())
        self._kinds = kinds_of(self._index)
        self._worlds: dict[int, str | None] = {}  # name of the channel's world
        self._owners: dict[int, Owner | None] = {}  # lifetime of the channel's world; None for shared channels
        for channel in self._kinds:
            metadata = self._index.channels[channel].metadata
            self._worlds[channel] = world = metadata.get("world")
            lifetime = metadata.get("life", "")
            known = lifetime.isdecimal() and len(lifetime) <= _MAX_DIGITS
            self._owners[channel] = (world, int(lifetime)) if world is not None and known else None

    # --- contents of a chunk ----------------------------------------------------------------------------------------

    def channels(self, number: int) -> list[tuple[type[Record], Owner | None]]:
        """Return the record type and the lifetime of each channel of a chunk.

        Channels that several worlds share have no lifetime.
        """
        chunk = self._index.chunks[number]
        ids = self._kinds if chunk.channels is None else chunk.ids()
        return [(self._kinds[channel], self._owners[channel]) for channel in ids if channel in self._kinds]

    def records(
        self,
        number: int,
        kinds: Kinds | None = None,
        world: str | None = None,
        *,
        backwards: bool = False,
        naming: str = "",
    ) -> Iterator[Record]:
        """Yield the records of a chunk with given types, in a world, and with the text ``naming`` in a field.

        Records of other types aren't decoded.
        """
        types = kinds if isinstance(kinds, tuple) or kinds is None else (kinds,)
        if types is not None and not any(kind in types for kind, _ in self.channels(number)):
            return
        text = naming.encode(errors="replace")
        entries = self._load(number, text)
        indices = range(len(entries.channels))
        for at in reversed(indices) if backwards else indices:
            channel = entries.channels[at]
            if types is not None and self._kinds[channel] not in types:
                continue
            if world is not None and self._worlds[channel] not in (None, world):
                continue
            if text not in entries.payloads[at]:
                continue
            record = self._decode(number, entries, at)
            if record is not None and (world is None or record.world == world):
                yield record

    def misplaced(self, number: int, record: Record) -> None:
        """Add a record's impossible step to the known damage of its chunk."""
        self.damaged.setdefault(number, f"a {type(record).__name__} has the impossible step {record.seq}")

    def share_worlds(self) -> bool:
        """Return whether worlds share channels, so that only records name their worlds."""
        return any(self._owners[at] is None for at, kind in self._kinds.items() if kind in (Mutation, Keyframe))

    def changes(self, number: int) -> Iterator[tuple[Record, Owner | None]]:
        """Yield the mutations, keyframes and looks of a chunk, with the lifetimes of their channels."""
        entries = self._load(number)
        for at, channel in enumerate(entries.channels):
            if self._kinds[channel] in (Mutation, Keyframe, Query):
                record = self._decode(number, entries, at)
                if record is not None and (not isinstance(record, Query) or is_look(record)):
                    yield record, self._owners[channel]

    # --- search for a step -------------------------------------------------------------------------------------------

    def span(self, number: int) -> tuple[int, int]:
        """Return the first and last step of a chunk; for an unreadable chunk, the first step is larger."""
        for at in range(number, -1, -1):
            if at not in self._spans:
                first = next(self.records(at), None)
                last = next(self.records(at, backwards=True), None)
                if first is None or last is None:
                    continue
                self._spans[at] = first.seq, last.seq
            first_step, last_step = self._spans[at]
            return (first_step, last_step) if at == number else (last_step + 1, last_step)
        return 0, -1

    def chunk_of(self, step: int) -> int:
        """Return the number of the last chunk that begins at or before a step."""
        return max(0, bisect_right(range(len(self)), step, key=lambda number: self.span(number)[0]) - 1)

    # --- decoding --------------------------------------------------------------------------------------------------

    def _load(self, number: int, text: bytes = b"") -> _Entries:
        """Return the entries of a chunk; no entries if the chunk doesn't contain ``text``."""
        if number in self._cache:
            self._cache.move_to_end(number)
            return self._cache[number]
        entries = _Entries()
        try:
            contents, fault, stated = self.contents(number)
            if fault:
                self.damaged.setdefault(number, fault)
            if text not in contents:
                return entries
            entries.size = len(contents)
            found = self._divide(contents, entries)
            if stated is not None and stated != found:
                self.damaged.setdefault(number, f"it has {found} messages, but the index states {stated}")
        except CHUNK_DAMAGE as error:
            self.damaged.setdefault(number, describe(error))
        self._cache[number] = entries
        self._cached += entries.size
        while len(self._cache) > 1 and (len(self._cache) > _CACHED or self._cached > _CACHED_BYTES):
            self._cached -= self._cache.popitem(last=False)[1].size
        return entries

    def _divide(self, contents: bytes, entries: _Entries) -> int:
        """Split a chunk into records, and return the number of messages."""
        channels, payloads = entries.channels.append, entries.payloads.append
        unpack, kinds, end = _MESSAGE.unpack_from, self._kinds, len(contents)
        at = others = 0
        while at < end:
            opcode, length, channel = unpack(contents, at)
            behind = at + HEADER + length
            if opcode != _OPCODE:
                pass
            elif channel in kinds:
                channels(channel)
                payloads(contents[at + _PAYLOAD : behind])
            else:
                others += 1
            at = behind
        if at != end:
            raise ValueError("its last message is cut off")
        return len(entries.channels) + others

    def _decode(self, number: int, entries: _Entries, at: int) -> Record | None:
        if at in entries.decoded:
            return entries.decoded[at]
        record: Record | None
        try:
            record = decode(self._kinds[entries.channels[at]], entries.payloads[at])
        except DecodeError as error:
            self.damaged.setdefault(number, str(error))
            record = None
        if record is not None and not 0 <= record.seq < MAX_STEP:
            self.misplaced(number, record)
            record = None
        if entries.size <= _CACHED_BYTES:
            entries.decoded[at] = record
        return record


def kinds_of(index: Index) -> dict[int, type[Record]]:
    """Return the type of records for each channel, except channels of other programs."""
    kinds, ours = {}, known_definitions()
    for number, channel in index.channels.items():
        kind = KINDS.get(channel.topic[1:]) if channel.topic.startswith("/") else None
        message = index.schemas.get(channel.schema_id, "")
        if kind is not None and message == kind.DESCRIPTOR.full_name:
            kinds[number] = kind
        elif kind is None and message.startswith(_PACKAGE) and message.removeprefix(_PACKAGE) not in ours:
            kinds[number] = Envelope  # a newer release has this kind of record
    return kinds


# --- files of other programs ------------------------------------------------------------------------------------------


class SortedMessages:
    """The messages of a file in the order of steps, in chunks of the same size as the recorder's.

    Files of other programs may have other chunks, or no chunks, and messages in any order. Such a file is read once
    into a temporary file, because inflating a large chunk again for each record could take hours.
    """

    def __init__(self, index: Index, kinds: Mapping[int, type[Record]]) -> None:
        from tempfile import SpooledTemporaryFile  # noqa: PLC0415  slow to import

        self._file = SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115
        self.damage: list[str] = []
        self.in_order = not index.loose  # whether the file already has all records in chunks and in order
        self._keys: list[int] = []  # a key of each message (:data:`_OFFSET`); a file may have millions of messages
        last = at = 0
        for where, message in _messages(index, self.damage):
            try:
                # a message for other tools has the step of its record as its sequence number
                channel, step = _CHANNEL.unpack_from(message, HEADER)
                if channel in kinds:  # some programs change the numbers of messages, but not the steps in records
                    step = decode(kinds[channel], message[HEADER + _FIELDS :]).seq
                    self.in_order = self.in_order and last <= step
                    last = step
            except (DecodeError, struct.error) as error:
                self.damage.append(f"the message at {where} is damaged ({describe(error)})")
                continue
            self._keys.append(step << _OFFSET | at)
            at += self._file.write(message)
        self._keys.sort()
        self.chunks = [ChunkExtent(0, 0)] * math.ceil(len(self._keys) / _MESSAGES)

    def close(self) -> None:
        """Remove the temporary file."""
        self._file.close()

    def contents(self, number: int) -> bytes:
        """Return the messages of a chunk."""
        messages = []
        for key in self._keys[number * _MESSAGES : (number + 1) * _MESSAGES]:
            self._file.seek(key & ((1 << _OFFSET) - 1))
            head = self._file.read(HEADER)
            messages += [head, self._file.read(LENGTH.unpack(head)[1])]
        return b"".join(messages)


def _messages(index: Index, damage: list[str]) -> Iterator[tuple[str, bytes]]:
    """Yield each message of a file, and its place in the file as text."""
    for number in range(len(index.chunks)):
        try:
            contents = index.contents(number)[0]
            for opcode, start, stop in framed(contents):
                if opcode == Opcode.MESSAGE:
                    yield f"byte {start - HEADER} of chunk {number}", contents[start - HEADER : stop]
        except CHUNK_DAMAGE as error:
            damage.append(f"chunk {number} is damaged ({describe(error)})")
    for extent in index.loose:
        yield f"byte {extent.offset - HEADER}", index.read(Extent(extent.offset - HEADER, extent.length + HEADER))
