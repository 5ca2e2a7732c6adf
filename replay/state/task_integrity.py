"""Checks whether the tasks of a recording, and the run around them, begin and end as they must."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Run, Task

if TYPE_CHECKING:
    from collections.abc import Mapping

MAX_DEPTH: Final = 2000
"""Levels of tasks in each other; plans come to about 1,000, where Python's stack ends."""
_MAIN_THREAD: Final = "MainThread"  # which ends the run, in recordings of release 0.1.0, that don't say it
#: What may come after each phase of a task; a branch that is asked for may be cancelled before it starts.
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
_SAME: Final = ("kind", "name", "attempt", "parent")  # in all records of a task


class TaskDepths:
    """How deep tasks are in each other, record by record."""

    def __init__(self) -> None:
        self._depths: dict[int, int] = {}

    def too_deep(self, record: Task) -> str:
        """Take the next record of a task; return that it is nested deeper than any plan's, in words, or ""."""
        depth = self._depths[record.task] = self._depths.get(record.parent, 0) + 1
        return f"its task is nested more than {MAX_DEPTH} deep" if depth > MAX_DEPTH else ""


class TaskIntegrity:
    """Checks records of tasks and the run one after the other.

    Args:
        newer: whether a newer release made the recording, whose tasks may have phases and statuses that aren't known.

    Attributes:
        tasks: number of tasks.
        partial: whether records were missing, which may have begun or ended any task.
    """

    def __init__(self, *, newer: bool = False) -> None:
        self._newer = newer
        self.tasks = 0
        self.partial = False
        self._names: dict[int, tuple[str, int]] = {}
        self._phases: dict[int, Task.Phase] = {}
        self._running: dict[int, Task] = {}
        self._threads: dict[int, str] = {}
        self._left = 0  # number of tasks that run on when the recording ends
        self._run: Run | None = None

    @property
    def unfinished(self) -> int:
        """Number of tasks that have not ended."""
        return len(self._running) + self._left

    def path(self, number: int) -> tuple[str, ...]:
        """Return a task and what it is part of, outermost first."""
        names: list[str] = []
        while number in self._names and len(names) <= len(self._names):
            name, number = self._names[number]
            names.append(name)
        return tuple(reversed(names))

    def knows(self, number: int) -> bool:
        """Return whether a task has begun, or may have; 0 is none."""
        return not number or number in self._names or self.partial

    def resume(self) -> None:
        """Go on behind records that are missing."""
        self.partial = True
        self._running.clear()

    def check(self, record: Task) -> str:
        """Take the next record of a task; return what is wrong with it, or ""."""
        number, before = record.task, self._phases.get(record.task)
        if self._newer and record.phase not in Task.Phase.values():
            return ""
        cause = self._misplaced(record, before) or self._unlike(record)
        if cause:
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

    def _misplaced(self, record: Task, before: Task.Phase | None) -> str:
        if record.phase in _AFTER.get(before, ()) or self.partial:
            return ""
        last = "never started" if before is None else f"was {_name(before)} before"
        return f"task {record.task} is {_name(record.phase)}, but it {last}"

    def _unlike(self, record: Task) -> str:
        """Return how a record isn't like what it says of itself, or like its task's beginning; or ""."""
        subject = f"task {record.task}"
        if self._newer and record.status not in Task.Status.values():
            return ""
        if record.status not in _STATUSES.get(record.phase, ()):
            return f"{subject} is {_name(record.phase)} with a status that doesn't go with that"
        cause = _failure(failed=record.status == Task.FAILED, recorded=record.HasField("failure"))
        if cause:
            return f"{subject} {cause}"
        began = self._running.get(record.task)
        if began is None:
            return ""
        for field in _SAME:
            # the parent of a task that runs on may be in no record
            elsewhere = field == "parent" and (began.began_ns or record.phase == Task.LEFT)
            if getattr(began, field) != getattr(record, field) and not elsewhere:
                return f"the {field} of {subject} isn't that of its beginning at step {began.seq}"
        return ""

    def check_run(self, record: Run) -> str:
        """Take the next record of the run; return what is wrong with it, or ""."""
        failed = record.phase == Run.THREAD_FAILED or (record.phase == Run.FINISHED and not record.succeeded)
        cause = _failure(failed=failed, recorded=record.HasField("failure"))
        if cause:
            return f"the run {cause}"
        if record.succeeded and record.phase != Run.FINISHED:
            return "the run succeeded, but does not end here"
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
        return task.kind == "branch" or task.thread == self._threads.get(task.parent)


def _failure(*, failed: bool, recorded: bool) -> str:
    if failed == recorded:
        return ""
    return "failed, but has no failure" if failed else "has a failure, but did not fail"


def _name(phase: Task.Phase) -> str:
    value = Task.Phase.DESCRIPTOR.values_by_number.get(phase)
    return value.name.lower() if value is not None else f"in phase {phase}"
