"""A session of the debugger: a guided plan, its breakpoints, and the steps to which commands lead.

The steps of a breakpoint are read from the recording when the breakpoint is set. A watch on the plan's own variables
has no steps: recordings don't contain variables, so the plan must run. The level of a step is the innermost task around
the step. A task's start and end are on the level outside, so ``next`` goes from the start of a task to its end.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

from recorder.errors import suggestion
from recorder.properties.expressions import PARTS, ROUNDING, BadProperty, NoValue, PropertyExpression, Scene, plain
from recorder.records import Event, Keyframe, Mutation, Output, Record, Task
from recorder.records.fold import FoldedWorld, apply
from recorder.tasks import Node, Tree
from replay.debug.stopped_plan import WatchedExpression
from replay.errors import NoSuchName, NoSuchStep, ReplayError
from replay.file.record_reader import RecordReader
from replay.history.source import Site, is_file, name_of, sites
from replay.history.steps import is_called
from replay.report.question import written
from replay.state.fold import state_at

if TYPE_CHECKING:
    from replay.debug.guided_plan import Arrival, GuidedPlan
    from replay.recording import Recording

_LINE: Final = re.compile(r"(?P<file>.+):(?P<line>\d+)")


class NoFurther(ReplayError):
    """The plan can't move further: the recording begins or ends here, or the plan differs from the recording."""

    def __init__(self, step: int, cause: str) -> None:
        super().__init__(cause)
        self.step = step  # present step of the plan


@dataclass(frozen=True, slots=True)
class Halt:
    """The step at which the plan has stopped, and the breakpoints that stopped the plan."""

    arrival: Arrival
    met: list[Breakpoint] = field(default_factory=list)
    #: Values of watched variables before and after the step, by the watch's number.
    changes: dict[int, tuple[str, str]] = field(default_factory=dict)


