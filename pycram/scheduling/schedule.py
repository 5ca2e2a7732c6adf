"""The scheduler of a thread: which of its branches runs next, and what wakes those that wait.

A branch that yields switches to the scheduler's loop, a greenlet too, which starts or resumes the next one that is
ready. If none is, the thread sleeps until another thread rings its bell or the first deadline has passed. The code
outside of all branches takes turns with them; a thread without branches just sleeps.
"""

from __future__ import annotations

import _thread
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Final, TypeAlias

from greenlet import getcurrent, greenlet

from pycram.scheduling.locks import refuse_held
from recorder.tracing import interrupts
from recorder.tracing.branch_identity import enter_branch, new_branch
from recorder.tracing.call_stack import plan_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from contextvars import Context
    from types import FrameType
    from typing import Self

_OWN: Final = ("pycram.language", "pycram.scheduling")


class Waiter:
    """One wait, in a branch or outside of all; the sources wake it until its ``with`` block ends."""

    __slots__ = ("_greenlet", "_scheduler", "_sources", "_woken")

    def __init__(self, sources: Collection[Condition] = ()) -> None:
        self._greenlet = getcurrent()
        self._scheduler = scheduler()
        self._sources = sources
        self._woken = False

    def wake(self) -> None:
        """Schedule it to check its predicate again; from any thread."""
        if not self._woken:
            self._woken = True
            self._scheduler.add(self)

    def resume(self) -> None:
        """Switch to the waiting code; for the scheduler's loop."""
        self._greenlet.switch()

    def sleep(self, deadline: float | None = None) -> None:
        """Yield until woken, perhaps spuriously, or until the deadline, a time of time.monotonic()."""
        self._scheduler.park(self, deadline)
        self._woken = False

    def __enter__(self) -> Self:
        for source in self._sources:
            source.waiters[self] = None
        return self

    def __exit__(self, *_: object) -> None:
        for source in self._sources:
            source.waiters.pop(self, None)


class _Branch:
    """A branch that hasn't started, or hasn't ended."""

    __slots__ = ("_action", "_context", "_scheduler", "name")

    def __init__(self, owner: Scheduler, name: str, context: Context, action: Callable[[], None]) -> None:
        self.name = name
        self._scheduler = owner
        self._context = context
        self._action = action

    def resume(self) -> None:
        """Start it; for the scheduler's loop."""
        stack = greenlet(self._run)
        stack.gr_context = self._context
        stack.switch()

    def _run(self) -> None:
        try:
            enter_branch(new_branch(self.name))
            self._action()
        finally:
            del self._scheduler.branches[self]
            self._scheduler.leave()


Ready: TypeAlias = "Waiter | _Branch"


def schedule(ready: deque[Ready]) -> Ready:
    """Remove and return what runs next: what has been ready longest. Nothing else decides the order of a plan."""
    return ready.popleft()


class Condition:
    """Something that branches and threads wait for; see :func:`pycram.scheduling.cancellation.wait`.

    Attributes:
        waiters: Current waits, in order of arrival.
    """

    def __init__(self) -> None:
        self.waiters: dict[Waiter, None] = {}

    def notify_all(self) -> None:
        """Have all waits check their predicate again; after the change, from any thread."""
        for waiter in list(self.waiters):
            waiter.wake()


