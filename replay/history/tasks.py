"""The tasks around a record, and the tree of all tasks, as in :mod:`recorder.tasks`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import Output, Query, Task
from recorder.records.text import is_choice
from recorder.tasks import Tree
from replay.errors import Damaged
from replay.history.failures import root_cause, uncaught_failure
from replay.history.source import PlanSource
from replay.state.integrity import TaskDepths

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Record
    from recorder.tasks import Node
    from replay.file.record_reader import RecordReader
    from replay.history.source import Line


@dataclass(frozen=True, slots=True)
class CausingTask:
    """A task that a record is part of."""

    started: Task  # the record of its start
    #: the plan's lines that led to it, outermost first and that which started it last; empty if unknown
    call_stack: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class CausingTasks:
    """The tasks around a record, and the lines of the plan that led to it."""

    #: the tasks that it is part of, innermost first; none if the plan itself did it, outside of any task
    tasks: tuple[CausingTask, ...]
    #: the plan's lines that led to the record, outermost first and that line last: those that the record has if the
    #: plan's own code made it, else those of the innermost task that has them
    call_stack: tuple[Line, ...]


def causing_tasks(log: RecordReader, record: Record) -> CausingTasks:
    """Return the tasks around a record; the record of a task is part of that task."""
    source = PlanSource(log)
    tasks = []
    number = record.task
    for started in log.backwards(record.seq, Task) if number else ():
        if started.phase == Task.STARTED and started.task == number:  # parents start before their children
            tasks.append(CausingTask(started, source.call_stack(started)))
            number = started.parent
            if not number:
                break
    stacks = [source.call_stack(record), *(task.call_stack for task in tasks)]
    return CausingTasks(tuple(tasks), next(filter(None, stacks), ()))


_UNPACKED: Final = 20_000  # tasks; each takes some 3 kB, packed ones less than 1


def choices(log: RecordReader, failed: Node, stop: int | None = None) -> Iterator[Query]:
    """Yield the choices of a failed task's motion and of its parts."""
    motion = failed.motion
    ids = {node.id for _, node in motion.walk()}
    end = motion.last_step + 1
    for query in log.records(Query, motion.started.seq, end if stop is None else min(stop, end)):
        if is_choice(query) and query.task in ids:
            yield query


def tree(log: RecordReader, stop: int | None = None) -> Tree:
    """Return the task tree of a recording, as it was before a step if one is given.

    Raises:
        Damaged: tasks are nested deeper than any plan's.
    """
    folded = Tree(unpacked=_UNPACKED)
    depths = TaskDepths()
    for record in log.records((Task, Output), stop=stop):
        if isinstance(record, Output):
            folded.output.setdefault(record.task, []).append(record)
        elif isinstance(record, Task):
            if too_deep := depths.too_deep(record):
                raise Damaged(log.path, f"step {record.seq}", too_deep)
            folded.apply(record)
    if stop is None and uncaught_failure(log) is not None:
        cause = root_cause(log)  # the plan's own failure is more specific than those of its tasks
        folded.began = cause.task.id if cause is not None and cause.task is not None else 0
    failed = folded.failure_path()
    if failed:
        for choice in choices(log, failed[-1], stop):
            folded.nodes[choice.task].choices.append(choice)
    return folded
