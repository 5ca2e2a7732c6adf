"""The origins of a failure's values, as data and as text."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from replay.history.source import Line
from replay.report import phrases

if TYPE_CHECKING:
    from collections.abc import Iterator

_MAX_ROWS: Final = 12  # largest number of lines of the plan that are shown
_MAX_EARLIER: Final = 6  # of which at most this number are about earlier calls
_WIDTH: Final = 110
_WORDS: Final = {
    "default": " by default",
    "read": ", read after step {}",
    "answer": ", answered at step {}",
}


@dataclass(frozen=True, slots=True)
class Origin:
    """A value of the plan, the line that made it, and the values that it was made from."""

    #: "call", "value", "argument", "default", "item" (of a container or loop), "returned", "condition", "change" (of a
    #: container or object), "read" (of an object's state) or "answer" (of a query or motion)
    kind: str
    name: str  # the expression
    value: str  # its value as text; "" if it is unknown
    number: Any  # its value, if it is a number or a list of numbers
    file: str
    line: int
    text: str  # text of the line
    step: int  # the last step before it; -1 if unknown
    body: str  # name of the object that was read
    parts: tuple[Origin, ...]  # the values that it was made from
    moved: str = ""  # how the object that was read has moved since then, in words

    @classmethod
    def of(cls, data: dict[str, Any], moved: tuple[str, str]) -> Origin:
        """Return an origin from JSON data; files are in the plan's own folder."""
        parts = tuple(cls.of(each, moved) for each in data["parts"])
        return cls(**{**data, "file": data["file"].replace(*moved), "parts": parts})


@dataclass(frozen=True, slots=True)
class Origins:
    """The origins of a failure's values."""

    failed: Origin | None  # the call or line that failed; None if it isn't in the plan's files
    earlier: tuple[Origin, ...]  # calls of the plan that made the causes
    guesses: tuple[str, ...] = ()  # possible mistakes that would explain a number
    notes: tuple[str, ...] = ()  # why the facts may be incomplete

    def lines(self) -> Iterator[str]:
        """Yield the plan's lines that made the values, nearest first, and the guesses."""
        known: set[tuple[str, int]] = set()
        rows = [row for each in self.earlier for row in _rows(each, known, _MAX_EARLIER)]
        own = [] if self.failed is None else [*_rows(self.failed, known, _MAX_ROWS - min(len(rows), _MAX_EARLIER))]
        yield from own
        yield from rows[: _MAX_ROWS - len(own)]
        yield from (f"perhaps {each}" for each in self.guesses)
        yield from (f"note: {each}" for each in self.notes)


# --- as text ----------------------------------------------------------------------------------------------------------


def _rows(origin: Origin, known: set[tuple[str, int]], count: int) -> Iterator[str]:
    """Yield the nearest lines of the plan, each with its values."""
    ranks: dict[tuple[str, int], float] = {}
    facts: dict[tuple[str, int], list[Origin]] = defaultdict(list)
    for depth, each in _walk(origin, 0):
        place = each.file, each.line
        facts[place].append(each)
        ranks[place] = min(ranks.get(place, depth), depth)
    fresh = [place for place in sorted(ranks, key=lambda place: ranks[place]) if place not in known]
    for place in fresh[:count]:
        known.add(place)
        text, values = facts[place][0].text, dict.fromkeys(filter(None, map(_said, facts[place])))
        at = phrases.place(Line(*place))
        yield f"{at}  {text}" + (f"  # {phrases.short('; '.join(values))}" if values else "")


def _walk(origin: Origin, depth: float) -> Iterator[tuple[float, Origin]]:
    """Yield the facts with their distance from the failure; objects count as far away."""
    yield depth, origin
    for part in origin.parts:
        away = 1.0
        if part.kind == "condition":
            away = 2.0
        elif "Object(" in part.text or (part.kind == "change" and "Object(" in origin.text):
            away = 4.0
        elif part.moved:
            away = -2.0
        yield from _walk(part, depth + away)


def _said(origin: Origin) -> str:
    """Return the value of a fact, unless its line says it."""
    if origin.kind in ("call", "change") or not origin.value:
        return ""
    said = f"{origin.name} = {origin.value}" + _WORDS.get(origin.kind, "").format(origin.step)
    if origin.kind == "condition":
        said = f"{origin.name} is {origin.value}"
    return "" if said == origin.text else said + (f"; {origin.moved}" if origin.moved else "")
