"""The lifetimes of worlds: a name is free again when its world has ended, and the next one of that name is another.

The recorder gives each lifetime its own channels, so the index has the chunks of each. Where channels don't have it
(more worlds than a file has channels for, recordings of earlier releases), the changes themselves are read.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from recorder.records import Keyframe, Mutation, Record

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from replay.file.chunks import Chunks

Owner: TypeAlias = "tuple[str, int]"  # a world's name, and the number of its lifetime, from 1
_Mark: TypeAlias = "tuple[type[Record], Owner]"  # a type of record that a chunk has of a world


@dataclass(frozen=True, slots=True)
class Lifetime:
    """A world from its opening to its end.

    Attributes:
        world: its name.
        number: which world of that name it is, from 1.
        start: the step at which it was opened; 0 of the first of its name.
        stop: the step at which the next one of its name was opened; None if there is none.
        changes: numbers of the chunks with its mutations or keyframes.
        keyframes: numbers of the chunks with its keyframes.
    """

    world: str
    number: int
    start: int
    stop: int | None
    changes: Sequence[int]
    keyframes: Sequence[int]

    @property
    def title(self) -> str:
        """Its name for people; see :func:`title`."""
        return title(self.world, self.number)

    def has(self, step: int) -> bool:
        """Return whether its name means this world at a step."""
        return self.start <= step and (self.stop is None or step < self.stop)


def title(world: str, number: int) -> str:
    """Return what people call a world: its name, and which of that name it is if it isn't the first."""
    if number == 1:
        return world
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{world} ({number}{ending} of that name)"


def lifetimes_of(chunks: Chunks) -> tuple[Lifetime, ...]:
    """Return the lifetimes of all worlds, in the order of their opening."""
    found = _found(chunks)
    starts = _starts(chunks, found)
    lifetimes = []
    for owner, (changes, keyframes) in sorted(found.items(), key=lambda item: (item[1][0][0], starts[item[0]])):
        world, number = owner
        stop = starts.get((world, number + 1))
        lifetimes.append(Lifetime(world, number, starts[owner] if number > 1 else 0, stop, changes, keyframes))
    return tuple(lifetimes)


def _found(chunks: Chunks) -> dict[Owner, tuple[list[int], list[int]]]:
    """Return the numbers of the chunks that have changes of each lifetime, and of those with keyframes."""
    found: dict[Owner, tuple[list[int], list[int]]] = {}
    latest: dict[str, int] = {}  # number of the latest lifetime by name of the world
    alike: dict[bytes, list[list[int]]] = {}  # the lists to which a chunk belongs, by the ids of its channels
    for number, channels in enumerate(chunks.channel_maps()):
        ids = b"" if channels is None else channels[::10] + channels[1::10]  # low bytes, then high bytes
        belongs = alike.get(ids)
        if belongs is None:
            kinds = [(kind, owner) for kind, owner in chunks.channels(number) if kind in (Mutation, Keyframe)]
            marks: list[_Mark] = [(kind, owner) for kind, owner in kinds if owner is not None]
            exact = bool(ids) and len(marks) == len(kinds)
            if not exact:
                marks = [(type(record), _owner(record, owner, latest)) for record, owner in chunks.changes(number)]
            for _, (world, lifetime) in marks:
                latest[world] = max(lifetime, latest.get(world, 0))
            belongs = _where(found, marks)
            if exact:
                alike[ids] = belongs
        for numbers in belongs:
            numbers.append(number)
    return found


def _owner(record: Record, known: Owner | None, latest: dict[str, int]) -> Owner:
    """Return the world of a record: the one of its channel if that is known, else by counting."""
    lifetime = known[1] if known is not None else latest.get(record.world, 0)
    if not lifetime or (known is None and _opens(record)):
        lifetime += 1
    latest[record.world] = lifetime
    return record.world, lifetime


def _opens(record: Record) -> bool:
    return isinstance(record, Mutation) and record.HasField("open_world")


def _where(found: dict[Owner, tuple[list[int], list[int]]], marks: Iterable[_Mark]) -> list[list[int]]:
    """Return the lists that a chunk belongs to, by what it has."""
    belongs = []
    kinds: defaultdict[Owner, set[type[Record]]] = defaultdict(set)
    for kind, owner in marks:
        kinds[owner].add(kind)
    for owner, present in kinds.items():
        changes, keyframes = found.setdefault(owner, ([], []))
        belongs.append(changes)
        if Keyframe in present:
            belongs.append(keyframes)
    return belongs


def _starts(chunks: Chunks, found: dict[Owner, tuple[list[int], list[int]]]) -> dict[Owner, int]:
    """Return the first steps of lifetimes; 0 where nothing depends on it, to avoid reading."""
    begun: defaultdict[int, list[Owner]] = defaultdict(list)  # by chunk
    for owner, (changes, _) in found.items():
        begun[changes[0]].append(owner)
    starts = dict.fromkeys(found, 0)
    for number, owners in begun.items():
        if len(owners) > 1 or owners[0][1] > 1:
            starts |= dict.fromkeys(owners, chunks.span(number)[0]) | dict(_begun(chunks, number, owners))
    return starts


def _begun(chunks: Chunks, number: int, owners: Iterable[Owner]) -> Iterator[tuple[Owner, int]]:
    """Yield the first steps of the lifetimes that begin in a chunk, as far as it can be read."""
    waiting = sorted(owners)
    for record in chunks.records(number, (Mutation, Keyframe)):
        owner = next((each for each in waiting if each[0] == record.world), None)
        if owner is not None and (owner[1] == 1 or _opens(record)):
            waiting.remove(owner)
            yield owner, record.seq
