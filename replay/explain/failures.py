"""The failures of a recording: of tasks, and of threads of the plan's own.

Tasks are collected in one pass; of those that succeeded only motions, and the last of each kind, are kept. Of very many
the earliest are forgotten, so that a recording of any length is explained in the same memory.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import Run, Task
from recorder.tasks import Node

if TYPE_CHECKING:
    from collections.abc import Mapping

    from replay.file.record_reader import RecordReader

_RUN_RECORDS: Final = 2  # of a run without failed threads: started, finished
_MAX_KEPT: Final = 5_000  # failures, and motions: a node with its records takes some 3 kB


@dataclass(frozen=True, slots=True)
class Failures:
    """What failed, what is unfinished and what succeeded; as parts tasks have those that failed or have not ended.

    Attributes:
        origins: the tasks in which failures began, in the order of their ends; the last ones.
        running: the tasks that have not ended, in the order of their starts.
        successes: the last successful one of each kind and name.
        motions: the motions that have ended, in the order of their ends; the last ones.
        forgotten: number of earlier origins that were left out.
        first_motion: the step at which the first motion began; None if none did.
    """

    origins: tuple[Node, ...]
    running: tuple[Node, ...]
    successes: Mapping[tuple[str, str], Node]
    motions: tuple[Node, ...] = ()
    forgotten: int = 0
    first_motion: int | None = None

    @property
    def last_success(self) -> Node | None:
        """The last motion, or else task, that succeeded."""
        motions = [task for (kind, _), task in self.successes.items() if kind == "motion"]
        return max(motions or self.successes.values(), key=lambda task: task.last_step, default=None)


def failures(log: RecordReader, stop: int | None = None) -> Failures:
    """Return what failed in a recording before a step, or at all."""
    running: dict[int, Node] = {}
    successes: dict[tuple[str, str], Node] = {}
    origins: deque[Node] = deque()
    motions: deque[Node] = deque(maxlen=_MAX_KEPT)
    forgotten, first_motion = 0, None
    for record in log.records(Task, stop=stop):
        if first_motion is None and record.kind == "motion":
            first_motion = record.seq
        number, parent = record.task, running.get(record.parent)
        if record.phase == Task.STARTED:
            running[number] = Node(record, parent)
            if parent is not None:
                parent.parts[number] = running[number]
        elif record.phase == Task.FINISHED:
            task = running.pop(number, None) or Node(record, parent)
            task.finished = record
            if task.is_origin:
                forgotten += _keep(origins, task)
            if task.kind == "motion":
                motions.append(task)
            if task.parent is not None and not task.failed:
                task.parent.parts.pop(number, None)
            if record.status == Task.SUCCEEDED:
                successes[record.kind, record.name] = task
    return Failures(tuple(origins), tuple(running.values()), successes, tuple(motions), forgotten, first_motion)


def _keep(origins: deque[Node], task: Node) -> int:
    """Add a task in which a failure began, and return how many had to be dropped, also from what they were part of."""
    origins.append(task)
    if len(origins) <= _MAX_KEPT:
        return 0
    outer = origins.popleft().outermost_failed
    if outer.parent is not None:
        outer.parent.parts.pop(outer.id, None)
    return 1


def failed_threads(log: RecordReader) -> tuple[Run, ...]:
    """Return the records of threads of the plan's own that ended with a failure while it went on."""
    if log.counts().get("run", 0) <= _RUN_RECORDS:
        return ()
    return tuple(record for record in log.records(Run) if record.phase == Run.THREAD_FAILED)