class Session:
    """A guided plan with breakpoints."""

    def __init__(self, log: Recording, plan: GuidedPlan) -> None:
        self.log = log
        self.plan = plan
        self.breakpoints: list[Breakpoint] = []  # breakpoints by number
        self._numbers = 0

    @cached_property
    def timeline(self) -> Timeline:
        """The tasks and source lines of the steps."""
        return Timeline(self.log)

    @property
    def step(self) -> int:
        """The present step of the plan."""
        return self.plan.step

    def set_break(self, place: str, *, temporary: bool = False) -> Breakpoint:
        """Set a breakpoint (:func:`breakpoint_at`)."""
        made = breakpoint_at(self.log, self.timeline, self._numbers + 1, place)
        made.temporary = temporary
        return self._kept(made)

    def set_watch(self, expression: str, frame: int) -> Breakpoint:
        """Watch an expression of recorded states or of a frame's variables; raise NoQuantity if it has no value."""
        return self._kept(self._watch(expression, frame))

    def _kept(self, made: Breakpoint) -> Breakpoint:
        self._numbers = made.number
        self.breakpoints.append(made)
        return made

    def _watch(self, expression: str, frame: int) -> Breakpoint:
        number, text = self._numbers + 1, f"watch {expression}"
        try:
            found = {change.step: change for change in value_changes(self.log, expression)}
        except NoQuantity:
            stack = self.plan.ask("where")
            if not frame < len(stack):
                raise
            if "error" in self.plan.ask("evaluate", frame=frame, expression=expression, pretty=False):
                raise
            watched = WatchedExpression(expression, stack[frame]["file"], stack[frame]["first"])
            return Breakpoint(number, text, watched=watched)
        return Breakpoint(number, text, sorted(found), changes=found)

    def numbered(self, number: str) -> Breakpoint:
        """Return a breakpoint by number; raise NoSuchName if no breakpoint has this number."""
        for each in self.breakpoints:
            if str(each.number) == number:
                return each
        raise NoSuchName("breakpoint", number, [str(each.number) for each in self.breakpoints])

    # --- from step to step ------------------------------------------------------------------------------------------

    def forward(self, target: int | None = None) -> Halt:
        """Continue to a step (by default the last), or to an earlier breakpoint; raise NoFurther at the last step."""
        if self.step >= self.plan.last:
            raise self._no_further()
        goal = self.plan.last if target is None else min(target, self.plan.last)
        enabled = [each for each in self.breakpoints if each.enabled]
        hits = [step for each in enabled for step in each.steps if step > self.step]
        watched = [each.watched for each in enabled if each.watched is not None]
        return self._halted(self.plan.go(min([goal, *hits]), watched), enabled)

    def back(self, target: int = 0) -> Halt:
        """Go back to a step (by default the first), or to a later breakpoint; raise NoFurther at the first step."""
        if self.step <= 0:
            raise NoFurther(self.step, "the recording begins here")
        enabled = [each for each in self.breakpoints if each.enabled]
        goal = max([target, *[step for each in enabled for step in each.steps if step < self.step]])
        changes: dict[int, tuple[str, str]] = {}
        watched = [each.watched for each in enabled if each.watched is not None]
        if watched:
            changed, changes = self._last_change(watched, goal - 1, self.step)
            goal = max(goal, changed)
        return self._halted(self.plan.go(goal), enabled, changes)

    def back_to_change(self, expression: str, frame: int) -> Halt:
        """Go back to the last change of an expression (:meth:`set_watch`); raise NoFurther if there is no change."""
        watch = self._watch(expression, frame)
        step = max((each for each in watch.steps if each < self.step), default=-1)
        changes: dict[int, tuple[str, str]] = {}
        if watch.watched is not None:
            step, changes = self._last_change([watch.watched], -1, origin := self.step)
            if step < 0:
                self.plan.go(origin)
        if step < 0:
            raise NoFurther(self.step, f"{expression} didn't change before this step")
        watch.number = 0
        return self._halted(self.plan.go(step), [watch], dict(enumerate(changes.values())))

    def go(self, step: int) -> Halt:
        """Go to a step, and ignore breakpoints; raise NoFurther if the plan can't reach the step."""
        if step > self.plan.last:
            raise self._no_further()
        return self._halted(self.plan.go(step), [])

    def _no_further(self) -> NoFurther:
        last, parted = self.plan.last, self.plan.parted
        cause = f"the plan reaches only step {last}: {parted}" if parted else "the recording ends here"
        return NoFurther(self.step, cause)

    def _last_change(
        self, watched: list[WatchedExpression], after: int, before: int
    ) -> tuple[int, dict[int, tuple[str, str]]]:
        """Return the last step between two steps at which a watched value changed, and the changes by index.

        If no value changed, return ``after``. The plan runs from the nearest waiting copy, then from earlier copies.
        """
        end = before - 1
        while end > max(after, 0):
            start = max((each for each in self.plan.copies.checkpoints() if each < end), default=0)
            self.plan.go(start)
            changes = [each for each in self.plan.go(end, watched, through=True).changes if each[0] > after]
            if changes:
                step = changes[-1][0]
                return step, {place: (old, new) for at, place, old, new in changes if at == step}
            if not start:
                break
            end = start
        return after, {}

    def _halted(
        self, arrival: Arrival, enabled: list[Breakpoint], changes: dict[int, tuple[str, str]] | None = None
    ) -> Halt:
        found = changes or {place: (old, new) for step, place, old, new in arrival.changes if step == arrival.step}
        on_plan = [each for each in enabled if each.watched is not None]
        met = [each for each in enabled if arrival.step in each.steps]
        met += [on_plan[place] for place in found]
        for each in met:
            if each.temporary and each in self.breakpoints:
                self.breakpoints.remove(each)
        return Halt(arrival, met, {on_plan[place].number: change for place, change in found.items()})


#: Moves of the plan to another step, by the name of the prompt's command.
MOVES: Final[dict[str, Callable[[Session], Halt]]] = {
    "step": lambda session: session.forward(session.step + 1),
    "rstep": lambda session: session.back(session.step - 1),
    "next": lambda session: session.forward(session.timeline.following(session.step)),
    "rnext": lambda session: session.back(session.timeline.preceding(session.step)),
    "return": lambda session: session.forward(session.timeline.end(session.step)),
    "continue": Session.forward,
    "rcontinue": Session.back,
}


