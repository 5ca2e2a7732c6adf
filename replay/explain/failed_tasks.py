"""The failed tasks of a recording, collected in one pass; of successful tasks only the last of each kind is kept."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from recorder.records import Task
from recorder.tasks import is_dealt_with
from replay.state.json_data import arguments_data

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.records import Failure
    from replay.file.log import Log
    from replay.state.json_data import Plain


@dataclass(slots=True, eq=False)
class TaskExecution:
    """One execution of a task, with those of its parts that failed or have not ended.

    Attributes:
        started: the record of its start.
        outer: the task that it is part of; None for an outermost one.
        finished: the record of its end; None if it has not ended.
        parts: in the order of their start.
    """

    started: Task
    outer: TaskExecution | None = None
    finished: Task | None = None
    parts: list[TaskExecution] = field(default_factory=list)

    @property
    def failure(self) -> Failure | None:
        """What it failed with; None if it has not."""
        return self.finished.failure if self.finished is not None and self.finished.status == Task.FAILED else None

    @property
    def error(self) -> tuple[str, str] | None:
        """Type and message of what it failed with."""
        failure = self.failure
        return (failure.type, failure.message) if failure is not None else None

    @property
    def end(self) -> int:
        """The step of its end; of its start if it has not ended."""
        return self.finished.seq if self.finished is not None else self.started.seq

    @property
    def dealt_with(self) -> bool:
        """Whether a task around it succeeded or was cancelled: then its failure had no consequence."""
        return is_dealt_with(task.finished for task in self.around())

    @property
    def parameters(self) -> dict[str, Plain]:
        """Its parameters by name."""
        return arguments_data(self.started.parameters)

    @property
    def outermost(self) -> TaskExecution:
        """The outermost task around it that failed too."""
        task = self
        while task.outer is not None and task.outer.failure is not None:
            task = task.outer
        return task

    @property
    def origin(self) -> TaskExecution:
        """The part in which its failure began: down the parts with the same error, else the last that failed."""
        task = self
        while True:
            failed = [part for part in task.parts if part.failure is not None]
            same = [part for part in failed if part.error == task.error]
            if not failed:
                return task
            task = (same or failed)[-1]

    @property
    def motion(self) -> TaskExecution:
        """The motion that it is part of, or is; itself if there is none."""
        return next((task for task in self.around() if task.started.kind == "motion"), self)

    def around(self) -> Iterator[TaskExecution]:
        """Yield the task itself and those that it is part of, outwards."""
        task: TaskExecution | None = self
        while task is not None:
            yield task
            task = task.outer


@dataclass(frozen=True, slots=True)
class Failures:
    """What failed, what is unfinished and what succeeded.

    Attributes:
        origins: the tasks in which failures began, in the order of their ends.
        running: the tasks that have not ended, in the order of their starts.
        successes: the last successful one of each kind and name.
    """

    origins: tuple[TaskExecution, ...]
    running: tuple[TaskExecution, ...]
    successes: Mapping[tuple[str, str], TaskExecution]

    @property
    def last_success(self) -> TaskExecution | None:
        """The last motion, or else task, that succeeded."""
        motions = [task for (kind, _), task in self.successes.items() if kind == "motion"]
        return max(motions or self.successes.values(), key=lambda task: task.end, default=None)


def failures(log: Log, stop: int | None = None) -> Failures:
    """Return what failed in a recording before a step, or at all."""
    running: dict[int, TaskExecution] = {}
    successes: dict[tuple[str, str], TaskExecution] = {}
    origins: list[TaskExecution] = []
    for record in log.records(Task, stop=stop):
        if record.phase == Task.STARTED:
            outer = running.get(record.parent)
            task = running[record.task] = TaskExecution(record, outer)
            if outer is not None:
                outer.parts.append(task)
            continue
        task = running.pop(record.task) if record.task in running else TaskExecution(record, running.get(record.parent))
        task.finished = record
        if record.status == Task.FAILED:
            if all(part.failure is None for part in task.parts):
                origins.append(task)
        elif task.outer is not None and task in task.outer.parts:
            task.outer.parts.remove(task)
        if record.status == Task.SUCCEEDED:
            successes[record.kind, record.name] = task
    return Failures(tuple(origins), tuple(running.values()), successes)
