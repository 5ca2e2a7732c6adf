"""Pulses: something happened to a fluent, whether or not that changed its value.

A pulse of an expression pulses all expressions that have it as an operand. A counter counts pulses until they are
handled; each change counts once, however many paths lead from what changed to the counter.
"""

from __future__ import annotations

import weakref
from enum import Enum
from typing import TYPE_CHECKING, cast

from pycram.fluents.expressions import Ended, Leaf, lock, notify

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from pycram.fluents.expressions import Expression, State, Value


class Behavior(Enum):
    """What happens to pulses that come while the body of a ``whenever`` handles an earlier one."""

    NEVER = 1
    """They are ignored."""
    ONCE = 2
    """The body runs once more for all of them."""
    ALWAYS = 3
    """The body runs once more for each of them."""


class PulseCounter(Leaf):
    """Counts the pulses of an expression that aren't handled yet; its value is True while there are any, else None.

    Attributes:
        missed: What happens to pulses that come while an earlier one is handled.
    """

    __slots__ = ("missed",)

    def __init__(self, of: Expression, missed: Behavior) -> None:
        super().__init__((of,), 0)
        self.missed = missed
        with lock:
            for expression in _reachable(
                (of,), lambda below: () if isinstance(below, PulseCounter) else below.operands
            ):
                if expression.counters is None:
                    expression.counters = weakref.WeakValueDictionary()
                expression.counters[id(self)] = self

    def value(self, state: State) -> Value:
        """Return True if there are pulses to handle, else None."""
        return True if super().value(state) else None

    def text(self, depth: int = 0) -> str:
        """Return the name of its expression with ``.pulsed(...)``."""
        return f"{self.operands[0].text(depth + 1)}.pulsed({self.missed.name})"

    def take(self) -> None:
        """Begin to handle a pulse, if there is one."""
        self._change(lambda count: max(count - 1, 0))

    def settle(self) -> None:
        """End what :meth:`take` began: drop pulses that came meanwhile, as the behavior says."""
        if self.missed is not Behavior.ALWAYS:
            kept = 1 if self.missed is Behavior.ONCE else 0
            self._change(lambda count: min(count, kept))

    def _change(self, pulses: Callable[[int], int]) -> None:
        with lock:
            if not isinstance(self.held, Ended):
                self.held = pulses(self.held)
                notify((self,))


def _reachable(given: Iterable[Expression], next_to: Callable[[Expression], Iterable[Expression]]) -> list[Expression]:
    """Return the given expressions, which are different ones, and all that are next to them, or to those, each once."""
    queue = list(given)
    reached = set(queue)
    for expression in queue:
        for each in next_to(expression):
            if each not in reached:
                reached.add(each)
                queue.append(each)
    return queue


def _counters(expression: Expression) -> Collection[PulseCounter]:
    counters = expression.counters
    if counters is None:
        return ()
    return [counter for reference in counters.valuerefs() if (counter := reference()) is not None]


def counters_on(pulsed: Collection[Expression]) -> list[PulseCounter]:
    """Return the counters of pulses of these expressions, and those of pulses of these counters, each once."""
    return cast("list[PulseCounter]", _reachable(pulsed, _counters)[len(pulsed) :])


def pulse(pulsed: Collection[Expression]) -> None:
    """Count one pulse in every counter of these expressions, and notify waiters; the lock is held."""
    counters = [counter for counter in counters_on(pulsed) if not isinstance(counter.held, Ended)]
    for counter in counters:
        counter.held += 1
    notify((*pulsed, *counters))
