"""What caused a record: the tasks that it is part of, innermost first, each with the plan's line that started it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Task
from replay.plain import plain_arguments
from replay.source import Source

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.records import Record
    from replay.log import Log
    from replay.plain import Plain
    from replay.source import Line


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
    """

    task: int
    kind: str
    name: str
    parameters: Mapping[str, Plain]
    step: int
    line: Line | None

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
        )


def causes(log: Log, record: Record) -> tuple[Cause, ...]:
    """The tasks that a record is part of, innermost first; none if the plan itself did it.

    Args:
        log: the recording.
        record: any of its records; one of a task is part of that task.
    """
    source = Source(log)
    found = []
    wanted = record.task
    if wanted:
        for task in log.backwards(record.seq, Task):  # whatever a task is part of started before it
            if isinstance(task, Task) and task.task == wanted and task.phase == Task.STARTED:
                found.append(Cause.of(task, source))
                wanted = task.parent
                if not wanted:
                    break
    return tuple(found)
