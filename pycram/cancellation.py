"""Cancellation: a block that is decided tells its other branches to stop, and they stop where that is safe.

A scope is a stretch of the plan that can be cancelled; scopes nest as the blocks of the plan do. Nothing is
interrupted: a cancelled branch stops by itself at its next checkpoint (before an action, or in a wait), where the world
is consistent, by a :class:`~recorder.span.Cancelled` that rises through it.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from recorder.span import Cancelled

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

__all__ = ["Cancelled", "Scope", "checkpoint", "current_scope", "entered", "shielded", "wait"]


class Scope:
    """A stretch of the plan that can be told to stop, from any thread.

    Attributes:
        lineage: this scope, the one around it, and so on outwards.
    """

    def __init__(self, parent: Scope | None = None) -> None:
        """Makes a scope.

        Args:
            parent: the scope around it; when that is cancelled, this is too.
        """
        self.lineage: tuple[Scope, ...] = (self, *(parent.lineage if parent is not None else ()))
        self._lock = threading.Lock()
        self._told = threading.Event()
        self._waiting: list[threading.Condition] = []

    @property
    def told(self) -> bool:
        """Whether this very scope has been told to stop."""
        return self._told.is_set()

    @property
    def cancelled(self) -> bool:
        """Whether it, or a scope around it, has been told to stop."""
        return any(scope.told for scope in self.lineage)

    def cancel(self) -> None:
        """Tells it to stop, and wakes whatever waits in it."""
        self._told.set()
        with self._lock:
            waiting = list(self._waiting)
        for condition in waiting:
            with condition:
                condition.notify_all()

    def watch(self, condition: threading.Condition) -> None:
        """From now on, wakes those who wait for a condition when this is cancelled.

        Args:
            condition: its lock must not be held.
        """
        with self._lock:
            self._waiting.append(condition)

    def unwatch(self, condition: threading.Condition) -> None:
        """Ends what :meth:`watch` began.

        Args:
            condition: the same condition; its lock must not be held.
        """
        with self._lock:
            self._waiting.remove(condition)


_scope: ContextVar[Scope | None] = ContextVar("pycram_scope", default=None)


def current_scope() -> Scope | None:
    """The innermost scope of this context; None outside of all blocks."""
    return _scope.get()


@contextmanager
def entered(scope: Scope | None) -> Iterator[None]:
    """Runs its block in a scope.

    Args:
        scope: the scope; None for outside of all.
    """
    token = _scope.set(scope)
    try:
        yield
    finally:
        _scope.reset(token)


def shielded() -> AbstractContextManager[None]:
    """Runs its block so that no cancellation reaches it: for what must be done although the branch is told to stop."""
    return entered(None)


def checkpoint() -> None:
    """A place where a cancelled branch may stop.

    Raises:
        Cancelled: it has been told to.
    """
    scope = _scope.get()
    if scope is not None and scope.cancelled:
        raise Cancelled


def wait(condition: threading.Condition, predicate: Callable[[], bool], timeout: float | None = None) -> bool:
    """Waits until something holds, or until the branch is told to stop.

    Args:
        condition: notified whenever the answer may have changed; this takes its lock.
        predicate: asked with the lock held.
        timeout: in seconds; None to wait for ever.

    Returns:
        Whether it holds; False only after the timeout.

    Raises:
        Cancelled: the branch has been told to stop, and it doesn't hold yet.
    """
    scope = _scope.get()
    if scope is None:
        with condition:
            return condition.wait_for(predicate, timeout)
    end = None if timeout is None else time.monotonic() + timeout
    for one in scope.lineage:
        one.watch(condition)
    try:
        with condition:
            while not predicate():
                checkpoint()
                remaining = None if end is None else end - time.monotonic()
                if remaining is not None and remaining <= 0:
                    return False
                condition.wait(remaining)
            return True
    finally:
        for one in scope.lineage:
            one.unwatch(condition)
