"""The root cause: the one failure that explains how a plan ended. ``why``, the step ``failure`` and trees use it.

A plan that failed did so with an exception: it began in the task that raised it, or that raised the nearest of its
causes; else in the plan's own code. One that was interrupted ended where the interrupt came, whatever failed before.
If the plan succeeded, the same holds for an uncaught exception of a thread of its own. Else, or where the recording was
cut, it is the last failure that no task around it recovered from, or the last.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import Run
from recorder.tasks import decisive
from replay.explain.failures import failed_threads, failures
from replay.explain.parsed_traceback import ParsedException, parse_traceback
from replay.explain.plan_source import Source

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Failure
    from recorder.tasks import Node
    from replay.explain.failures import Failures
    from replay.file.record_reader import RecordReader

#: What a plan ends with that somebody interrupts.
INTERRUPT: Final = "KeyboardInterrupt"


@dataclass(frozen=True, slots=True)
class RootCause:
    """The root cause of a failure.

    Attributes:
        step: the moment of it: the end of the task in which it began; of a failure of the plan's own code the last step
            before worlds were closed, or that in which its thread ended.
        task: the task in which it began; None if the plan's own code did it.
        failure: what the plan, or a thread of it, failed with; None if neither did.
        thread: name of that thread; "" if the plan failed.
        exceptions: those from that task on that led to the plan's failure, causes first.
    """

    step: int
    task: Node | None
    failure: Failure | None = None
    thread: str = ""
    exceptions: tuple[ParsedException, ...] = ()


def root_cause(log: RecordReader, failed: Failures | None = None) -> RootCause | None:
    """Return where a recording's plan broke; None if nothing failed."""
    failed = failed if failed is not None else failures(log)
    end = uncaught_failure(log)
    if end is None:
        task = decisive(failed.origins)
        return RootCause(task.last_step, task) if task is not None else None
    thread = end.thread if end.phase == Run.THREAD_FAILED else ""
    exceptions = _exceptions(end.failure, Source(log))
    earlier = [task for task in failed.origins if task.last_step < end.seq]  # the plan may go on, and fail alike
    if end.failure.type == INTERRUPT:  # not because of what had failed before
        exceptions = exceptions[-1:]
        earlier = [task for task in earlier if task.error is not None and task.error[0] == INTERRUPT]
    origin = _origin(earlier, exceptions)
    if origin is None:
        return RootCause(end.seq if thread else log.final_step(), None, end.failure, thread, exceptions)
    task, first = origin
    return RootCause(task.last_step, task, end.failure, thread, exceptions[first:])


def uncaught_failure(log: RecordReader) -> Run | None:
    """Return the record of an uncaught failure: of the plan's end, else of the last thread that failed."""
    end = log[-1]
    if isinstance(end, Run) and end.HasField("failure"):
        return end
    return next(reversed(failed_threads(log)), None)


def _exceptions(failure: Failure, source: Source) -> tuple[ParsedException, ...]:
    """Return the exceptions, causes first; the last one is the failure itself, whose words the record has."""
    exceptions = parse_traceback(failure.traceback, source)
    last = exceptions.pop() if exceptions else ParsedException("", "", ())
    return (*exceptions, ParsedException(failure.type, failure.message, last.lines, last.own))


def _origin(origins: Sequence[Node], exceptions: Sequence[ParsedException]) -> tuple[Node, int] | None:
    """Return the task that raised the failure or else its nearest cause, and the index of that exception.

    What was raised earlier had been handled, even if Python's traceback still has it. Of all that failed in a block it
    is the task whose error became the block's, whichever ended last.
    """
    for number in range(len(exceptions) - 1, -1, -1):
        error = exceptions[number].type, exceptions[number].message
        raising = [task for task in origins if any(outer.error == error for outer in task.around())]
        if raising:
            return next((task for task in reversed(raising) if task.error == error), raising[-1]), number
    return None
