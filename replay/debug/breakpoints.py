"""Breakpoints and watches: each is the steps of the recording at which it stops the plan, known when it is set.

Only a watch on the plan's own variables has none: these are in no recording, so the plan runs to find out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from recorder.suggestions import suggestion
from replay.debug.quantities import NoQuantity, changes
from replay.errors import NoSuchName, NoSuchStep, ReplayError
from replay.explain.plan_source import is_file, name_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from replay.debug.quantities import Change
    from replay.debug.stops import Watched
    from replay.debug.timeline import Timeline
    from replay.recording import Recording

_LINE: Final = re.compile(r"(?P<file>.+):(?P<line>\d+)")


class NoSuchPlace(ReplayError, LookupError):
    """A breakpoint was asked for where nothing happens in the recording.

    Attributes:
        place: as it was asked for.
    """

    def __init__(self, place: str, cause: str) -> None:
        super().__init__(f"{place}: {cause}")
        self.place = place


@dataclass(slots=True)
class Breakpoint:
    """Where the plan stops.

    Attributes:
        number: by which it is called, from 1.
        text: what it is, in words.
        steps: at which it stops the plan, in their order.
        temporary: whether it ends when it has stopped the plan.
        enabled: whether it stops the plan.
        line: of a breakpoint at a line of the plan: its file and number.
        changes: of a watch: the changes, by their steps.
        watched: of a watch on the plan's variables.
    """

    number: int
    text: str
    steps: list[int] = field(default_factory=list)
    temporary: bool = False
    enabled: bool = True
    line: tuple[str, int] | None = None
    changes: dict[int, Change] = field(default_factory=dict)
    watched: Watched | None = None

    @property
    def counted(self) -> str:
        """How often it stops the plan, in words."""
        if self.watched is not None:
            return "the plan runs to find out where it changes"
        count = len(self.steps)
        some = ", ".join(map(str, self.steps[:6])) + (", ..." if count > 6 else "")
        return f"step{'s' if count > 1 else ''} {some}" if count else "it never changes"


def breakpoint_at(log: Recording, timeline: Timeline, number: int, place: str) -> Breakpoint:
    """Return a breakpoint: at a step, ``failure``, ``event [NAME]``, FILE:LINE, or tasks by path or kind.

    Raises:
        NoSuchPlace: nothing in the recording is there.
        NoSuchStep: there is no such step.
    """
    word, _, rest = place.partition(" ")
    if place == "failure":
        return Breakpoint(number, "failures", _some(place, timeline.failures, "nothing failed"))
    if word == "event":
        names = [rest.strip()] if rest.strip() else list(timeline.events)
        steps = sorted(step for name in names for step in timeline.events.get(name, ()))
        hint = suggestion(rest.strip(), timeline.events) if timeline.events else "there were none"
        return Breakpoint(number, f"event {rest.strip()}".strip(), _some(place, steps, f"no such event; {hint}"))
    match = _LINE.fullmatch(place)
    if match is not None and not place.startswith("task:"):
        return _at_line(timeline, number, match["file"], int(match["line"]))
    searched = tuple(place.strip("/").casefold().split("/"))
    steps = [
        step
        for step, path in timeline.paths.items()
        if tuple(name.casefold() for name in path)[-len(searched) :] == searched or timeline.kinds[step] == place
    ]
    if steps:
        return Breakpoint(number, f"task {place}", steps)
    try:
        return Breakpoint(number, f"step {place}", [log.step(place)])
    except NoSuchStep as error:
        if re.fullmatch(r"-?[\d.]+s?|last|task:.*", place):
            raise
        known = {*timeline.kinds.values(), *(path[-1] for path in timeline.paths.values())}
        raise NoSuchPlace(place, f"no step, and no task is called so; {suggestion(place, known)}") from error


def _some(place: str, steps: list[int], otherwise: str) -> list[int]:
    if not steps:
        raise NoSuchPlace(place, otherwise)
    return steps


def _at_line(timeline: Timeline, number: int, name: str, line: int) -> Breakpoint:
    files = [file for file in timeline.files if is_file(file, name)]
    if not files:
        known = ", ".join(sorted({name_of(file) for file in timeline.files})) or "none"
        raise NoSuchPlace(f"{name}:{line}", f"no line of such a file led to a record; the plan's files are {known}")
    if len(files) > 1:
        known = ", ".join(sorted(files))
        raise NoSuchPlace(f"{name}:{line}", f"several of the plan's files are called so: {known}")
    at, steps = timeline.line(files[0], line)
    if not at:
        raise NoSuchPlace(f"{name}:{line}", "neither it nor a later line of that file led to a record")
    moved = "" if at == line else f" (line {line} leads to no record)"
    return Breakpoint(number, f"{name_of(files[0])}:{at}{moved}", steps, line=(files[0], at))


def watch_of(log: Recording, number: int, expression: str, plan: Callable[[], Watched | None]) -> Breakpoint:
    """Return a watch on an expression about states of the recording, or else about the plan's variables.

    Args:
        log: the recording.
        number: by which it is called.
        expression: the expression.
        plan: gives the same in a function of the plan; None where it has no value there.

    Raises:
        NoQuantity: it is neither.
    """
    try:
        found = {change.step: change for change in changes(log, expression)}
    except NoQuantity:
        watched = plan()
        if watched is None:
            raise
        return Breakpoint(number, f"watch {expression}", watched=watched)
    return Breakpoint(number, f"watch {expression}", sorted(found), changes=found)


def breakpoint_of(known: list[Breakpoint], number: str) -> Breakpoint:
    """Return a breakpoint by its number.

    Raises:
        NoSuchName: there is none.
    """
    for each in known:
        if str(each.number) == number:
            return each
    raise NoSuchName("breakpoint", number, [str(each.number) for each in known])
