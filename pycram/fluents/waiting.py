"""Waiting: a stream of all states of an expression, in order.

A change of a leaf only appends the new state; values are computed by the waiting thread, without a lock. So a slow or
failing function of a network harms no other thread, and no state is missed, however short it lasts.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING

from pycram.fluents.expressions import lock
from pycram.scheduling.cancellation import checkpoint, wait
from pycram.scheduling.schedule import Condition

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

    from pycram.fluents.expressions import Expression, State, Value


class StateStream:
    """The state of an expression when its block begins, and every later one until the block ends."""

    __slots__ = ("_expression", "_news", "_states")

    def __init__(self, expression: Expression) -> None:
        self._expression = expression
        self._news = Condition()
        self._states: deque[State] = deque()

    def __enter__(self) -> Self:
        with lock:
            for leaf in self._expression.leaves:
                leaf.waiters.append(self)
            self.state_changed()
        return self

    def __exit__(self, *_: object) -> None:
        with lock:
            for leaf in self._expression.leaves:
                leaf.waiters.remove(self)

    def state_changed(self) -> None:
        """Append the state; called with the lock held."""
        self._states.append({leaf: leaf.held for leaf in self._expression.leaves})
        self._news.notify_all()  # each time: the waiting branch takes states without the lock, and may just have looked

    def states(self, timeout: float | None = None) -> Iterator[State]:
        """Yield the states, as they come.

        Args:
            timeout: In seconds from now, however fast states come; None for no limit.

        Raises:
            Cancelled: The branch is cancelled.
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


def first_value(expression: Expression, timeout: float | None = None) -> Value:
    """Wait until the value of an expression is not None, if only for a moment.

    Args:
        expression: The expression.
        timeout: In seconds; None for no limit.

    Returns:
        The value that it had then; None when the time is up.

    Raises:
        Cancelled: The branch is cancelled.
        WorldClosed: An object or world that it follows is gone.
        Exception: Of a function of the network.
    """
    with StateStream(expression) as stream:
        values = (expression.value(state) for state in stream.states(timeout))
        return next((value for value in values if value is not None), None)
