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
_DECIDED: Final = -1.3  # rank of the calls that decided
_EARLIER: Final = 1.6  # rank of other calls before the failed one
_FAILED: Final = 0.6  # added to the rank of the failed call, or if a step is missing before it:
_LACKS: Final = -2.2
_REMARKED: Final = -1.4  # for a remark
_GUESSED: Final = -6.0
_ODD: Final = (" rounds ", " counts as ", " is text", " changes while ")  # words in remarks that count as a guess
_SLIP: Final = -20.0  # for a likely slip
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
    rank: float  # how improbable it is that its line has the mistake
    body: str  # name of the object that was read
    remark: str  # what is unusual about the value, in words
    parts: tuple[Origin, ...]  # the values from which it was made
    moved: str = ""  # text: how the object has moved since it was read

    @property
    def place(self) -> tuple[str, int]:
        """The file and the number of the line."""
        return self.file, self.line

    @property
    def is_remarkable(self) -> bool:
        """Whether something is unusual about the value."""
        return self.remark.partition(" ")[0] not in _HARMLESS or bool(self.moved)

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
        return (each for call in (self.failed, *self.earlier) if call is not None for each in _walk(call))

    def _ranked(self) -> tuple[list[tuple[str, int]], dict[tuple[str, int], list[Origin]]]:
        """Return the places of lines, the most probable first, and the facts about each line."""
        guessed = {each.place: _SLIP if each.source else _GUESSED for each in self.guesses if each.likely}
        ranks = {each.place: 0.0 for each in self.guesses if each.source and each.likely}
        facts: dict[tuple[str, int], list[Origin]] = defaultdict(list)
        for number, call in enumerate((self.failed, *self.earlier)):
            start = _EARLIER if number > self.decided else _DECIDED if number else 0.0
            known = set(facts)
            for each in _walk(call) if call is not None else ():
                place = each.place
                if place not in known:  # an earlier call had other values at this place
                    facts[place].append(each)
                rank = start + each.rank + _REMARKED * each.is_remarkable + (each.file != self.program)
                rank += _GUESSED * any(words in each.remark for words in _ODD)
                if self.failed is not None and place == self.failed.place:
                    rank += _LACKS if self.lacks_step else _FAILED
                ranks[place] = min(ranks.get(place, rank), rank)
        ranks |= {place: ranks[place] + raised for place, raised in guessed.items() if place in ranks}
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


def _walk(origin: Origin) -> Iterator[Origin]:
    """Yield the facts, those nearest to the failure first."""
    yield origin
    for part in origin.parts:
        yield from _walk(part)


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
