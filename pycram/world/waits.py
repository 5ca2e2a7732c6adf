"""Waits in a world's simulated time: what their predicates say, 30 times a simulated second, whoever simulates."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.scheduling.schedule import Waiter


class Wait:
    """One wait.

    Args:
        predicate: What is waited for.

    Attributes:
        held: Whether it held at one of the moments at which it was called, or raised an error.
        waiter: The branch that waits; None before it does.
    """

    def __init__(self, predicate: Callable[[], bool]) -> None:
        self._predicate = predicate
        self._error: Exception | None = None
        self.held = False
        self.waiter: Waiter | None = None

    def sample(self) -> bool:
        """Call the predicate, and return whether the wait is over."""
        try:
            self.held = self.held or self._predicate()
        except Exception as error:  # noqa: BLE001  it is raised where somebody waits, not in the simulation
            self.held, self._error = True, error
        return self.held

    def raise_error(self) -> None:
        """Raise what the predicate has raised, if it has."""
        if self._error is not None:
            raise self._error


class Waits:
    """Those in one world, of all threads, in order of arrival."""

    def __init__(self) -> None:
        self._waits: dict[Wait, None] = {}

    def add(self, wait: Wait) -> None:
        """Sample it from now on."""
        self._waits[wait] = None

    def remove(self, wait: Wait) -> None:
        """Sample it no more."""
        self._waits.pop(wait, None)

    def sample(self) -> None:
        """Call all predicates once, and wake the branches whose waits are over; the world's lock is held."""
        for wait in list(self._waits):
            if not wait.held and wait.sample() and wait.waiter is not None:
                wait.waiter.wake()

    @property
    def held(self) -> bool:
        """Whether one of them is over."""
        return any(wait.held for wait in list(self._waits))

    def wake(self) -> None:
        """Have all look who simulates."""
        for wait in list(self._waits):
            if wait.waiter is not None:
                wait.waiter.wake()

    def forget(self) -> None:
        """Forget all, in a forked child that goes on without those branches."""
        self._waits.clear()