class Timeline:
    """The steps of a recording."""

    def __init__(self, log: RecordReader) -> None:
        self.steps = len(log)  # number of steps
        self.tasks: dict[int, Node] = {}  # tasks that have started, by the step of the start
        self.failures: list[int] = []  # steps with a failure
        self.events: dict[str, list[int]] = defaultdict(list)  # steps of events, by name
        self._levels = [0] * self.steps
        self._tree = Tree()
        self._ends: dict[int, int] = {}
        self._stacks: list[tuple[Site, ...]] = [()] * self.steps  # the plan's lines that led to a step, outermost first
        self._lines: dict[Site, list[int]] = defaultdict(list)
        task_stacks: dict[int, tuple[Site, ...]] = {}
        latest: dict[str, tuple[Site, ...]] = {}  # call stacks of the latest records, by thread or branch
        for record in log.records():
            self._note(record)
            own = sites(record)
            stack = own or task_stacks.get(record.task, ())
            if isinstance(record, Task) and record.phase in (Task.STARTED, Task.ASKED):
                task_stacks[record.task] = stack
            self._stacks[record.seq] = stack
            before = latest.get(record.thread, ())
            again = bool(own) and not isinstance(record, Output)  # the line of an output record also made other records
            for depth, site in enumerate(stack):
                if before[: depth + 1] != stack[: depth + 1] or (again and depth == len(stack) - 1):
                    hits = self._lines[site]
                    if hits[-1:] != [record.seq]:
                        hits.append(record.seq)
            latest[record.thread] = stack

    def _note(self, record: Record) -> None:
        self._levels[record.seq] = record.task
        if isinstance(record, Task):
            self._levels[record.seq] = record.parent
            task = self._tree.apply(record)
            if record.phase == Task.STARTED:
                self.tasks[record.seq] = task
            elif record.phase != Task.ASKED:
                self._ends[record.task] = record.seq
        if isinstance(record, Event):
            self.events[record.name].append(record.seq)
        if "failure" in record.DESCRIPTOR.fields_by_name and record.HasField("failure"):
            self.failures.append(record.seq)

    @property
    def names(self) -> set[str]:
        """The names and kinds of all tasks."""
        return {word for task in self.tasks.values() for word in (task.name, task.kind)}

    # --- targets of commands ----------------------------------------------------------------------------------------

    def following(self, step: int) -> int:
        """Return the next step on the same level or an outer level, or else the last step."""
        around = self._around(step)
        return next((at for at in range(step + 1, self.steps) if self._levels[at] in around), self.steps - 1)

    def preceding(self, step: int) -> int:
        """Return the previous step on the same level or an outer level, or else the first step."""
        around = self._around(step)
        return next((at for at in range(step - 1, -1, -1) if self._levels[at] in around), 0)

    def end(self, step: int) -> int:
        """Return the end of the task around a step, or else the last step."""
        return self._ends.get(self._levels[step], self.steps - 1)

    def onwards(self, step: int) -> int:
        """Return the next step that is on this level at a later line of the same file, or on an outer level."""
        site, level, around = self.site(step), self._levels[step], self._around(step)
        for at in range(step + 1, self.steps):
            if self._levels[at] in around:
                file, line = self.site(at)
                if self._levels[at] != level or (file == site[0] and line > site[1]):
                    return at
        return self.steps - 1

    def around(self, step: int) -> list[Node]:
        """Return the tasks around a step, innermost first."""
        innermost = self._tree.nodes.get(self._levels[step])
        return [] if innermost is None else [task for task in innermost.around() if task.started.seq in self.tasks]

    def _around(self, step: int) -> set[int]:
        """Return the level of a step, and the outer levels."""
        return {self._levels[step], *(task.id for task in self.around(step)), 0}

    # --- lines ------------------------------------------------------------------------------------------------------

    def site(self, step: int) -> Site:
        """Return the plan's line that led to a step; ("", 0) if no line is known."""
        return self._stacks[step][-1] if self._stacks[step] else ("", 0)

    @property
    def files(self) -> set[str]:
        """The plan's files."""
        return {file for file, _ in self._lines}

    def line(self, file: str, number: int) -> tuple[int, list[int]]:
        """Return the first line, at or after a given line, that made a record; and the steps at which the line ran.

        Each execution of the line counts once, at its first record. Repeated calls in one line count once if no other
        line made a record between them.
        """
        found = min((line for named, line in self._lines if named == file and line >= number), default=0)
        return found, self._lines.get((file, found), [])


class NoSuchPlace(ReplayError, LookupError):
    """The recording doesn't have the place of a breakpoint; the error is made from the place and the cause."""


@dataclass(slots=True)
class Breakpoint:
    """A breakpoint, or a watch."""

    number: int  # number by which commands name the breakpoint; the first number is 1
    text: str  # description of the breakpoint for the user
    steps: list[int] = field(default_factory=list)  # sorted steps at which the breakpoint stops the plan
    temporary: bool = False  # whether the breakpoint is removed when it has stopped the plan
    enabled: bool = True  # whether the breakpoint is switched on
    line: tuple[str, int] | None = None  # for a breakpoint at a line of the plan: its file and line number
    changes: dict[int, ValueChange] = field(default_factory=dict)  # for a watch on recorded states: the changes by step
    watched: WatchedExpression | None = None  # for a watch on the plan's variables: the expression

    @property
    def counted(self) -> str:
        """The text of the breakpoint's steps."""
        if self.watched is not None:
            return "its changes are found when the plan runs"
        count = len(self.steps)
        some = ", ".join(map(str, self.steps[:6])) + (", ..." if count > 6 else "")
        return f"step{'s' if count > 1 else ''} {some}" if count else "it never changes"


