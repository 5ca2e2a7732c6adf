"""The origins of a failure's values, as data and as text."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, Final

from replay.history.source import Line
from replay.report import phrases

_MAX_ROWS: Final = 12  # largest number of lines of the plan that are shown
_EARLIER: Final = 1.5  # rank of calls before the failed one; if they decided, they come before it
_LATER: Final = 0.2  # added for each call before it
_SUSPECT: Final = 3.0  # by how much a remark or a guess raises a line
_SLIP: Final = 20.0  # by how much a likely slip raises a line
_CHECKED: Final = 3.0  # rank of a line that only checks a value that another line made
_PASSING: Final = 2.5  # by how much a line without numbers comes after a line with numbers
_CHANGING: Final = 1.0  # by how much a line that changes a container comes before others
_LOADING: Final = 2.0  # by how much a line that loads an object comes after others
_CONTROL: Final = ("for ", "with ", "while ", "if ", "elif ", "return ")
_CONTROLLING: Final = 0.5  # by how much a line that controls the flow comes before others
_PARKING: Final = 2.0  # by how much a line that parks arms comes after others
_FURTHER: Final = {"condition": 1.5, "before": 1.0}  # added to the rank of such a part
_LAST: Final = 100.0  # added to the rank of the failed call, unless it has numbers
_HARMLESS: Final = ("", "hides", "line", "lines")  # first words of remarks that don't raise a line
_WORDS: Final = {"default": " by default", "read": ", read after step {}", "answer": ", answered at step {}"}


@dataclass(frozen=True, slots=True)
class Origin:
    """A value of the plan, the line that made it, and the values from which it was made."""

    #: "call", "value", "argument", "default", "item" (of a container or loop), "returned", "condition", "change" (of a
    #: container or object), "read" (of an object's state) or "answer" (of a query or motion),
    #: or "before" (a call in the statements just before)
    kind: str
    name: str  # the expression
    value: str  # the value as text; "" if unknown
    number: Any  # the value, if it is a number or a list of numbers
    file: str
    line: int
    text: str  # text of the line that made the value
    step: int  # the last recorded step before it; -1 if unknown
    own: float  # how much of its own the line has: 1 for numbers, 0.5 for texts, 0 if it only passes values on
    body: str  # name of the object that was read
    remark: str  # what is unusual about the value, in words
    parts: tuple[Origin, ...]  # the values from which it was made
    moved: str = ""  # text: how the object has moved since it was read

    @property
    def place(self) -> tuple[str, int]:
        """The file and the number of the line."""
        return self.file, self.line

    @classmethod
    def of(cls, data: dict[str, Any], moved: tuple[str, str]) -> Origin:
        """Return an origin from JSON data; files are in the plan's own folder."""
        parts = tuple(cls.of(each, moved) for each in data["parts"])
        return cls(**{**data, "file": data["file"].replace(*moved), "parts": parts})


@dataclass(frozen=True, slots=True)
class PossibleMistake:
    """A mistake that would explain a number."""

    text: str
    file: str
    line: int
    source: str = ""  # the line, for a mistake that the source alone shows
    likely: bool = True

    @property
    def place(self) -> tuple[str, int]:
        """The file and the number of its line."""
        return self.file, self.line


