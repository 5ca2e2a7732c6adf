"""Decisions that a fork forces, as text: ``grasp(object=milk)=top``, ``pick-up.arm(milk)=left``, ``remove(cup)=skip``.

A decision is a choice of a candidate, a solution of a designator, a limit, the order of branches, or whether a call of
the plan is made. The deciding code then considers only the forced value. If this value is impossible, the code fails
with the actual reason.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.forcing import SKIPPED
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.records import Query, Task
from replay.errors import NoSuchName, ReplayError
from replay.report.question import BadQuestion, Name, Term, parse, question_of

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

_FORM: Final = re.compile(r"\s*([\w-]+)(?:\.([\w-]+))?\s*\((.*)\)\s*=\s*(.+?)\s*", re.DOTALL)
_NUMBER: Final = re.compile(r"#([1-9]\d*)")
_KEYWORD: Final = re.compile(r"([\w-]+)(\s*=)")
_ANY: Final = re.compile(r"(^|,)\s*\.\.\.\s*$")
_LIMIT, _ORDER = "timeout", "order"
_PLACES: Final = {"standing_places": 2, "free_places": 3}  # number of decimals of places in names of candidates
_NEAR: Final = 0.01  # maximum distance in m between a given place and a candidate
_MOST_IN_A_ROW: Final = 100  # number of successive turns of a polling branch, after which another branch runs


class BadChange(ReplayError):
    """A fork can't make a change; the error is made from the change and the cause."""


@dataclass(slots=True)
class ForcedDecision:
    """A value for the next matching decision. An order of branches applies to all later decisions."""

    text: str  # text of the decision
    name: str  # name of the choice, type of the designator, name of the called function, "timeout" or "order"
    slot: str  # slot of a designator's solution; "" for the whole solution and for other decisions
    positional: tuple[Term, ...]  # arguments that must match, in the recorded order
    keywords: Mapping[str, Term]  # arguments that must match, by name with underscores
    value: Term
    number: int  # number of the solution or of the recorded candidate, from 1; 0 if the value itself is given
    used: bool = False
    _in_a_row: list[str] = field(default_factory=list)

    def fits(self, kind: str, name: str, arguments: Mapping[str, Any]) -> bool:
        """Return whether the value is for a decision of the running plan."""
        if name != self.name or (kind == "call") != (self.value == Name(SKIPPED)) or (self.slot and kind != "solution"):
            return False
        return self._has(arguments)

    def fits_recorded(self, record: Query) -> bool:
        """Return whether the value is for a recorded choice."""
        try:
            return record.name == self.name and self._has(dict(question_of(record).keywords))
        except BadQuestion:
            return False

    def _has(self, arguments: Mapping[str, Any]) -> bool:
        given = {key.replace("-", "_"): value for key, value in arguments.items()}
        wanted = {**dict(zip(given, self.positional, strict=False)), **self.keywords}
        enough = len(self.positional) <= len(given)
        return enough and all(key in given and is_same(term, given[key]) for key, term in wanted.items())

    def decide(self, kind: str, arguments: Mapping[str, Any]) -> Any:
        """Return the forced value. For the order of branches, None means that the next branch isn't forced."""
        if kind == "order":
            wanted = [text_of(term) for term in (self.value if isinstance(self.value, list) else [self.value])]
            there = [name for each in wanted for name in arguments["ready"] if each in (name, name.partition(" ")[2])]
            if not there or (len(there) == 1 < len(wanted)):
                return None
            self._in_a_row = [*(self._in_a_row if self._in_a_row[:1] == there[:1] else ()), there[0]]
            if len(self._in_a_row) > _MOST_IN_A_ROW:
                self._in_a_row.clear()
                return None
            return there[0]
        if kind == "solution":  # if the plan gives the slot, the forced value replaces its value

            def admit(number: int, solution: dict[str, Any]) -> dict[str, Any] | None:
                if self.slot and arguments.get(self.slot) is not None:
                    before, value = solution.get(self.slot), self.value
                    named = isinstance(before, Object) and isinstance(value, Name)
                    live = before.world.get_object(text_of(value)) if named else _live(value)  # type: ignore[union-attr]
                    return {**solution, self.slot: live}
                values = [solution.get(self.slot)] if self.slot else list(solution.values())
                found = number == self.number if self.number else any(_is_value(self.value, each) for each in values)
                return solution if found else None

            return admit
        return self.value if kind == "timeout" else text_of(self.value)


