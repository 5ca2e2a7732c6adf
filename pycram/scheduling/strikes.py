"""Strikes: deadlines, and ends of workers. The scheduler polls for them at checkpoints; see :mod:`.schedule`."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Protocol

from pycram.scheduling.schedule import Condition, scheduler

if TYPE_CHECKING:
    from typing import Self

    from pycram.scheduling.schedule import RecordedStrikes


class Clock(Protocol):
    """Simulated time that a wait lets pass when nothing else of its thread is ready."""

    def may_pass(self) -> bool:
        """Return whether it may pass now."""

    def let_pass(self) -> None:
        """Let it pass until something is ready."""


class Limit(Condition, ABC):
    """A deadline of a part of the plan; notified when it comes."""

    clock: Clock | None = None
    """The simulated time that the waits before it let pass; None for a deadline in wall-clock time."""

    @property
    @abstractmethod
    def has_come(self) -> bool:
        """Whether the deadline is now, or has passed."""

    @property
    @abstractmethod
    def was_missed(self) -> bool:
        """Whether the deadline has passed."""


class StrikeSource(Condition):
    """A source of a strike: a clock or a worker, which the scheduler polls in a ``with`` block.

    Args:
        end: Time of time.monotonic() at which it strikes by itself; infinity if unknown.
    """

    def __init__(self, end: float = math.inf) -> None:
        super().__init__()
        self.struck = False  # whether its thread has seen the strike
        self.end = end
        self._scheduler = scheduler()

    def is_due(self) -> bool:
        """Return whether it strikes now."""
        return self.end <= time.monotonic()

    def await_due(self) -> None:
        """Block the thread until the strike that the recording has here can come; a deadline can always strike."""

    @property
    def has_come(self) -> bool:
        """Whether it has struck by now."""
        if self.struck:
            return True
        if self._scheduler is not scheduler():  # in another thread or a forked child
            return self.is_due()
        self._scheduler.poll()
        return self.struck

    def __enter__(self) -> Self:
        self._scheduler.strike_sources[self] = None
        return self

    def __exit__(self, *_: object) -> None:
        self._scheduler.strike_sources.pop(self, None)


class Deadline(StrikeSource, Limit):
    """A deadline of the clock, in seconds from now."""

    def __init__(self, seconds: float) -> None:
        super().__init__(time.monotonic() + seconds)

    @property
    def was_missed(self) -> bool:
        """Whether the deadline has passed."""
        return self.has_come


def guide_strikes(recorded: RecordedStrikes, polls: int) -> None:
    """Make strikes come at the same polls of this thread as in a recorded run.

    If the thread sleeps and the recording has no strike, strikes come by themselves: in the recorded run a signal or
    another thread woke it, or the plan has changed.

    Args:
        recorded: The recorded strikes, by the recorded run's numbers of polls.
        polls: Number of polls that the recorded run had made by now.
    """
    thread = scheduler()
    difference = polls - thread.polls
    thread.recorded_strikes = lambda poll: recorded(poll + difference)
