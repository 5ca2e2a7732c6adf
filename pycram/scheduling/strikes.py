"""What strikes from outside of a plan's order: deadlines of the clock, ends of workers; see :mod:`.schedule`."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from pycram.scheduling.schedule import Condition, scheduler

if TYPE_CHECKING:
    from typing import Self

    from pycram.scheduling.schedule import Foreseen


class Limit(Condition, ABC):
    """A moment at which a part of the plan is to be done; notified when it comes."""

    @property
    @abstractmethod
    def has_come(self) -> bool:
        """Whether it is now, or was."""

    @property
    @abstractmethod
    def was_missed(self) -> bool:
        """Whether it was before this moment."""


class Outer(Condition):
    """Something that the thread waits for in a ``with`` block, which strikes from outside; notified when it does.

    Attributes:
        struck: Whether it has, as far as its thread has looked.
        end: Time of time.monotonic() at which it strikes by itself; infinity if none is known.
    """

    def __init__(self, end: float = math.inf) -> None:
        super().__init__()
        self.struck = False
        self.end = end
        self._scheduler = scheduler()

    def is_due(self) -> bool:
        """Whether it may strike now."""
        return self.end <= time.monotonic()

    def await_due(self) -> None:
        """Block the thread until it may, where a recording says that it does now; a deadline may at any time."""

    @property
    def has_come(self) -> bool:
        """Whether it has struck by now: its thread looks."""
        if self.struck:
            return True
        if self._scheduler is not scheduler():  # another thread, which has looks of its own, or a forked child's
            return self.is_due()
        self._scheduler.look()
        return self.struck

    def __enter__(self) -> Self:
        self._scheduler.outer[self] = None
        return self

    def __exit__(self, *_: object) -> None:
        self._scheduler.outer.pop(self, None)


class Deadline(Outer, Limit):
    """A moment of the clock.

    Args:
        seconds: How far it is from now.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__(time.monotonic() + seconds)

    @property
    def was_missed(self) -> bool:
        """Whether it was before this moment: the clock never stands still."""
        return self.has_come


def guide_strikes(foreseen: Foreseen, looks: int) -> None:
    """Have strikes come in this thread as they did in a recorded run.

    Where the thread sleeps and the recording says nothing, they come by themselves: a signal or a thread of the plan's
    own has woken it then, or the plan is another one.

    Args:
        foreseen: Gives them, by the numbers of the recorded looks.
        looks: How many the recorded run had had by now.
    """
    thread = scheduler()
    difference = looks - thread.looks
    thread.foreseen = lambda look: foreseen(look + difference)
