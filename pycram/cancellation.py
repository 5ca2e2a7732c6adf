"""Cancellation: a block that is decided tells its other branches to stop, and they stop where that is safe.

A scope is a stretch of the plan that can be cancelled, or that has a deadline; scopes nest as the blocks of the plan
do. Nothing is interrupted: a cancelled branch stops by itself at its next checkpoint, where the world is consistent, by
a :class:`~recorder.tracing.span.Cancelled` that rises through it. Checkpoints are: before a motion, in a wait, and
before a change of a world, except within a motion, which is done as a whole.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from pycram.binding import Binding
from recorder.tracing.span import Cancelled

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = [
    "Cancelled",
    "Scope",
    "before_change",
    "checkpoint",
    "current_scope",
    "enter",
    "entered",
    "shielded",
    "wait",
    "whole",
]


class Scope:
    """A stretch of the plan that can be told to stop, from any thread.

    Attributes:
        around: the scopes around it, from the inside out. Not itself too: what refers to itself is freed late.
        told: whether this very scope has been told to stop.
        deadlines: what is left until their deadlines, of those that have one; see the constructor.
    """

    def __init__(self, parent: Scope | None = None, remaining: Callable[[], float] | None = None) -> None:
        """Makes a scope.

        Args:
            parent: the scope around it; when that is cancelled, this is too.
            remaining: how many seconds by the clock there are at least until its deadline, 0 when it has passed;
                None for no deadline.
        """
        self.around: tuple[Scope, ...] = (parent, *parent.around) if parent is not None else ()
        known = parent.deadlines if parent is not None else ()
        self.deadlines: tuple[Callable[[], float], ...] = known if remaining is None else (remaining, *known)
        self._remaining = remaining
        self._lock = threading.Lock()
        self.told = False
        self._waiting: list[threading.Condition] = []

    @property
    def overdue(self) -> bool:
        """Whether the deadline of this very scope has passed."""
        return self._remaining is not None and self._remaining() <= 0

    @property
    def cancelled(self) -> bool:
        """Whether it, or a scope around it, has been told to stop or is overdue."""
        if self.told:
            return True
        for scope in self.around:
            if scope.told:
                return True
        return bool(self.deadlines) and any(remaining() <= 0 for remaining in self.deadlines)

    def remaining(self) -> float | None:
        """Seconds by the clock for which a wait in it may sleep at most; None for as long as it likes."""
        shortest = min((remaining() for remaining in self.deadlines), default=None)
        return None if shortest is None or shortest > threading.TIMEOUT_MAX else shortest

    def cancel(self) -> None:
        """Tells it to stop, and wakes whatever waits in it."""
        self.told = True
        self.wake()

    def wake(self) -> None:
        """Lets whatever waits in it look again whether it is to stop."""
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


def entered(scope: Scope | None) -> Binding[Scope | None]:
    """Runs its block in a scope.

    Args:
        scope: the scope; None for outside of all.
    """
    return Binding(_scope, scope)


def enter(scope: Scope) -> None:
    """From here on this context is in a scope.

    Args:
        scope: the scope.
    """
    _scope.set(scope)


def shielded() -> Binding[Scope | None]:
    """Runs its block so that no cancellation reaches it: for what must be done although the branch is told to stop."""
    return entered(None)


_whole: ContextVar[bool] = ContextVar("pycram_whole", default=False)


@contextmanager
def whole() -> Iterator[None]:
    """Runs its block so that changes of a world in it are no checkpoints: what is begun is done."""
    token = _whole.set(True)
    try:
        yield
    finally:
        _whole.reset(token)


def before_change() -> None:
    """Called before a world is changed: a checkpoint, unless the change is part of a :func:`whole`.

    Raises:
        Cancelled: the branch has been told to stop.
    """
    if not _whole.get():
        checkpoint()


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
    scopes = (scope, *scope.around)
    for one in scopes:
        one.watch(condition)
    try:
        with condition:
            while not predicate():
                checkpoint()
                remaining = None if end is None else end - time.monotonic()
                if remaining is not None and remaining <= 0:
                    return False
                deadline = scope.remaining()
                times = [one for one in (remaining, deadline) if one is not None]
                condition.wait(min(times, default=None))
            return True
    finally:
        for one in scopes:
            one.unwatch(condition)
