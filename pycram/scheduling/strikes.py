"""Strikes: a deadline or a worker ends. The scheduler polls for them at checkpoints; see :mod:`.schedule`."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from typing import Protocol, Self

from pycram.foundation.forcing import forced
from pycram.scheduling.schedule import Condition, RecordedStrikes, scheduler


class Clock(Protocol):
    """A simulated clock; a wait lets it run when no branch of its thread is ready."""

    def may_pass(self) -> bool:
        """Return whether simulated time may pass now."""

    def let_pass(self) -> None:
        """Let simulated time pass until a branch is ready."""


class Limit(Condition, ABC):
    """A deadline of a part of the plan, which notifies waits when it comes."""

    clock: Clock | None = None  # the simulated clock by which the deadline is measured; None for wall-clock time

    @property
    @abstractmethod
    def has_come(self) -> bool:
        """Whether the deadline has come."""

    @property
    @abstractmethod
    def was_missed(self) -> bool:
        """Whether the deadline has passed."""


class StrikeSource(Condition):
    """A deadline or a worker that the scheduler polls during a ``with`` block.

    Args:
        end: Value of ``time.monotonic()`` at which the strike comes; infinity if unknown.
    """

    def __init__(self, end: float = math.inf) -> None:
        super().__init__()
        self.struck = False  # whether the scheduler has polled the source after the strike
        self.end = end
        self._scheduler = scheduler()

    def is_due(self) -> bool:
        """Return whether the strike has come."""
        return self.end <= time.monotonic()

    def await_due(self) -> None:
        """Block the thread until the recorded strike can come; a deadline can always strike."""

    @property
    def has_come(self) -> bool:
        """Whether the strike has come."""
        if self.struck:
            return True
        if self._scheduler is not scheduler():  # the caller may be another thread or a forked child
            return self.is_due()
        self._scheduler.poll()
        return self.struck

    def __enter__(self) -> Self:
        self._scheduler.strike_sources[self] = None
        return self

    def __exit__(self, *_: object) -> None:
        self._scheduler.strike_sources.pop(self, None)


def limited(seconds: float) -> float:
    """Return the seconds of a limit; in a fork of a run, another limit may be forced."""
    return float(forced("timeout timeout", {"seconds": seconds}) or seconds)


class Deadline(StrikeSource, Limit):
    """A deadline in wall-clock time, in seconds from now."""

    def __init__(self, seconds: float) -> None:
        super().__init__(time.monotonic() + limited(seconds))

    @property
    def was_missed(self) -> bool:
        """Whether the deadline has passed."""
        return self.has_come


def guide_strikes(recorded: RecordedStrikes, polls: int) -> None:
    """Make strikes come at the same polls of this thread as in a recorded run.

    If the recording has no strike for a sleeping thread, strikes come as in an unguided run: a signal or another thread
    woke the recorded thread, or the plan has changed.

    Args:
        recorded: The recorded strikes by the recorded run's poll numbers.
        polls: Number of polls before this moment in the recorded run.
    """
    thread = scheduler()
    difference = polls - thread.polls
    thread.recorded_strikes = lambda poll: recorded(poll + difference)
