"""What caused a record: the tasks that it is part of, innermost first, each with the plan's line that started it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Mutation, Task
from replay.explain.source import Source
from replay.state.json_data import arguments_data

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

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
        name: what people call it.
        parameters: as given.
        step: where it starts.
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
        """A task by the record of its start.

        Args:
            started: the record.
            source: the plan's.
        """
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
    """Why a record is there.

    Attributes:
        tasks: the tasks that it is part of, innermost first; none if the plan itself did it, outside of any task.
        own: the lines that led to it, outermost first, where the plan's own code made it and the record tells that.
    """

    tasks: tuple[Cause, ...]
    own: tuple[Line, ...]

    @property
    def line(self) -> Line | None:
        """The plan's line that led to the record, if it is known."""
        return self.way[-1] if self.way else None

    @property
    def way(self) -> tuple[Line, ...]:
        """The plan's lines that led to the record, outermost first and that line last."""
        of_tasks = ((*cause.callers, cause.line) for cause in self.tasks if cause.line is not None)
        return self.own or next(of_tasks, ())


def causes(log: Log, record: Record) -> Causes:
    """Why a record is there.

    Args:
        log: the recording.
        record: any of its records; one of a task is part of that task.
    """
    source = Source(log)
    found = []
    wanted = record.task
    for started in _starts(log.backwards(record.seq, Task)) if wanted else ():
        if started.task == wanted:  # whatever a task is part of started before it
            found.append(Cause.of(started, source))
            wanted = started.parent
            if not wanted:
                break
    return Causes(tuple(found), source.way(record) if isinstance(record, Mutation) else ())


def _starts(records: Iterator[Record]) -> Iterator[Task]:
    for record in records:
        if isinstance(record, Task) and record.phase == Task.STARTED:
            yield record
