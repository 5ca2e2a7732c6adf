"""Forked children that have a time to end in, several at once: runs of plans that are explored, or swept."""

from __future__ import annotations

import os
import signal
import time
from functools import partial
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from pycram.projection.child import Child, wait
from pycram.scheduling.schedule import scheduler
from pycram.world.current import number_anew

if TYPE_CHECKING:
    from collections import deque
    from collections.abc import Callable, Generator

K = TypeVar("K")

_GRACE: Final = 5.0  # s that a child has to end after it was interrupted


class LimitedChild:
    """A child that is interrupted when its time is over, and killed when it goes on after that.

    Args:
        answer: Called in the child; what it returns is the answer.
        limit: Seconds by the clock.

    Attributes:
        child: The child.
    """

    def __init__(self, answer: Callable[[], bytes], limit: float) -> None:
        self._limit = limit
        self._interrupted = 0.0  # when
        self.child = Child(partial(_from_start, answer))

    @property
    def late(self) -> bool:
        """Whether it was interrupted."""
        return self._interrupted > 0

    def time_left(self) -> float:
        """Return the seconds until something has to be done about it."""
        end = self._interrupted + _GRACE if self._interrupted else self.child.began + self._limit
        return max(0.0, end - time.monotonic())

    def ended(self) -> bool:
        """Return whether it has; one that takes too long is interrupted, and then killed."""
        if not self.child.ended and self.time_left() <= 0:
            if self._interrupted:
                self.child.kill()
            else:
                self._interrupted = time.monotonic()
                os.kill(self.child.pid, signal.SIGTERM)
        return self.child.ended

    @property
    def how(self) -> str:
        """How its process ended, in words."""
        return f"its process {self.child.how}"


def _from_start(answer: Callable[[], bytes]) -> bytes:
    """Answer in the child, which runs a program from its start: its worlds have the names that they have there."""
    number_anew()
    scheduler().alone = False  # it may wait for what a signal brings
    return answer()


class Several(Generic[K]):
    """Children that run at once.

    Args:
        cores: How many at once.
        limit: Seconds by the clock that each may take.
    """

    def __init__(self, cores: int, limit: float) -> None:
        self.cores = cores
        self.limit = limit

    def run(
        self, waiting: deque[K], answer_of: Callable[[K], Callable[[], bytes]]
    ) -> Generator[tuple[K, LimitedChild], None, None]:
        """Yield each job with its child, as they end; none of them outlives the iteration.

        Args:
            waiting: The jobs, first ones first; more may be added in between.
            answer_of: Gives what a job's child calls, when its turn has come.
        """
        running: list[tuple[K, LimitedChild]] = []
        try:
            while waiting or running:
                while waiting and len(running) < self.cores:
                    job = waiting.popleft()
                    running.append((job, LimitedChild(answer_of(job), self.limit)))
                wait([each.child for _, each in running], min(each.time_left() for _, each in running))
                for pair in [each for each in running if each[1].ended()]:
                    running.remove(pair)
                    yield pair
        finally:
            for _, each in running:
                each.child.kill()