def breakpoint_at(log: Recording, timeline: Timeline, number: int, place: str) -> Breakpoint:
    """Return a breakpoint at a step, ``failure``, ``event [NAME]``, FILE:LINE, or tasks by path or kind.

    If the recording doesn't have this place or step, NoSuchPlace or NoSuchStep is raised.
    """
    word, _, rest = place.partition(" ")
    if place == "failure":
        return Breakpoint(number, "failures", _some(place, timeline.failures, "nothing failed"))
    if word == "event":
        names = [rest.strip()] if rest.strip() else list(timeline.events)
        steps = sorted(step for name in names for step in timeline.events.get(name, ()))
        hint = suggestion(rest.strip(), timeline.events) if timeline.events else "the recording has no events"
        return Breakpoint(number, f"event {rest.strip()}".strip(), _some(place, steps, f"no such event; {hint}"))
    match = _LINE.fullmatch(place)
    if match is not None and not place.startswith("task:"):
        return _at_line(timeline, number, match["file"], int(match["line"]))
    steps = [step for step, task in timeline.tasks.items() if task.kind == place or is_called(task, place)]
    if steps:
        return Breakpoint(number, f"task {place}", steps)
    try:
        return Breakpoint(number, f"step {place}", [log.step(place)])
    except NoSuchStep as error:
        if re.fullmatch(r"-?[\d.]+s?|last|task:.*", place):
            raise
        raise NoSuchPlace(place, f"there is no such step or task; {suggestion(place, timeline.names)}") from error


def _some(place: str, steps: list[int], otherwise: str) -> list[int]:
    if not steps:
        raise NoSuchPlace(place, otherwise)
    return steps


def _at_line(timeline: Timeline, number: int, name: str, line: int) -> Breakpoint:
    files = [file for file in timeline.files if is_file(file, name)]
    if not files:
        known = ", ".join(sorted({name_of(file) for file in timeline.files})) or "none"
        raise NoSuchPlace(f"{name}:{line}", f"no line of this file made a record; the plan's files are {known}")
    if len(files) > 1:
        known = ", ".join(sorted(files))
        raise NoSuchPlace(f"{name}:{line}", f"several of the plan's files have this name: {known}")
    at, steps = timeline.line(files[0], line)
    if not at:
        raise NoSuchPlace(f"{name}:{line}", "neither this line nor a later line of the file made a record")
    moved = "" if at == line else f" (line {line} made no record)"
    return Breakpoint(number, f"{name_of(files[0])}:{at}{moved}", steps, line=(files[0], at))


class NoQuantity(ReplayError):
    """An expression has no value in any recorded state; the error is made from the expression and the cause."""


class ValueChange(NamedTuple):
    """The change of an expression's value at a step."""

    step: int
    before: object
    after: object


def value_changes(log: RecordReader, expression: str) -> list[ValueChange]:
    """Return the changes of an expression's value in a recording (:mod:`recorder.properties.expressions`).

    Values are None before an object is loaded, and after it is removed. If the expression has no value at any step,
    NoQuantity is raised.
    """
    try:
        compiled = PropertyExpression(expression)
    except BadProperty as error:
        raise NoQuantity(expression, error.cause) from None
    worlds: dict[str, FoldedWorld] = {}
    scene = Scene(worlds)
    found: list[ValueChange] = []
    latest: object = None
    known, cause = False, NoValue("the recording has no state")
    names = set[str]()
    for record in log.records((Mutation, Keyframe)):
        apply(worlds, record)
        try:
            value = plain(compiled.value(scene))
            known = True
        except NoValue as error:
            value = None
            cause = error if error.name or not cause.name else cause
            names.update(error.known)
        if _differ(latest, value):
            found.append(ValueChange(record.seq, latest, value))
            latest = value
    if not known:
        raise NoQuantity(expression, f"{cause}{f'; {suggestion(cause.name, names)}' if cause.known else ''}")
    return found


def _differ(before: object, after: object) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) > ROUNDING
    if isinstance(before, tuple) and isinstance(after, tuple) and len(before) == len(after):
        return any(map(_differ, before, after))
    return before != after


def quantity_names(log: RecordReader, step: int) -> Iterator[str]:
    """Yield the names that may complete an expression at a step."""
    state = state_at(log, step)
    yield from (f"{each}(" for each in ("holding", "distance", "upright"))
    for world in state.worlds.values():
        yield written(world.name)
        for body in world.bodies.values():
            name = written(body.name)
            yield name
            yield from (f"{name}.{part}" for part in PARTS)
            yield from (f"{name}.{joint}" for joint in body.joints)
