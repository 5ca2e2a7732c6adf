"""Cancellation and waiting. A cancelled branch stops at its next checkpoint, where the world is consistent.

A cancel scope is a part of the plan that can be cancelled or has a deadline; scopes nest like the plan's blocks.
:class:`~recorder.tracing.span.Cancelled` is raised at the checkpoint.
"""

from __future__ import annotations

import math
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar, Token
from typing import Final, Generic, Protocol, Self, TypeVar

from pycram.foundation.forcing import forced
from pycram.scheduling.schedule import (
    Condition,
    Reason,
    RecordedStrikes,
    Waiter,
    is_held,
    schedule_alone,
    scheduler,
    unknown_reason,
)
from recorder.tracing.span import Cancelled

Value = TypeVar("Value")


class Binding(Generic[Value]):
    """Sets a context variable for a ``with`` block. This is a class, because a generator would be slower."""

    _token: Token[Value]

    def __init__(self, variable: ContextVar[Value], value: Value) -> None:
        self._variable = variable
        self._value = value

    def __enter__(self) -> None:
        self._token = self._variable.set(self._value)

    def __exit__(self, *_: object) -> None:
        self._variable.reset(self._token)


class CancelScope(Condition):
    """A part of the plan that any thread can cancel; a scope is also cancelled with its ``parent``, the outer scope."""

    def __init__(self, parent: CancelScope | None = None, deadline: Limit | None = None) -> None:
        super().__init__()
        #: The scopes around this scope, innermost first
        self.around: tuple[CancelScope, ...] = (parent, *parent.around) if parent is not None else ()
        if len(self.around) >= sys.getrecursionlimit():  # Python checks the stack's depth only within a single branch
            raise RecursionError(f"{len(self.around)} nested blocks and timeouts of the plan")
        known = parent.deadlines if parent is not None else ()
        #: The deadlines of this scope and of the scopes around it, innermost first.
        self.deadlines: tuple[Limit, ...] = known if deadline is None else (deadline, *known)
        self.deadline = deadline
        self.cancel_called = False  # whether cancel() was called
        self.struck = 0  # number of the checkpoint at which the thread noticed that the deadline had passed; or 0

    @property
    def sources(self) -> tuple[Condition, ...]:
        """The conditions that can wake the waits in this scope."""
        return (self, *self.around, *self.deadlines)

    @property
    def is_cancelled(self) -> bool:
        """Whether this scope or a scope around it was cancelled or has missed its deadline."""
        return any(each.cancel_called for each in (self, *self.around)) or any(each.has_come for each in self.deadlines)

    def cancel(self) -> None:
        """Cancel the scope, and wake its waits."""
        self.cancel_called = True
        self.notify_all()


_scope: ContextVar[CancelScope | None] = ContextVar("pycram_scope", default=None)


def current_scope() -> CancelScope | None:
    """Return the innermost scope of this context; None outside of all blocks."""
    return _scope.get()


def entered(scope: CancelScope | None) -> Binding[CancelScope | None]:
    """Run the ``with`` block in a scope, or outside of all scopes for None."""
    return Binding(_scope, scope)


def enter(scope: CancelScope) -> None:
    """Move this context into a scope permanently."""
    _scope.set(scope)


def shielded() -> Binding[CancelScope | None]:
    """Shield the ``with`` block from cancellation, so that a cancelled branch can finish necessary work there."""
    return entered(None)


_uninterruptible: ContextVar[bool] = ContextVar("pycram_uninterruptible", default=False)


@contextmanager
def uninterruptible() -> Iterator[None]:
    """Run the ``with`` block, or the decorated function, without checkpoints at changes of a world."""
    with Binding(_uninterruptible, value=True):
        yield


def begin_alone() -> None:
    """Leave all scopes and branches in a forked child process, which continues only this context."""
    _scope.set(None)
    _uninterruptible.set(False)
    body.set(None)
    schedule_alone()


class BlockBody(Protocol):
    """The body of a block of the plan, which checks changes of worlds."""

    def before_change(self, change: str) -> None:
        """Raise RunsEarly if plain Python in the body changes a world before earlier actions have ended."""

    def await_turn(self) -> None:
        """Wait until plain Python in the body may change worlds."""


#: The block around this code; None outside of all blocks, in branches, and in blocks whose actions run in order.
body: Final[ContextVar[BlockBody | None]] = ContextVar("pycram_block", default=None)


