"""Cancellation: a block that is decided tells its other branches to stop, and they stop where that is safe.

A cancel scope is a part of the plan that can be cancelled, or that has a deadline; scopes nest as the blocks of the
plan do. Nothing is interrupted: a cancelled branch stops by itself at its next checkpoint, where the world is
consistent, by a :class:`~recorder.tracing.span.Cancelled` that rises through it. Checkpoints are: before a motion, in a
wait, and before a change of a world, except within a motion, which is done as a whole.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from pycram.scheduling.binding import Binding
from pycram.scheduling.locks import held
from pycram.scheduling.schedule import Condition, Waiter, scheduler
from recorder.tracing.span import Cancelled

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = [
    "CancelScope",
    "Cancelled",
    "Condition",
    "before_change",
    "checkpoint",
    "current_scope",
    "enter",
    "entered",
    "join",
    "raise_if_cancelled",
    "shielded",
    "uninterruptible",
    "wait",
]


class CancelScope(Condition):
    """A part of the plan that can be told to stop, from any thread. Wakes those who wait in it.

    Attributes:
        around: the scopes around it, from the inside out. Not itself too: what refers to itself is freed late.
        cancel_called: whether this very scope has been told to stop.
        deadlines: what is left until their deadlines, of those that have one; see the constructor.
    """

    def __init__(self, parent: CancelScope | None = None, remaining: Callable[[], float] | None = None) -> None:
        """Makes a scope.

        Args:
            parent: the scope around it; when that is cancelled, this is too.
            remaining: how many seconds by the clock there are at least until its deadline, 0 when it has passed;
                None for no deadline.
        """
        super().__init__()
        self.around: tuple[CancelScope, ...] = (parent, *parent.around) if parent is not None else ()
        known = parent.deadlines if parent is not None else ()
        self.deadlines: tuple[Callable[[], float], ...] = known if remaining is None else (remaining, *known)
        self._remaining = remaining
        self.cancel_called = False

    @property
    def is_overdue(self) -> bool:
        """Whether the deadline of this very scope has passed."""
        return self._remaining is not None and self._remaining() <= 0

    @property
    def is_cancelled(self) -> bool:
        """Whether it, or a scope around it, has been told to stop or is overdue."""
        if self.cancel_called:
            return True
        for scope in self.around:
            if scope.cancel_called:
                return True
        return bool(self.deadlines) and any(remaining() <= 0 for remaining in self.deadlines)

    def deadline(self) -> float | None:
        """When a wait in it has to look again, as time.monotonic() tells it; None for never."""
        shortest = min((remaining() for remaining in self.deadlines), default=None)
        return None if shortest is None or shortest > threading.TIMEOUT_MAX else time.monotonic() + shortest

    def cancel(self) -> None:
        """Tells it to stop, and wakes whatever waits in it."""
        self.cancel_called = True
        self.notify_all()


_scope: ContextVar[CancelScope | None] = ContextVar("pycram_scope", default=None)


def current_scope() -> CancelScope | None:
    """The innermost scope of this context; None outside of all blocks."""
    return _scope.get()


def entered(scope: CancelScope | None) -> Binding[CancelScope | None]:
    """Runs its block in a scope; None for outside of all."""
    return Binding(_scope, scope)


def enter(scope: CancelScope) -> None:
    """From here on this context is in a scope."""
    _scope.set(scope)


def shielded() -> Binding[CancelScope | None]:
    """Runs its block so that no cancellation reaches it: for what must be done although the branch is told to stop."""
    return entered(None)


_uninterruptible: ContextVar[bool] = ContextVar("pycram_uninterruptible", default=False)


@contextmanager
def uninterruptible() -> Iterator[None]:
    """Runs its block so that changes of a world in it are no checkpoints: what is begun is done."""
    with Binding(_uninterruptible, value=True):
        yield


def before_change() -> None:
    """A checkpoint before a world is changed, unless that is part of an :func:`uninterruptible` block or of a lock's.

    Raises:
        Cancelled: the branch has been told to stop.
    """
    if not _uninterruptible.get() and not held.count:  # what is made of several changes is done as a whole
        checkpoint()


def checkpoint() -> None:
    """A place where other branches may go on first, and a cancelled one may stop.

    Raises:
        Cancelled: it has been told to.
        LockHeld: the caller holds a lock.
    """
    scheduler().give_way()
    raise_if_cancelled()


def raise_if_cancelled() -> None:
    """Stops a branch that is cancelled; doesn't let others go on.

    Raises:
        Cancelled: it has been told to stop.
    """
    scope = _scope.get()
    if scope is not None and scope.is_cancelled:
        raise Cancelled


def wait(condition: Condition, predicate: Callable[[], bool], timeout: float | None = None) -> bool:
    """Waits until something holds, or until the branch is told to stop. Other branches go on meanwhile.

    Args:
        condition: notified whenever the answer may have changed.
        predicate: asked in the branch that waits, without a lock.
        timeout: in seconds; None to wait for ever.

    Returns:
        Whether it holds; False only after the timeout.

    Raises:
        Cancelled: the branch has been told to stop, and it doesn't hold yet.
        LockHeld: the caller holds a lock.
    """
    if predicate():
        return True
    scope = _scope.get()
    end = None if timeout is None else time.monotonic() + timeout
    sources = (condition,) if scope is None else (condition, scope, *scope.around)
    with Waiter(sources) as waiter:
        while not predicate():
            raise_if_cancelled()
            times = [one for one in (end, scope.deadline() if scope is not None else None) if one is not None]
            waiter.sleep(min(times, default=None))
            if end is not None and end <= time.monotonic():
                return predicate()
    return True


def join(condition: Condition, predicate: Callable[[], bool]) -> None:
    """Waits until something holds, whoever is told to stop; see :func:`wait`."""
    with Waiter((condition,)) as waiter:
        while not predicate():
            waiter.sleep()