def parse_decision(text: str) -> ForcedDecision:
    """Parse ``grasp(object=milk, ...)=top``, ``transporting(milk)=#2`` or ``order(...)=[cook, serve]``.

    For a text of another form, raise BadChange.
    """
    form = _FORM.fullmatch(text)
    wrong = "expected DECISION(ARGUMENTS)=VALUE, such as grasp(milk)=top or pick-up.arm(milk)=left"
    if form is None:
        raise BadChange(text, wrong)
    name, slot, given, right = form.groups()
    number = _NUMBER.fullmatch(right)
    given = _KEYWORD.sub(lambda match: match[1].replace("-", "_") + match[2], _ANY.sub("", given))
    try:
        call = parse(f"decision({given})")
        (value,) = (None,) if number else parse(f"value({right})").arguments
    except (BadQuestion, ValueError) as error:
        raise BadChange(text, f"{wrong}: {error.cause}" if isinstance(error, BadQuestion) else wrong) from None
    seconds = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
    if name == _LIMIT and not seconds:
        raise BadChange(text, "the value must be a number of seconds above 0")
    return ForcedDecision(text, name, slot or "", call.arguments, call.keywords, value, int(number[1]) if number else 0)


def on_record(log: RecordReader, step: int, given: ForcedDecision, queries: Sequence[str]) -> str:
    """Return the text of a decision in which the name of the candidate replaces its number.

    Raises:
        NoSuchName: The recording has no such choice, motion or action, or there is no such function.
        BadChange: No matching choice is recorded after the step, or the choice has too few candidates.
    """
    skipped = given.value == Name(SKIPPED)
    choices = {record.name for record in log.records(Query) if record.HasField("chosen")}
    tasks = {record.name for record in log.records(Task) if record.kind in ("motion", "action")}
    calls = {name for kind in (Object, BulletWorld) for name in vars(kind) if not name.startswith("_")}
    known = calls if skipped else {*choices, *tasks, _LIMIT, _ORDER, *queries}
    if given.name not in known or given.name in queries:
        raise NoSuchName("function to skip" if skipped else "query or decision on record", given.name, known)
    if given.name in tasks or given.name not in choices or not (given.number or isinstance(given.value, list)):
        return given.text
    found = next((each for each in log.records(Query, step + 1) if given.fits_recorded(each)), None)
    if found is None:
        raise BadChange(given.text, f"no such choice is recorded after step {step}")
    names = list(candidate_names(found))
    if given.number > len(names):
        listed = ", ".join(f"#{number} {name}" for number, name in enumerate(names, 1))
        raise BadChange(given.text, f"the choice at step {found.seq} has {len(names)} candidates: {listed}")
    spots = zip(found.grid.spots, names, strict=False)
    near = (name for spot, name in spots if _is_value(given.value, list(spot.position)))
    name = names[given.number - 1] if given.number else next(near, None)
    if name is None:
        text = f"no candidate of step {found.seq} is within {_NEAR * 100:.0f} cm of the given place"
        raise BadChange(given.text, text)
    return f"{given.text.rpartition('=')[0]}={name!r}"


def candidate_names(record: Query) -> Iterator[str]:
    """Yield the names of the recorded candidates. Places are ordered by their scores."""
    decimals = _PLACES.get(record.name)
    for spot in record.grid.spots if decimals is not None else ():
        yield f"[{spot.position[0]:.{decimals}f}, {spot.position[1]:.{decimals}f}]"
    for candidate in record.candidates if decimals is None else ():
        yield from candidate.names


def is_same(term: Term, value: object) -> bool:
    """Return whether an argument in the running plan has a given value."""
    if isinstance(value, Object | BulletWorld):
        robot = isinstance(value, Object) and value.is_robot
        return text_of(term) == value.name or (robot and text_of(term) == "robot")
    if isinstance(term, list):
        same = isinstance(value, list | tuple) and len(term) == len(value)
        return same and all(is_same(*each) for each in zip(term, value, strict=True))  # type: ignore[call-overload]
    return (term.text if isinstance(term, Name) else term) == (value.text if isinstance(value, Name) else value)


def _is_value(term: Term, value: Any) -> bool:
    """Return whether a solution's value is the given value. A place may differ by 1 cm."""
    place = value.get("position") if isinstance(value, dict) else getattr(value, "position", value)
    if isinstance(term, list) and term and all(isinstance(each, int | float) for each in term):
        if not isinstance(place, list | tuple) or not all(isinstance(each, int | float) for each in place):
            return False
        size = min(len(term), len(place))
        return math.dist(term[:size], place[:size]) <= _NEAR  # type: ignore[arg-type]
    return is_same(term, value)


def _live(term: Term) -> Any:
    return [_live(each) for each in term] if isinstance(term, list) else term.text if isinstance(term, Name) else term


def text_of(term: Term) -> str:
    """Return a name, or another value as text."""
    return term.text if isinstance(term, Name) else str(term)