def before_change(change: str) -> None:
    """Make a checkpoint before a change of a world, except in :func:`uninterruptible` code or while a lock is held.

    Raise RunsEarly, with ``change``, if earlier actions haven't run, or Cancelled in a cancelled branch.
    """
    around = body.get()
    if around is not None:
        around.before_change(change)
    if not _uninterruptible.get() and not is_held():  # changes that are made under one lock may belong together
        checkpoint()


def checkpoint() -> None:
    """Let other branches run first. Raise Cancelled in a cancelled branch, or LockHeld if the thread holds a lock."""
    scheduler().yield_turn()
    raise_if_cancelled()


def raise_if_cancelled() -> None:
    """Raise the branch's deferred error, or Cancelled if the branch is cancelled; run no other branches."""
    thread = scheduler()
    thread.checkpoints += 1
    if thread.failing and (error := thread.take_failure()) is not None:
        raise error
    scope = _scope.get()
    if scope is not None and scope.is_cancelled:
        for each in (scope, *scope.around):
            if not each.struck and each.deadline is not None and each.deadline.has_come:
                each.struck = thread.checkpoints
        raise Cancelled


def wait(
    condition: Condition, predicate: Callable[[], bool], timeout: float | None = None, reason: Reason = unknown_reason
) -> bool:
    """Wait until a predicate holds, while other branches run. Return False if the timeout came first, otherwise True.

    Args:
        condition: Notified whenever the predicate may have changed.
        predicate: Called in the waiting branch, without a lock.
        timeout: In seconds; None for no limit.

    Raises:
        Cancelled: The branch is cancelled, and the predicate doesn't hold.
        DeadlockedBranches: Nothing can wake any branch.
        LockHeld: The caller holds a lock.
    """
    if predicate():
        return True
    if timeout is None:
        return wait_until(condition, predicate, reason=reason)
    with Deadline(timeout) as limit:
        return wait_until(condition, predicate, limit, reason=reason)


def wait_until(
    condition: Condition,
    predicate: Callable[[], bool],
    limit: Deadline | None = None,
    *,
    clock: Clock | None = None,
    reason: Reason = unknown_reason,
) -> bool:
    """Wait until a predicate holds or an entered deadline has passed; see :func:`wait`.

    While no branch is ready, a simulated clock runs: ``clock``, or the clock of a deadline around the wait.
    """
    scope = _scope.get()
    sources = (condition, *(() if scope is None else scope.sources), *(() if limit is None else (limit,)))
    if clock is None and scope is not None and scope.deadlines:
        clock = next((each.clock for each in scope.deadlines if each.clock is not None), None)
    with Waiter(sources, None if clock is None else clock.may_pass, last=True, reason=reason) as waiter:
        while not predicate():
            raise_if_cancelled()
            if limit is not None and limit.struck:  # other branches still run first
                waiter.wake()
            if waiter.sleep() and clock is not None:
                clock.let_pass()
            if limit is not None and limit.has_come:
                return predicate()
    return True


def join(condition: Condition, predicate: Callable[[], bool], reason: Reason = unknown_reason) -> None:
    """Wait until a predicate holds, even if the branch is cancelled; see :func:`wait`."""
    with Waiter((condition,), reason=reason) as waiter:
        while not predicate():
            waiter.sleep()


class Clock(Protocol):
    """A simulated clock; a wait lets the clock run when no branch of the wait's thread is ready."""

    def may_pass(self) -> bool:
        """Return whether simulated time may pass now."""

    def let_pass(self) -> None:
        """Let simulated time pass until a branch is ready."""


class Limit(Condition, ABC):
    """A deadline of a part of the plan. When the deadline comes, waits are notified."""

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
    """A deadline or a worker that the scheduler polls during a ``with`` block."""

    def __init__(self, end: float = math.inf) -> None:
        super().__init__()
        self.struck = False  # whether the scheduler has polled the source after the strike
        self.end = end  # value of ``time.monotonic()`` at which the strike comes; infinity if unknown
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

    If the thread sleeps at a poll without a recorded strike, strikes come as in an unguided run. ``polls`` is the
    number of polls before this moment in the recorded run.
    """
    thread = scheduler()
    difference = polls - thread.polls
    thread.recorded_strikes = lambda poll: recorded(poll + difference)
