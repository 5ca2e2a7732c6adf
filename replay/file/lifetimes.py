"""The lifetimes of worlds: after a world has ended, another world can have the same name.

Each lifetime has its own channels, so the index shows the chunks of a lifetime. If worlds share channels, or if an
early release wrote the file, the changes themselves are read.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from recorder.records import Keyframe, Mutation, Query, Record

if TYPE_CHECKING:
    from replay.file.chunks import Chunks

Owner: TypeAlias = "tuple[str, int]"  # name of a world, and number of its lifetime from 1
#: Numbers of chunks with changes, with keyframes and with looks.
_Lists: TypeAlias = "tuple[list[int], list[int], list[int]]"
_Mark: TypeAlias = "tuple[type[Record], Owner]"  # type and world of the records in a chunk


@dataclass(frozen=True, slots=True)
class Lifetime:
    """A world from its opening to its end."""

    world: str
    number: int  # number among the worlds with this name, from 1
    start: int  # step of the world's opening; 0 for the first world with this name
    stop: int | None  # step at which the next world with this name was opened; None for the last world
    changes: Sequence[int]  # numbers of the chunks with mutations or keyframes
    keyframes: Sequence[int]  # numbers of the chunks with keyframes
    looks: Sequence[int]  # numbers of the chunks with queries that updated beliefs

    @property
    def title(self) -> str:
        """The title of the world (:func:`title`)."""
        return title(self.world, self.number)

    def has(self, step: int) -> bool:
        """Return whether a world's name means this world at a step."""
        return self.start <= step and (self.stop is None or step < self.stop)


def title(world: str, number: int) -> str:
    """Return the title of a world: the name; for later worlds with the same name, also the number."""
    if number == 1:
        return world
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{world} ({number}{ending} of that name)"


def lifetimes_of(chunks: Chunks) -> tuple[Lifetime, ...]:
    """Return the lifetimes of all worlds in the order of their opening."""
    chunks_of = _chunks_by_lifetime(chunks)
    beginning: defaultdict[int, list[Owner]] = defaultdict(list)  # the lifetimes that begin in each chunk
    for owner, (changes, *_) in chunks_of.items():
        beginning[changes[0]].append(owner)
    starts = dict.fromkeys(chunks_of, 0)  # 0 if no caller needs the step, because reading steps takes time
    for first, owners in beginning.items():
        if len(owners) > 1 or owners[0][1] > 1:
            starts |= dict.fromkeys(owners, chunks.span(first)[0]) | dict(_first_steps(chunks, first, owners))
    ordered = sorted(chunks_of.items(), key=lambda item: (item[1][0][0], starts[item[0]]))
    return tuple(
        Lifetime(world, number, starts[world, number] if number > 1 else 0, starts.get((world, number + 1)), *lists)
        for (world, number), lists in ordered
    )


def _chunks_by_lifetime(chunks: Chunks) -> dict[Owner, _Lists]:
    chunks_of: dict[Owner, _Lists] = {}
    shared = chunks.share_worlds()
    last_number: dict[str, int] = {}  # number of the latest lifetime, by name of the world
    lists_by_channels: dict[bytes, list[list[int]]] = {}  # lists that get a chunk's number, by channels
    for number, channels in enumerate(chunks.channel_maps()):
        # first the low bytes of all ids, then the high bytes
        ids = b"" if channels is None else channels[::10] + channels[1::10]
        lists = lists_by_channels.get(ids)
        if lists is None:
            kinds = [each for each in chunks.channels(number) if each[0] in (Mutation, Keyframe, Query)]
            marks: list[_Mark] = [(kind, owner) for kind, owner in kinds if owner is not None]
            exact = bool(ids) and (len(marks) == len(kinds) or not shared)
            if not exact:
                marks = [(type(record), _owner(record, owner, last_number)) for record, owner in chunks.changes(number)]
            for _, (world, lifetime) in marks:
                last_number[world] = max(lifetime, last_number.get(world, 0))
            lists = _lists(chunks_of, marks)
            if exact:
                lists_by_channels[ids] = lists
        for numbers in lists:
            numbers.append(number)
    return {owner: lists for owner, lists in chunks_of.items() if lists[0]}  # changes of other worlds would be lost


def _owner(record: Record, channel_owner: Owner | None, last_number: dict[str, int]) -> Owner:
    """Return the lifetime of a record: the lifetime of the channel, or else the number of openings so far."""
    lifetime = channel_owner[1] if channel_owner is not None else last_number.get(record.world, 0)
    if not lifetime or (channel_owner is None and _opens(record)):
        lifetime += 1
    last_number[record.world] = lifetime
    return record.world, lifetime


def _opens(record: Record) -> bool:
    return isinstance(record, Mutation) and record.HasField("open_world")


def closes_world(record: Record) -> bool:
    """Return whether a record closes a world."""
    return isinstance(record, Mutation) and record.HasField("close_world")


def _lists(chunks_of: dict[Owner, _Lists], marks: Iterable[_Mark]) -> list[list[int]]:
    lists = []
    kinds: defaultdict[Owner, set[type[Record]]] = defaultdict(set)
    for kind, owner in marks:
        kinds[owner].add(kind)
    for owner, present in kinds.items():
        changes, keyframes, looks = chunks_of.setdefault(owner, ([], [], []))
        if Keyframe in present or Mutation in present:
            lists.append(changes)
        if Keyframe in present:
            lists.append(keyframes)
        if Query in present:
            lists.append(looks)
    return lists


def _first_steps(chunks: Chunks, number: int, owners: Iterable[Owner]) -> Iterator[tuple[Owner, int]]:
    """Yield the first steps of the lifetimes that begin in a chunk, until a damaged part."""
    waiting = sorted(owners)
    for record in chunks.records(number, (Mutation, Keyframe)):
        owner = next((each for each in waiting if each[0] == record.world), None)
        if owner is not None and (owner[1] == 1 or _opens(record)):
            waiting.remove(owner)
            yield owner, record.seq