class Scheduler:
    """Lets the branches of one thread take turns.

    Attributes:
        branches: Those that haven't ended, in the order in which they were added.
        joining: Whether the code outside of all branches, interrupted by Ctrl-C, waits for their ends.
    """

    def __init__(self) -> None:
        self.branches: dict[_Branch, None] = {}
        self.joining = False
        self._ready: deque[Ready] = deque()
        self._deadlines: dict[Waiter, float] = {}
        self._bell = _thread.allocate_lock()
        self._bell.acquire()
        self._loop: greenlet | None = None
        self._outside: Waiter | None = None  # the code outside of all branches, while a branch runs

    def begin(self, name: str, context: Context, action: Callable[[], None]) -> None:
        """Schedule a new branch, run in this very context; from any thread. The action must not raise."""
        branch = _Branch(self, name, context, action)
        self.branches[branch] = None
        self.add(branch)

    def add(self, ready: Ready, *, first: bool = False) -> None:
        """Append to what is ready, or prepend; from any thread."""
        if first:
            self._ready.appendleft(ready)
        else:
            self._ready.append(ready)
        self.ring()

    def ring(self) -> None:
        """Wake the thread if it sleeps; from any thread, and from signal handlers."""
        if self._bell.locked():  # else it was rung already
            with suppress(RuntimeError):  # by another thread just now
                self._bell.release()

    def yield_turn(self) -> None:
        """Run the others that are ready first; outside of all branches, raise a deferred Ctrl-C."""
        refuse_held()
        if interrupts.is_pending() and self._is_outside() and not self.joining:
            interrupts.raise_pending()
        if self.branches and getcurrent() is not self._loop:
            self._wake_overdue()
            if self._ready:
                waiter = Waiter()
                waiter.wake()
                waiter.sleep()

    def park(self, waiter: Waiter, deadline: float | None) -> None:
        """Run others until the waiter is woken; see :meth:`Waiter.sleep`."""
        refuse_held()
        outside = self._is_outside()
        if deadline is not None:
            self._deadlines[waiter] = deadline
        try:
            if not self.branches:
                self._sleep_alone()
            elif outside:
                self._outside = waiter
                if self._loop is None:
                    self._loop = greenlet(self._run)
                self._loop.switch()
                self._outside = None
            elif self._loop is not None:
                self._loop.switch()
        finally:
            self._deadlines.pop(waiter, None)
        if outside and not self.joining:
            interrupts.raise_pending()

    def leave(self) -> None:
        """Have a branch that ends return to the current loop: an error may have ended the one that started it."""
        if self._loop is not None:
            getcurrent().parent = self._loop

    def _is_outside(self) -> bool:
        """Whether the running code is outside of all branches."""
        return self._loop is None or getcurrent() is self._loop.parent

    def _run(self) -> None:
        """Loop as long as there are branches."""
        try:
            while self.branches:
                self._wake_overdue()
                if self._ready:
                    schedule(self._ready).resume()
                else:
                    self._sleep()
        finally:
            self._loop = None

    def _sleep_alone(self) -> None:
        if not self._ready:
            self._sleep()
        while self._ready and isinstance(self._ready[0], Waiter):  # its wait checks the predicate anyway
            self._ready.popleft()

    def _sleep(self) -> None:
        """Block the thread until the bell rings or a deadline passes."""
        first = min(self._deadlines.values(), default=None)
        timeout = -1.0 if first is None else min(max(0.0, first - time.monotonic()), threading.TIMEOUT_MAX)
        self._bell.acquire(timeout=timeout)

    def _wake_overdue(self) -> None:
        if self._deadlines:
            now = time.monotonic()
            for waiter, deadline in list(self._deadlines.items()):
                if deadline <= now:
                    waiter.wake()

    def defers(self, frame: FrameType) -> bool:
        """Whether a Ctrl-C that arrives in this frame has to wait for the next checkpoint."""
        return not self._is_outside() or _in_own_code(frame)

    def interrupt(self) -> None:
        """Take note of a deferred Ctrl-C: the code outside of all branches runs next, and raises it."""
        if self.branches and (self.joining or interrupts.is_pending()) and sys.stderr is not None:
            names = ", ".join(branch.name for branch in list(self.branches))
            sys.stderr.write(f"waiting for {names} to get to the next action; Ctrl-\\ ends the process at once\n")
        if self._outside is not None:
            self.add(self._outside, first=True)
        self.ring()


def _in_own_code(frame: FrameType) -> bool:
    """Whether a frame of the plan language or the scheduler is on the stack above the innermost frame of the plan."""
    plan = plan_frame(frame)[0]
    current: FrameType | None = frame
    while current is not None and current is not plan:
        if str(current.f_globals.get("__name__", "")).startswith(_OWN):
            return True
        current = current.f_back
    return False


class _Local(threading.local):
    def __init__(self) -> None:
        self.scheduler = Scheduler()


_local = _Local()


def scheduler() -> Scheduler:
    """Return the scheduler of this thread."""
    return _local.scheduler
