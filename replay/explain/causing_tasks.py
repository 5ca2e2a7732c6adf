"""The causes of a record: the tasks that it is part of, innermost first, each with the plan's lines that started it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Task
from replay.explain.plan_source import Source

if TYPE_CHECKING:
    from recorder.records import Record
    from replay.explain.plan_source import Line
    from replay.file.record_reader import RecordReader


@dataclass(frozen=True, slots=True)
class CausingTask:
    """A task that a record is part of.

    Attributes:
        started: the record of its start.
        call_stack: the plan's lines that led to it, outermost first and that which started it last; empty if unknown.
    """

    started: Task
    call_stack: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class Causes:
    """The causes of a record.

    Attributes:
        tasks: the tasks that it is part of, innermost first; none if the plan itself did it, outside of any task.
        call_stack: the plan's lines that led to the record, outermost first and that line last: those that the record
            has if the plan's own code made it, else those of the innermost task that has them.
    """

    tasks: tuple[CausingTask, ...]
    call_stack: tuple[Line, ...]


def causes(log: RecordReader, record: Record) -> Causes:
    """Return the causes of a record; a task's record is part of that task."""
    source = Source(log)
    tasks = []
    number = record.task
    for started in log.backwards(record.seq, Task) if number else ():
        if started.phase == Task.STARTED and started.task == number:  # whatever a task is part of started before it
            tasks.append(CausingTask(started, source.call_stack(started)))
            number = started.parent
            if not number:
                break
    stacks = [source.call_stack(record), *(task.call_stack for task in tasks)]
    return Causes(tuple(tasks), next(filter(None, stacks), ()))
