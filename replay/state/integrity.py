"""Verify a recording without an engine: its file is sound, and its records are consistent.

No step is missing, and time never decreases. A cause is recorded before its effect. Every started task ends once, under
the same name, and has a parent. A branch, or a task in its parent's thread, ends before the parent. Failed tasks and
runs have a failure, and no others have. Every keyframe equals the state that the records before it give.
:mod:`replay.restore.verify` also repeats the recorded changes in an engine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from recorder.records import Envelope, Event, Keyframe, Mutation, Plain, Query, Record, Run, Task
from recorder.records.fold import FoldedWorld, apply
from replay.file.record_reader import RecordReader
from replay.state.fold import world_of
from replay.state.json_data import message_data, world_data
from replay.state.state import World


@dataclass(frozen=True, slots=True)
class Deviation:
    """A value that differs from the recorded value."""

    field: str  # path of the value, such as ``effect.bodies[milk].position[0]``
    recorded: Plain  # The recorded value; None if it is missing
    found: Plain  # The other value; None if it is missing

    @property
    def size(self) -> float:
        """The difference between two numbers, in their unit; infinite for other values."""
        if isinstance(self.recorded, int | float) and isinstance(self.found, int | float):
            size = abs(self.recorded - self.found)
            return math.inf if math.isnan(size) else size
        return math.inf

    def __str__(self) -> str:
        text = f"{self.field}: recorded {_short(self.recorded)}, found {_short(self.found)}"
        return text + (f" (they differ by {self.size:.3g})" if math.isfinite(self.size) else "")


def first_deviation(recorded: Plain, actual: Plain, field: str = "") -> Deviation | None:
    """Return the first deviation between two values of JSON data; None if they are equal."""
    return next(_deviations(recorded, actual, field), None)


def _deviations(recorded: Plain, actual: Plain, field: str) -> Iterator[Deviation]:
    if isinstance(recorded, dict) and isinstance(actual, dict):
        for key in [*recorded, *(key for key in actual if key not in recorded)]:
            yield from _deviations(recorded.get(key), actual.get(key), f"{field}.{key}" if field else key)
    elif isinstance(recorded, list) and isinstance(actual, list):
        for index, (a, b) in enumerate(zip(recorded, actual, strict=False)):
            body = str(a["body"]) if isinstance(a, dict) and "body" in a else ""
            yield from _deviations(a, b, f"{field}[{body or index}]")
        if len(recorded) != len(actual):
            yield Deviation(f"number of {field}", len(recorded), len(actual))
    elif recorded != actual or type(recorded) is not type(actual):
        yield Deviation(field, recorded, actual)


def _short(value: Plain) -> str:
    if value is None:
        return "nothing"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


@dataclass(frozen=True, slots=True)
class Problem:
    """An inconsistency."""

    step: int | None  # Step of the problem; None if it has no step
    cause: str
    deviation: Deviation | None = None  # the first value that is wrong
    task: tuple[str, ...] = ()  # names of the tasks around that step, outermost first


def _plain(world: World) -> Plain:
    """Return a world as JSON data: attachments by carrier and body, and also the loading of each body."""
    data = world_data(world)
    held = data.pop("attachments")
    assert isinstance(held, list)  # noqa: S101  for mypy
    pairs: dict[str, Plain] = {f"{each['carrier']}, {each['body']}": each for each in held if isinstance(each, dict)}
    loaded: list[Plain] = [
        # a keyframe contains the present color
        {key: value for key, value in message_data(body.loaded).items() if key != "color"}
        for body in world.bodies.values()
    ]
    return data | {"attachments": dict(sorted(pairs.items())), "loaded": loaded}


MAX_DEPTH: Final = 2000  # largest number of levels of nested tasks. Python's stack ends at about 1,000 levels.
_MAIN_THREAD: Final = "MainThread"  # recordings of release 0.1.0 lack the thread that ends the run
#: Phases of a task by previous phase. A requested branch may be cancelled before its start.
_AFTER: Final[Mapping[Task.Phase | None, tuple[Task.Phase, ...]]] = {
    None: (Task.ASKED, Task.STARTED),
    Task.ASKED: (Task.STARTED, Task.FINISHED, Task.LEFT),
    Task.STARTED: (Task.FINISHED, Task.LEFT),
}
_STATUSES: Final[Mapping[Task.Phase, tuple[Task.Status, ...]]] = {
    Task.ASKED: (Task.CREATED,),
    Task.STARTED: (Task.RUNNING,),
    Task.FINISHED: (Task.SUCCEEDED, Task.FAILED, Task.CANCELLED),
    Task.LEFT: (Task.CREATED, Task.RUNNING),
}
_SAME: Final = ("kind", "name", "attempt", "parent")  # fields that are equal in all records of a task


def too_deep(record: Task, depths: dict[int, int]) -> str:
    """Store the level of a task in ``depths``, and return an error if the task is nested too deep; otherwise ""."""
    depth = depths[record.task] = depths.get(record.parent, 0) + 1
    return f"its task is nested more than {MAX_DEPTH} levels deep" if depth > MAX_DEPTH else ""


class TaskIntegrity:
    """Checks the records of tasks and the run in order. With ``newer``, phases of tasks may be unknown."""

    def __init__(self, *, newer: bool = False) -> None:
        self._newer = newer
        self.tasks = 0  # number of tasks
        self.partial = False  # whether missing records may have started or ended tasks
        self._names: dict[int, tuple[str, int]] = {}
        self._phases: dict[int, Task.Phase] = {}
        self._running: dict[int, Task] = {}
        self._threads: dict[int, str] = {}
        self._left = 0  # number of running tasks at the end of the recording
        self._run: Run | None = None

    @property
    def unfinished(self) -> int:
        """Number of unfinished tasks."""
        return len(self._running) + self._left

    def path(self, number: int) -> tuple[str, ...]:
        """Return the names of a task and of the tasks around it, outermost first."""
        names: list[str] = []
        while number in self._names and len(names) <= len(self._names):
            name, number = self._names[number]
            names.append(name)
        return tuple(reversed(names))

    def knows(self, number: int) -> bool:
        """Return whether a task has or may have started; 0 means no task, and counts as started."""
        return not number or number in self._names or self.partial

    def resume(self) -> None:
        """Continue after missing records."""
        self.partial = True
        self._running.clear()

    def check(self, record: Task) -> str:
        """Check the next record of a task. Return the record's error, or ""."""
        number, before = record.task, self._phases.get(record.task)
        if self._newer and record.phase not in Task.Phase.values():
            return ""
        if record.phase not in _AFTER.get(before, ()) and not self.partial:
            last = "never started" if before is None else f"was {_name(before)} before"
            return f"task {number} is {_name(record.phase)}, but it {last}"
        if cause := self._unlike(record):
            return cause
        if before is None:
            if not self.knows(record.parent):
                return f"the parent of task {number} never started"
            self.tasks += 1
            self._names[number] = record.name, record.parent
        self._phases[number] = record.phase
        if record.phase in (Task.FINISHED, Task.LEFT):
            self._running.pop(number, None)
            self._left += record.phase == Task.LEFT
        else:
            self._running[number] = record
            self._threads[number] = record.thread
        return ""

    def _unlike(self, record: Task) -> str:
        """Return a contradiction within a record, or between it and its task's start; "" if there is none."""
        subject = f"task {record.task}"
        if self._newer and record.status not in Task.Status.values():
            return ""
        if record.status not in _STATUSES.get(record.phase, ()):
            return f"{subject} is {_name(record.phase)} with a status that contradicts this phase"
        cause = _failure(failed=record.status == Task.FAILED, recorded=record.HasField("failure"))
        if cause:
            return f"{subject} {cause}"
        began = self._running.get(record.task)
        if began is None:
            return ""
        for field in _SAME:
            # the record of a running task's parent may be missing
            elsewhere = field == "parent" and (began.began_ns or record.phase == Task.LEFT)
            if getattr(began, field) != getattr(record, field) and not elsewhere:
                return f"the {field} of {subject} differs from its start at step {began.seq}"
        return ""

    def check_run(self, record: Run) -> str:
        """Check the next record of the run. Return the record's error, or ""."""
        failed = record.phase == Run.THREAD_FAILED or (record.phase == Run.FINISHED and not record.succeeded)
        cause = _failure(failed=failed, recorded=record.HasField("failure"))
        if cause:
            return f"the run {cause}"
        if record.succeeded and record.phase != Run.FINISHED:
            return "the run succeeded, but more of its records follow"
        if self._run is not None and record.name != self._run.name:
            return f"the run is called {record.name!r} here, but {self._run.name!r} at its start"
        self._run = self._run or record
        if record.phase != Run.FINISHED:
            return ""
        self._threads[0] = record.thread or _MAIN_THREAD
        for number, began in self._running.items():
            # tasks of daemon threads or workers may end later than the outer task or the run
            in_parent = began.kind == "branch" or began.thread == self._threads.get(began.parent)
            if began.parent not in self._running and in_parent:
                return f"the run ends before task {number} ({began.name}), which started at step {began.seq}"
        return ""


