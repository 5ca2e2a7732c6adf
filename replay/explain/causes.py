"""The causes of a record: the tasks that it is part of, innermost first, each with the plan's line that started it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Mutation, Task
from replay.explain.source import Source
from replay.state.json_data import arguments_data

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.records import Record
    from replay.explain.source import Line
    from replay.file.log import Log
    from replay.state.json_data import Plain


@dataclass(frozen=True, slots=True)
class Cause:
    """A task that something is part of.

    Attributes:
        task: its id.
        kind: of the node: motion, process-module, block, ...
        name: its name.
        parameters: as given.
        step: its start.
        line: the plan's line that started it; None if it is not known.
        callers: the plan's lines that led to that one, outermost first.
    """

    task: int
    kind: str
    name: str
    parameters: Mapping[str, Plain]
    step: int
    line: Line | None
    callers: tuple[Line, ...]

    @classmethod
    def of(cls, started: Task, source: Source) -> Cause:
        """Return the cause that the start of a task is, with lines of the plan's source."""
        return cls(
            started.task,
            started.kind,
            started.name,
            arguments_data(started.parameters),
            started.seq,
            source.line(started.source_file, started.source_line),
            source.callers(started),
        )


@dataclass(frozen=True, slots=True)
class Causes:
    """The causes of a record.

    Attributes:
        tasks: the tasks that it is part of, innermost first; none if the plan itself did it, outside of any task.
        own_call_stack: the lines that led to it, outermost first, if the plan's own code made it and the record has
            them.
    """

    tasks: tuple[Cause, ...]
    own_call_stack: tuple[Line, ...]

    @property
    def line(self) -> Line | None:
        """The plan's line that led to the record, if it is known."""
        return self.call_stack[-1] if self.call_stack else None

    @property
    def call_stack(self) -> tuple[Line, ...]:
        """The plan's lines that led to the record, outermost first and that line last."""
        of_tasks = ((*cause.callers, cause.line) for cause in self.tasks if cause.line is not None)
        return self.own_call_stack or next(of_tasks, ())


def causes(log: Log, record: Record) -> Causes:
    """Return the causes of a record; a task's record is part of that task."""
    source = Source(log)
    tasks = []
    task = record.task
    for started in log.backwards(record.seq, Task) if task else ():
        if started.phase == Task.STARTED and started.task == task:  # whatever a task is part of started before it
            tasks.append(Cause.of(started, source))
            task = started.parent
            if not task:
                break
    return Causes(tuple(tasks), source.call_stack(record) if isinstance(record, Mutation) else ())