@dataclass(frozen=True, slots=True)
class Origins:
    """The origins of a failure's values."""

    failed: Origin | None  # the call or line that failed; None if it isn't in the files of the plan
    earlier: tuple[Origin, ...]  # calls of the plan that led to the failure
    program: str  # the plan's main file; lines of other files come later
    decided: int = 0  # how many of these calls made a cause that explains the failure
    guesses: tuple[PossibleMistake, ...] = ()
    notes: tuple[str, ...] = ()  # why the facts may be incomplete
    lacks_step: bool = False  # whether a step before the failed call is missing, so the call's own line counts
    checked: bool = False  # whether the failed line checks a value, and the call that wrote the value is known

    def lines_of(self, name: str) -> list[int]:
        """Return the numbers of the lines of a file that made the values, the most probable first."""
        return [line for file, line in self._ranked()[0] if PurePath(file).name == name]

    def stale_of(self, name: str) -> set[int]:
        """Return the numbers of the lines of a file that use outdated values."""
        stale = (each for each in self._facts() if each.moved or "since then" in each.remark or _returns_stale(each))
        return {each.line for each in stale if PurePath(each.file).name == name}

    def points(self) -> list[list[float]]:
        """Return the lists of numbers from which the values were computed."""
        return [each.number for each in self._facts() if isinstance(each.number, list)]

    def _facts(self) -> Iterator[Origin]:
        return (each for call in (self.failed, *self.earlier) if call is not None for _, each in _walk(call, 0.0))

    def _ranked(self) -> tuple[list[tuple[str, int]], dict[tuple[str, int], list[Origin]]]:
        """Return the places of lines, the most probable first, and the facts about each line."""
        ranks: dict[tuple[str, int], float] = {}
        facts: dict[tuple[str, int], list[Origin]] = defaultdict(list)
        guessed = {each.place: _SLIP if each.source else _SUSPECT for each in self.guesses if each.likely}
        ranks |= {each.place: 0.0 for each in self.guesses if each.source and each.likely}
        for number, call in enumerate((self.failed, *self.earlier)):
            start = _EARLIER if number > self.decided else -_EARLIER if number else _CHECKED * self.checked
            known = set(facts)
            decided = 0 < number <= self.decided
            for rank, each in _walk(call, start + _LATER * number, decided=decided) if call is not None else ():
                place = each.place
                if place not in known:  # an earlier call had other values at this place
                    facts[place].append(each)
                raised = (each.file != self.program) - guessed.get(place, 0.0)
                if each is self.failed:
                    raised += -_SUSPECT if self.lacks_step else _LAST * (each.own < 1 or self.checked)
                ranks[place] = min(ranks.get(place, rank + raised), rank + raised)
        return sorted(ranks, key=lambda place: ranks[place]), facts

    def lines(self) -> Iterator[str]:
        """Yield the plan's lines that made the values, the most probable first, and the guesses."""
        ranked, facts = self._ranked()
        if self.failed is not None and self.failed.place not in ranked[: _MAX_ROWS - 1]:
            ranked[_MAX_ROWS - 1 :] = [self.failed.place]
        slips = {each.place: each for each in self.guesses if each.source}
        for place in ranked[:_MAX_ROWS]:
            text = facts[place][0].text if facts[place] else slips[place].source
            newest = {each.name: each for each in sorted(facts[place], key=lambda each: each.step)}
            values = dict.fromkeys(filter(None, (_said(each, newest[each.name]) for each in facts[place])))
            comment = f"  # {phrases.short('; '.join(values))}" if values else ""
            yield f"{phrases.place(Line(*place))}  {text}{comment}"
            yield from [f"    perhaps: {slips[place].text}"] if place in slips else ()
            remarks = (f"{each.name}: {said}" for each in facts[place] for said in (each.remark, each.moved) if said)
            yield from (f"    {each}" for each in dict.fromkeys(remarks))
        others = (each for each in self.guesses if each.place not in ranked[:_MAX_ROWS] or not each.source)
        yield from (f"perhaps {each.text}{phrases.at(Line(*each.place))}" for each in others)
        yield from (f"note: {each}" for each in self.notes)


def _walk(origin: Origin, rank: float, *, decided: bool = False) -> Iterator[tuple[float, Origin]]:
    """Yield the facts with their ranks: those far from the failure, or that only pass values on, come last."""
    strange = origin.remark.partition(" ")[0] not in _HARMLESS or _returns_stale(origin)
    own = rank - _SUSPECT * (strange or bool(origin.moved)) + _LOADING * ("Object(" in origin.text)
    own += _PARKING * ('"park"' in origin.text) - _CONTROLLING * origin.text.startswith(_CONTROL)
    if origin.kind == "change":
        own -= _CHANGING
    elif not strange and (not decided or origin.name.endswith((".settle", ".simulate"))):
        own += _PASSING * (1.0 - origin.own)
    yield own, origin
    for part in origin.parts:
        yield from _walk(part, rank + 0.5 + origin.own / 2 + _FURTHER.get(part.kind, 0.0))


def _returns_stale(origin: Origin) -> bool:
    """Return whether a value comes from a call that read an object which has moved since then."""

    def is_stale(part: Origin) -> bool:
        return bool(part.moved) or any(map(is_stale, part.parts) if part.kind in ("value", "returned") else ())

    return origin.kind == "value" and any(part.kind == "returned" and is_stale(part) for part in origin.parts)


def _said(origin: Origin, newest: Origin) -> str:
    """Return the value in a fact; "" if the text of its line already shows it. An earlier value has its step."""
    if origin.kind in ("call", "change", "before") or not origin.value:
        return ""
    said = f"{origin.name} = {origin.value}" + _WORDS.get(origin.kind, "").format(origin.step)
    if origin.kind == "condition":
        said = f"{origin.name} is {origin.value}"
    if origin.step < newest.step and origin.value != newest.value and origin.kind not in ("read", "answer"):
        said += f" after step {origin.step}"
    return "" if said == origin.text.replace('"', "'") else said
