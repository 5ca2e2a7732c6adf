"""Watching: seeing every state of a term, in order, for as long as one waits.

Whoever changes a leaf only hands on the new state; it is looked at by the one who waits, in his own thread and without
a lock. So a slow or broken function of a network harms nobody else, and a moment is long enough to be seen.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING

from pycram.fluents.expressions import lock
from pycram.scheduling.cancellation import Condition, checkpoint, wait

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

    from pycram.fluents.expressions import State, Term, Value


class Watch:
    """Sees the state of a term when its block begins, and every one after that until the block ends.

    Args:
        term: what to watch; while nobody does, it costs nothing.
    """

    __slots__ = ("_news", "_states", "_term")

    def __init__(self, term: Term) -> None:
        self._term = term
        self._news = Condition()
        self._states: deque[State] = deque()

    def __enter__(self) -> Self:
        with lock:
            for leaf in self._term.leaves:
                leaf.watchers.append(self)
            self.see()
        return self

    def __exit__(self, *_: object) -> None:
        with lock:
            for leaf in self._term.leaves:
                leaf.watchers.remove(self)

    def see(self) -> None:
        """Notes the state; called with the lock held."""
        if not self._states:  # otherwise he isn't asleep, or has been woken already
            self._news.notify_all()
        self._states.append({leaf: leaf.held for leaf in self._term.leaves})

    def states(self, timeout: float | None = None) -> Iterator[State]:
        """The states, as they come.

        Args:
            timeout: in seconds from now; None to go on for ever.

        Yields:
            Each state until the time is up, however fast they come.

        Raises:
            Cancelled: the branch has been told to stop.
        """
        limit = None if timeout is None else min(timeout, threading.TIMEOUT_MAX)
        end = None if limit is None else time.monotonic() + limit
        while True:
            late = end is not None and time.monotonic() >= end
            for _ in range(len(self._states)):
                checkpoint()
                yield self._states.popleft()
            if late:
                return
            left = None if end is None else max(0.0, end - time.monotonic())
            wait(self._news, lambda: bool(self._states), left)


def first_value(term: Term, timeout: float | None = None) -> Value:
    """Waits until the value of a term is not None.

    Args:
        term: the term.
        timeout: in seconds; None to wait for ever.

    Returns:
        The value that it had then, if only for a moment; None when the time is up.

    Raises:
        Cancelled: the branch has been told to stop.
        WorldClosed: something that it follows is gone.
        Exception: what a function of the network raised.
    """
    with Watch(term) as watch:
        values = (term.value(state) for state in watch.states(timeout))
        return next((value for value in values if value is not None), None)
