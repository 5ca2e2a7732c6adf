"""What caused a record: the tasks that it is part of, innermost first, each with the plan's line that started it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder.records import Task
from replay.plain import plain_arguments
from replay.source import Source

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.records import Record
    from replay.log import Log
    from replay.plain import Plain
    from replay.source import Line

_NEAR: Final = 1000  # tasks' records that are looked at for the lines around a record


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
            plain_arguments(started.parameters),
            started.seq,
            source.line(started.source_file, started.source_line),
            source.callers(started),
        )


@dataclass(frozen=True, slots=True)
class Causes:
    """Why a record is there.

    Attributes:
        tasks: the tasks that it is part of, innermost first; none if the plan itself did it, outside of any task.
        after: the last line before it at which the plan started something in the same thread, if that is known.
        before: the first line behind it at which it did.
    """

    tasks: tuple[Cause, ...]
    after: Line | None
    before: Line | None

    @property
    def line(self) -> Line | None:
        """The plan's line that led to the record, if it is known."""
        return next((cause.line for cause in self.tasks if cause.line is not None), None)

    @property
    def way(self) -> tuple[Line, ...]:
        """The plan's lines that led to the record, outermost first and that line last."""
        return next(((*cause.callers, cause.line) for cause in self.tasks if cause.line is not None), ())


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
    if found:
        return Causes(tuple(found), None, None)
    after = _way(source, record, log.backwards(record.seq, Task))
    before = _way(source, record, log.records(Task, record.seq))
    return Causes((), *_between(after, before))


def _starts(records: Iterator[Record]) -> Iterator[Task]:
    for record in records:
        if isinstance(record, Task) and record.phase == Task.STARTED:
            yield record


def _way(source: Source, record: Record, records: Iterator[Record]) -> tuple[Line, ...]:
    """The plan's lines that led to the first task in the same thread."""
    for started in _starts(islice(records, _NEAR)):
        if started.thread == record.thread and started.source_line:
            return source.way(started)
    return ()


def _between(after: tuple[Line, ...], before: tuple[Line, ...]) -> tuple[Line | None, Line | None]:
    """Of two ways the lines where they part; else the innermost that are in the plan's own file, not in its modules."""
    for one, other in zip(after, before, strict=False):
        if one != other:
            return one, other
    return _own(after), _own(before)


def _own(way: tuple[Line, ...]) -> Line | None:
    return next((line for line in reversed(way) if line.file == way[0].file), None)
