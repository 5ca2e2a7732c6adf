"""Checks whether a recording is consistent; for this no world is needed.

Steps have no gap and time never decreases; every task that starts ends once, as what it began, and its parent exists;
what began in the thread of the task around it, or is a branch, ends before that does; what failed has its failure, and
nothing else has; causes came before what they caused; every keyframe equals the fold of the records before it, and
names the same models, loaded in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import Event, Keyframe, Mutation, Run, Task
from replay.state.deviation import Deviation, first_deviation
from replay.state.fold import apply, fold
from replay.state.json_data import message_data, world_data

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.records import Plain, Record
    from replay.state.fold import WorldBuilder
    from replay.state.state import World

_MAIN_THREAD: Final = "MainThread"  # which ends the run, in recordings of release 0.1.0, that don't say it
#: What may come after each phase of a task; a branch that is asked for may be cancelled before it starts.
_AFTER: Final[Mapping[Task.Phase | None, tuple[Task.Phase, ...]]] = {
    None: (Task.ASKED, Task.STARTED),
    Task.ASKED: (Task.STARTED, Task.FINISHED, Task.LEFT),
    Task.STARTED: (Task.FINISHED, Task.LEFT),
}
_STATUSES: Final[Mapping[Task.Phase | None, tuple[Task.Status, ...]]] = {
    Task.ASKED: (Task.CREATED,),
    Task.STARTED: (Task.RUNNING,),
    Task.FINISHED: (Task.SUCCEEDED, Task.FAILED, Task.CANCELLED),
    Task.LEFT: (Task.CREATED, Task.RUNNING),
}
_SAME: Final = ("kind", "name", "attempt")  # in all records of a task


@dataclass(frozen=True, slots=True)
class Problem:
    """An inconsistency.

    Attributes:
        step: where; None if it belongs to no step.
        cause: in words.
        deviation: the first wrong value, if there is one.
        task: names of the task in which it is and of those around it, outermost first.
    """

    step: int | None
    cause: str
    deviation: Deviation | None = None
    task: tuple[str, ...] = ()


class Integrity:
    """Checks records one after the other.

    Attributes:
        steps: number of records checked.
        tasks: number of tasks.
        keyframes: number of keyframes that were compared with the fold of the records before them.
    """

    @property
    def unfinished(self) -> int:
        """Number of tasks that have not ended."""
        return len(self._running) + self._left

    def __init__(self) -> None:
        self.steps = 0
        self.tasks = 0
        self.keyframes = 0
        self._time = self._monotonic = 0
        self._events: set[int] = set()
        self._run: Run | None = None
        self._names: dict[int, tuple[str, int]] = {}
        self._phases: dict[int, Task.Phase] = {}
        self._running: dict[int, Task] = {}
        self._threads: dict[int, str] = {}
        self._worlds: dict[str, WorldBuilder] = {}
        self._left = 0  # number of tasks that run on when the recording ends

    def world(self, name: str) -> World:
        """Return the state of a known world after the records so far."""
        return self._worlds[name].build()

    def task(self, number: int) -> tuple[str, ...]:
        """Return a task and what it is part of, outermost first."""
        names: list[str] = []
        while number in self._names and len(names) <= len(self._names):
            name, number = self._names[number]
            names.append(name)
        return tuple(reversed(names))

    def check(self, record: Record) -> Problem | None:
        """Take the next record; return the problem with it, or with what should have come before it."""
        step = record.seq
        if step != self.steps:
            lost = str(self.steps) if step == self.steps + 1 else f"{self.steps} to {step - 1}"
            return Problem(self.steps, f"step {lost} is missing: what followed from it can't be checked")
        self.steps += 1
        if record.wall_time_ns < self._time:
            return Problem(step, "its wall time is before that of the previous step")
        if record.monotonic_ns < self._monotonic:
            return Problem(step, "its monotonic time is before that of the previous step")
        self._time, self._monotonic = record.wall_time_ns, record.monotonic_ns
        if record.cause and record.cause not in self._events:
            return Problem(step, f"its cause, step {record.cause}, is no event before it")
        if isinstance(record, Event):
            self._events.add(step)
        if isinstance(record, Task):
            cause = self._check_task(record)
        elif isinstance(record, Run):
            cause = self._check_run(record)
        else:
            cause = "" if record.task in self._names or not record.task else f"its task {record.task} never started"
        if cause:
            return Problem(step, cause, task=self.task(record.task))
        if isinstance(record, Keyframe) and record.world in self._worlds:
            deviation = self._compare(record)
            if deviation is not None:
                cause = "the keyframe differs from the fold of the records before it"
                return Problem(step, cause, deviation, self.task(record.task))
        if isinstance(record, Mutation | Keyframe):
            try:
                apply(self._worlds, record)
            except (ValueError, IndexError) as error:
                return Problem(step, f"the record makes no sense: {error}", task=self.task(record.task))
        return None

    def _check_task(self, record: Task) -> str:
        number, before = record.task, self._phases.get(record.task)
        if record.phase not in _AFTER.get(before, ()):
            last = "never started" if before is None else f"was {Task.Phase.Name(before).lower()} before"
            return f"task {number} is {Task.Phase.Name(record.phase).lower()}, but it {last}"
        if record.status not in _STATUSES[record.phase]:
            return f"task {number} is {Task.Phase.Name(record.phase).lower()} with a status that doesn't go with that"
        if record.HasField("failure") != (record.status == Task.FAILED):
            return f"task {number} {'has a failure, but did not fail' if record.HasField('failure') else 'failed, but has no failure'}"
        if before is not None:
            began = self._running[number]
            changed = next((field for field in _SAME if getattr(began, field) != getattr(record, field)), "")
            if not changed and record.parent != began.parent and not began.began_ns:  # that one's may be elsewhere
                changed = "parent"
            if changed:
                return f"the {changed} of task {number} isn't that of its beginning at step {began.seq}"
        if before is None:
            if record.parent and record.parent not in self._names:
                return f"the parent of task {number} never started"
            self.tasks += 1
            self._names[number] = record.name, record.parent
        self._phases[number] = record.phase
        if record.phase in (Task.FINISHED, Task.LEFT):
            del self._running[number]
            self._left += record.phase == Task.LEFT
        else:
            self._running[number] = record
            self._threads[number] = record.thread
        return ""

    def _check_run(self, record: Run) -> str:
        failed = record.phase == Run.THREAD_FAILED or (record.phase == Run.FINISHED and not record.succeeded)
        if record.HasField("failure") != failed:
            return "it has a failure, but did not fail" if record.HasField("failure") else "it failed, but has no failure"
        if self._run is not None and record.name != self._run.name:
            return f"the run is called {record.name!r}, at its start {self._run.name!r}"
        self._run = self._run or record
        if record.phase != Run.FINISHED:
            return ""
        self._threads[0] = record.thread or _MAIN_THREAD
        for number, began in self._running.items():
            if began.parent not in self._running and self._ends_with_parent(began):
                return f"the run ends, but task {number} ({began.name}), which started at step {began.seq}, doesn't"
        return ""

    def _ends_with_parent(self, task: Task) -> bool:
        """Return whether a task can't outlive the one around it, or the run: a daemon thread's or a worker's can."""
        return task.kind == "branch" or task.thread == self._threads[task.parent]

    def _compare(self, frame: Keyframe) -> Deviation | None:
        """Return how a keyframe differs from what the records before it add up to."""
        self.keyframes += 1
        return first_deviation(
            _plain(fold([frame]).worlds[frame.world]), _plain(self._worlds[frame.world].build()), frame.world
        )


def _plain(world: World) -> Plain:
    """Return a world as JSON data, bodies by name and as they were loaded, attachments by their pairs."""
    data = world_data(world)
    held = data.pop("attachments")
    assert isinstance(held, list)  # noqa: S101  for mypy
    pairs: dict[str, Plain] = {f"{each['carrier']}, {each['body']}": each for each in held if isinstance(each, dict)}
    loaded: list[Plain] = [
        # the color is that of now, which the body's state has
        {key: value for key, value in message_data(body.loaded).items() if key != "color"}
        for body in world.bodies.values()
    ]
    return data | {"attachments": dict(sorted(pairs.items())), "loaded": loaded}
