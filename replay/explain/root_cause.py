"""Where a plan broke: the one failure that explains how it ended. ``why``, the step ``failure`` and trees go by it.

A plan that failed did so with an exception: it began in the task that raised it, or that raised the nearest of its
causes; else in the plan's own code. So did a thread of the plan's own that nobody caught, if the plan went on. Else, or
where the recording was cut, it is the last failure that no task around it dealt with, or the last one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Run
from recorder.tasks import decisive
from replay.explain.failed_tasks import failures
from replay.explain.parsed_traceback import ParsedException, raised
from replay.explain.source import Source
from replay.explain.summary import failed_threads, final_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.records import Failure
    from replay.explain.failed_tasks import Attempt, Failures
    from replay.file.log import Log


@dataclass(frozen=True, slots=True)
class RootCause:
    """Where a plan broke.

    Attributes:
        step: the moment of it: the end of the task in which it began; of a failure of the plan's own code the last step
            before worlds were closed, or that in which its thread ended.
        task: the task in which it began; None if the plan's own code did it.
        failure: what the plan, or a thread of it, failed with; None if neither did.
        thread: name of that thread; "" if the plan failed.
        chain: the exceptions from that task on that led to the plan's failure, causes first.
    """

    step: int
    task: Attempt | None
    failure: Failure | None = None
    thread: str = ""
    chain: tuple[ParsedException, ...] = ()


def root_cause(log: Log, found: Failures | None = None) -> RootCause | None:
    """Where a recording's plan broke; None if nothing failed.

    Args:
        log: the recording.
        found: its failures, where they are known already.
    """
    failed = found if found is not None else failures(log)
    end = uncaught(log)
    if end is None:
        task = decisive(failed.origins)
        return RootCause(task.end, task) if task is not None else None
    thread = end.thread if end.phase == Run.THREAD_FAILED else ""
    chain = _chain(end.failure, Source(log))
    earlier = [task for task in failed.origins if task.end < end.seq]  # the plan may go on, and fail alike
    began = _began(earlier, chain)
    if began is None:
        return RootCause(end.seq if thread else final_of(log), None, end.failure, thread, chain)
    task, first = began
    return RootCause(task.end, task, end.failure, thread, chain[first:])


def uncaught(log: Log) -> Run | None:
    """The record of what nobody caught: of the plan's end, else of the last thread that failed; None if all is well.

    Args:
        log: the recording.
    """
    end = log[-1]
    if isinstance(end, Run) and end.HasField("failure"):
        return end
    return next(reversed(failed_threads(log)), None)


def _chain(failure: Failure, source: Source) -> tuple[ParsedException, ...]:
    """The exceptions, causes first; the last one is the failure itself, whose words the record has."""
    chain = raised(failure.traceback, source)
    last = chain.pop() if chain else ParsedException("", "", ())
    return (*chain, ParsedException(failure.type, failure.message, last.lines))


def _began(origins: Sequence[Attempt], chain: Sequence[ParsedException]) -> tuple[Attempt, int] | None:
    """The task that raised the failure, or else the nearest cause of it that a task raised; and which cause it is.

    What was raised before that had been dealt with, even if Python goes on telling it. Of all that failed in a block it
    is the task whose error became the block's, whichever ended last.
    """
    for number in range(len(chain) - 1, -1, -1):
        error = chain[number].type, chain[number].message
        told = [task for task in origins if any(outer.error == error for outer in task.around())]
        if told:
            return next((task for task in reversed(told) if task.error == error), told[-1]), number
    return None
