"""Pools of forked children: projections, and runs of plans that are explored or swept, several in parallel."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from pycram.projection.child import Child, wait
from pycram.scheduling.cancellation import checkpoint
from pycram.scheduling.schedule import MISSED_SIGNALS_EVERY, scheduler
from pycram.world.world import number_anew
from recorder.tracing import interrupts

if TYPE_CHECKING:
    from collections import deque
    from collections.abc import Callable, Generator

Job = TypeVar("Job")

GRACE: Final = 5.0  # s that a run of a plan has to end after it was interrupted


@dataclass(frozen=True, slots=True)
class ChildResult:
    """The result of a child."""

    answer: bytes  # b"" if it sent none
    late: bool  # whether it exceeded the time limit
    how: str  # how its process ended, in words
    seconds: float  # that it took


class _Running:
    """A child with a time limit: at the limit it is interrupted, after a grace time killed."""

    def __init__(self, child: Child, limit: float | None, grace: float) -> None:
        self.child = child
        self._end = None if limit is None else child.began + limit
        self._grace = grace
        self._late = False

    def time_left(self) -> float:
        """Return the seconds until its next signal, at most the time between looks at missed signals."""
        if self._end is None:
            return MISSED_SIGNALS_EVERY
        return min(max(0.0, self._end - time.monotonic()), MISSED_SIGNALS_EVERY)

    def result(self) -> ChildResult | None:
        """Return its result, None while it runs; send the signal that is due."""
        child = self.child
        if not child.ended and self._end is not None and time.monotonic() >= self._end:
            if self._late or not self._grace:
                child.kill()
            else:
                self._end = time.monotonic() + self._grace
                os.kill(child.pid, signal.SIGTERM)
            self._late = True
        if not child.ended:
            return None
        return ChildResult(bytes(child.received), self._late, child.how, time.monotonic() - child.began)


class ChildPool(Generic[Job]):
    """Children that run in parallel.

    Args:
        cores: Maximum number of children.
        limit: Seconds of wall-clock time for each; None for no limit.
        grace: Seconds after the limit, and after a SIGTERM, before a child is killed; 0 to kill it at the limit.
    """

    def __init__(self, cores: int, limit: float | None, grace: float = 0.0) -> None:
        self.cores = cores
        self.limit = limit
        self._grace = grace
        self._running: dict[Job, _Running] = {}

    def run(self, waiting: deque[Job], start: Callable[[Job], Child]) -> Generator[tuple[Job, ChildResult], None, None]:
        """Yield each job with its child's result, as they end; closing the generator kills the remaining children.

        Args:
            waiting: The jobs in order; the caller may add or remove jobs meanwhile.
            start: Starts the child of a job.
        """
        running = self._running
        try:
            while waiting or running:
                while waiting and len(running) < self.cores:
                    job = waiting.popleft()
                    running[job] = _Running(start(job), self.limit, self._grace)
                wait([each.child for each in running.values()], min(each.time_left() for each in running.values()))
                if interrupts.is_pending():
                    checkpoint()
                for job, each in list(running.items()):
                    if job in running and (result := each.result()) is not None:
                        del running[job]
                        yield job, result
        finally:
            for job in list(running):
                self.kill(job)

    def is_running(self, job: Job) -> bool:
        """Return whether a job's child runs."""
        return job in self._running

    def kill(self, job: Job) -> None:
        """Kill a job's child; the job is not yielded."""
        self._running.pop(job).child.kill()


def run_from_start(answer: Callable[[], bytes]) -> Child:
    """Fork a child that runs a program from its start, with the world names that the program has there."""
    return Child(partial(_answer_from_start, answer))


def _answer_from_start(answer: Callable[[], bytes]) -> bytes:
    number_anew()
    scheduler().alone = False  # it may wait for a signal
    return answer()