def _failure(*, failed: bool, recorded: bool) -> str:
    if failed == recorded:
        return ""
    return "failed, but has no failure" if failed else "has a failure, but did not fail"


def _name(phase: Task.Phase) -> str:
    value = Task.Phase.DESCRIPTOR.values_by_number.get(phase)
    return value.name.lower() if value is not None else f"in phase {phase}"


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying a recording."""

    steps: int  # number of steps that were checked
    tasks: int  # number of started tasks
    unfinished: int  # number of unfinished tasks at the end
    keyframes: int  # number of keyframes that were compared with the state before
    files: int  # number of attached files
    changes: int  # number of changes that were executed again
    worlds: int  # number of worlds in which changes were executed again
    # Worlds, by name, in which physics couldn't be compared:
    late: tuple[str, ...] = ()  # worlds that were open before the recording
    dragged: tuple[str, ...] = ()  # worlds in which a body was dragged by hand
    environment: tuple[str, ...] = ()  # differences between this environment and the recorded environment
    largest: Deviation | None = None  # largest deviation that can be explained by the environment or by rounding
    problem: Problem | None = None  # the first problem
    damage: str = ""  # damaged or lost parts of the file; a missing end doesn't count
    incomplete: str = ""  # why the recording is incomplete
    unknown: tuple[str, ...] = ()  # worlds with changes that only a newer release can repeat
    static: bool = False  # whether no change was executed again

    @property
    def sound(self) -> bool:
        """Whether no problem is known in the records that exist."""
        return self.problem is None and not self.damage

    @property
    def exact(self) -> bool:
        """Whether all changes were executed again, and their effects were equal bit for bit."""
        return self.sound and self.largest is None and not (self.static or self.late or self.dragged or self.unknown)


def verify_static(log: RecordReader, progress: Callable[[int], None] | None = None) -> Verification:
    """Verify a recording without an engine, until the first problem. ``progress`` is called with each step."""
    return Verifier(log).run(progress)


class Verifier:
    """A verifier of a recording, which checks all records in order. Subclasses also repeat the changes."""

    static = True

    def __init__(self, log: RecordReader) -> None:
        self.log = log
        self.tasks = TaskIntegrity(newer=log.newer is not None)
        self.changes = self._steps = 0
        self._keyframes = 0  # number of keyframes that were compared with the state before
        self.worlds: set[tuple[str, int]] = set()
        self.late: dict[str, None] = {}
        self.dragged: dict[str, None] = {}
        self.unknown: dict[str, None] = {}
        self.environment: tuple[str, ...] = ()
        self.largest: Deviation | None = None
        self.damage: list[str] = []  # damage of records
        self._depths: dict[int, int] = {}
        self._next = self._time = self._monotonic = 0
        self._events: set[int] = set()
        self._worlds: dict[str, FoldedWorld] = {}  # worlds whose states are known after the last missing records

    def run(self, progress: Callable[[int], None] | None) -> Verification:
        """Check the file and the records."""
        self.log.check_file()
        problem = self._first_problem(progress)
        return Verification(
            self._steps,
            self.tasks.tasks,
            self.tasks.unfinished,
            self._keyframes,
            len(self.log.assets),
            self.changes,
            len(self.worlds),
            tuple(self.late),
            tuple(self.dragged),
            self.environment,
            self.largest,
            problem,
            "; ".join(filter(None, (self.log.damage, *self.damage))),
            self.log.incomplete,
            tuple(self.unknown),
            self.static,
        )

    def _first_problem(self, progress: Callable[[int], None] | None) -> Problem | None:
        for record in self.log.records():
            if progress is not None:
                progress(record.seq)
            if isinstance(record, Task) and (cause := too_deep(record, self._depths)):
                self.damage.append(f"step {record.seq}: {cause}")
                return None
            problem = self._problem_of(record)
            if problem is None and isinstance(record, Keyframe | Mutation) and record.world in self._worlds:
                problem = self.check(record)
            if problem is not None:
                return problem
        return None

    def forget(self) -> None:
        """Forget all worlds, because records are missing."""
        self._worlds.clear()

    def check(self, record: Keyframe | Mutation) -> Problem | None:  # noqa: ARG002  for subclasses
        """Return the problem of a consistent change or keyframe; None if there is no engine."""
        return None

    def state(self, world: str) -> World:
        """Return the present state of a world if it is known."""
        return world_of(self._worlds[world])

    def _problem_of(self, record: Record) -> Problem | None:
        """Return the problem of the next record, or of the previous records."""
        step, expected = record.seq, self._next
        if step > expected and any(expected in gap and step - 1 in gap for gap in self.log.lost_before):
            self.tasks.resume()
            self.forget()
        elif step != expected:
            lost = str(expected) if step == expected + 1 else f"{expected} to {step - 1}"
            return Problem(expected, f"step {lost} is missing, so its consequences can't be checked")
        self._next = step + 1
        self._steps += 1
        cause = self._check_envelope(record)
        if cause:
            pass
        elif isinstance(record, Task):
            cause = self.tasks.check(record)
        elif not self.tasks.knows(record.task):
            cause = f"its task {record.task} never started"
        elif isinstance(record, Run):
            cause = self.tasks.check_run(record)
        deviation = None
        before = self.state(record.world) if isinstance(record, Keyframe) and record.world in self._worlds else None
        if isinstance(record, Mutation | Keyframe | Query) and not cause:
            cause = self._apply_change(record)
        if isinstance(record, Keyframe) and before is not None and not cause:
            deviation = self._compare_keyframe(record, before)
            cause = "" if deviation is None else "the keyframe differs from the fold of the previous records"
        return Problem(step, cause, deviation, self.tasks.path(record.task)) if cause else None

    def _check_envelope(self, record: Record) -> str:
        before = self._time, self._monotonic
        self._time, self._monotonic = record.wall_time_ns, record.monotonic_ns
        if record.wall_time_ns < before[0]:
            return "its wall time is before the wall time of the previous step"
        if record.monotonic_ns < before[1]:
            return "its monotonic time is before the monotonic time of the previous step"
        if record.cause and record.cause not in self._events and not self.tasks.partial:
            return f"its cause, step {record.cause}, isn't a previous event"
        if isinstance(record, Event | Envelope):
            self._events.add(record.seq)
        return ""

    def _apply_change(self, record: Mutation | Keyframe | Query) -> str:
        opens = not isinstance(record, Mutation) or record.HasField("open_world")
        if not opens and self.tasks.partial and record.world not in self._worlds:
            return ""
        try:
            apply(self._worlds, record)
        except (ValueError, IndexError) as error:
            return f"the record is inconsistent: {error}"
        return ""

    def _compare_keyframe(self, frame: Keyframe, before: World) -> Deviation | None:
        self._keyframes += 1
        loaded: list[Plain] = [body.body for body in frame.loaded]
        states: list[Plain] = [body.body for body in frame.bodies]
        if loaded != states:
            return Deviation("bodies", states, loaded)
        return first_deviation(_plain(self.state(frame.world)), _plain(before), frame.world)
