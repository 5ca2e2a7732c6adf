"""Waiting: a stream of all states of an expression, in order.

A change of a leaf only appends the new state; values are computed by the waiting thread, without a lock. So a slow or
failing function of a network harms no other thread, and no state is missed, however short it lasts.
"""

from __future__ import annotations

from collections import deque
from contextlib import nullcontext
from typing import TYPE_CHECKING

from pycram.fluents.expressions import lock
from pycram.scheduling.cancellation import checkpoint, wait_until
from pycram.scheduling.schedule import Condition
from pycram.scheduling.strikes import Deadline

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

    def states(self, limit: Deadline | None = None) -> Iterator[State]:
        """Yield the states, as they come.

        Args:
            limit: When it ends, however fast states come; None for never.

        Raises:
            Cancelled: The branch is cancelled.
        """
        while True:
            late = limit is not None and limit.has_come
            for _ in range(len(self._states)):
                checkpoint()
                yield self._states.popleft()
            if late:
                return
            wait_until(self._news, lambda: bool(self._states), limit)


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
    with StateStream(expression) as stream, nullcontext() if timeout is None else Deadline(timeout) as limit:
        values = (expression.value(state) for state in stream.states(limit))
        return next((value for value in values if value is not None), None)
