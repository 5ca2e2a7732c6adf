"""The scheduler of a thread: which of its branches goes on next, and what wakes those that wait.

A branch that gives way switches to the scheduler's loop, a greenlet too, which begins or resumes the next one that is
ready. Where none is, the thread sleeps until another thread rings its bell or the first deadline has passed. The code
outside of all branches is one of those that take turns; a thread without branches just sleeps.
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
from recorder.threads import enter_branch, new_branch
from recorder.tracing import interrupts
from recorder.tracing.call_site import plan_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from contextvars import Context
    from types import FrameType
    from typing import Self

_OWN: Final = ("pycram.language", "pycram.scheduling")


class Waiter:
    """Somebody who waits, in a branch or outside of all, and can be told to look again."""

    __slots__ = ("_greenlet", "_scheduler", "_sources", "_woken")

    def __init__(self, sources: Collection[Condition] = ()) -> None:
        """Makes one for the code that runs here; the sources wake it until its ``with`` block ends."""
        self._greenlet = getcurrent()
        self._scheduler = scheduler()
        self._sources = sources
        self._woken = False

    def wake(self) -> None:
        """Has it look again when its turn comes; from any thread."""
        if not self._woken:
            self._woken = True
            self._scheduler.add(self)

    def resume(self) -> None:
        """Goes on with it; for the scheduler."""
        self._greenlet.switch()

    def sleep(self, deadline: float | None = None) -> None:
        """Gives way until it is woken, perhaps for nothing; at the latest at a time of time.monotonic()."""
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
    """A branch that hasn't begun, or not ended.

    Attributes:
        name: what records call it.
    """

    __slots__ = ("_action", "_context", "_scheduler", "name")

    def __init__(self, owner: Scheduler, name: str, context: Context, action: Callable[[], None]) -> None:
        self.name = name
        self._scheduler = owner
        self._context = context
        self._action = action

    def resume(self) -> None:
        """Begins it; for the scheduler's loop."""
        made = greenlet(self._run)
        made.gr_context = self._context
        made.switch()

    def _run(self) -> None:
        try:
            enter_branch(new_branch(self.name))
            self._action()
        finally:
            del self._scheduler.branches[self]
            self._scheduler.leave()


Ready: TypeAlias = "Waiter | _Branch"


def schedule(ready: deque[Ready]) -> Ready:
    """Takes the one that goes on next out of those that could: the one that has been ready for longest.

    The order of a plan is decided here and nowhere else.
    """
    return ready.popleft()


class Condition:
    """Something that branches and threads wait for; see :func:`pycram.scheduling.cancellation.wait`.

    Attributes:
        waiters: those who wait, in the order in which they came.
    """

    def __init__(self) -> None:
        """Nobody waits yet."""
        self.waiters: dict[Waiter, None] = {}

    def notify_all(self) -> None:
        """Has all who wait look again; after the change, from any thread."""
        for waiter in list(self.waiters):
            waiter.wake()


class Scheduler:
    """What takes turns in one thread.

    Attributes:
        branches: those that haven't ended, in the order in which they were begun.
        joining: whether Ctrl-C has been pressed, and the code outside of all branches waits for these to end.
    """

    def __init__(self) -> None:
        """Nothing takes turns yet."""
        self.branches: dict[_Branch, None] = {}
        self.joining = False
        self._ready: deque[Ready] = deque()
        self._deadlines: dict[Waiter, float] = {}
        self._bell = _thread.allocate_lock()
        self._bell.acquire()
        self._loop: greenlet | None = None
        self._outside: Waiter | None = None  # the code outside of all branches, while a branch runs

    def begin(self, name: str, context: Context, action: Callable[[], None]) -> None:
        """Begins a branch when its turn comes, in this very context; from any thread. The action must not raise."""
        branch = _Branch(self, name, context, action)
        self.branches[branch] = None
        self.add(branch)

    def add(self, ready: Ready, *, first: bool = False) -> None:
        """Lets somebody go on when its turn comes; from any thread."""
        if first:
            self._ready.appendleft(ready)
        else:
            self._ready.append(ready)
        self.ring()

    def ring(self) -> None:
        """Wakes the thread if it sleeps; from any thread, and from handlers of signals."""
        if self._bell.locked():  # else it was rung already
            with suppress(RuntimeError):  # by another thread just now
                self._bell.release()

    def give_way(self) -> None:
        """Lets the others that are ready go on first; outside of all branches raises Ctrl-C that was held back."""
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
        """Lets others go on until somebody is woken; see :meth:`Waiter.sleep`."""
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
        """Has a branch that ends go back to the loop: it may have begun in one that an error has ended meanwhile."""
        if self._loop is not None:
            getcurrent().parent = self._loop

    def _is_outside(self) -> bool:
        """Whether the code that runs is outside of all branches."""
        return self._loop is None or getcurrent() is self._loop.parent

    def _run(self) -> None:
        """The loop, as long as there are branches."""
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
        while self._ready and isinstance(self._ready[0], Waiter):  # it looks again by itself
            self._ready.popleft()

    def _sleep(self) -> None:
        """Has the thread sleep until the bell rings or a deadline passes."""
        first = min(self._deadlines.values(), default=None)
        left = -1.0 if first is None else min(max(0.0, first - time.monotonic()), threading.TIMEOUT_MAX)
        self._bell.acquire(timeout=left)

    def _wake_overdue(self) -> None:
        if self._deadlines:
            now = time.monotonic()
            for waiter, deadline in list(self._deadlines.items()):
                if deadline <= now:
                    waiter.wake()

    def defers(self, frame: FrameType) -> bool:
        """Whether Ctrl-C has to wait for the next checkpoint, where it has met this code."""
        return not self._is_outside() or _in_own_code(frame)

    def interrupt(self) -> None:
        """Ctrl-C has been held back: has the code outside of all branches go on next, which raises it."""
        if self.branches and (self.joining or interrupts.is_pending()) and sys.stderr is not None:
            names = ", ".join(branch.name for branch in self.branches)
            sys.stderr.write(f"waiting for {names} to get to the next action; Ctrl-\\ ends the process at once\n")
        if self._outside is not None:
            self.add(self._outside, first=True)
        self.ring()


def _in_own_code(frame: FrameType) -> bool:
    """Whether the plan has called the language, and that hasn't called the plan since."""
    plan = plan_frame(frame)[0]
    return any(str(one.f_globals.get("__name__", "")).startswith(_OWN) for one in _outwards(frame, plan))


def _outwards(frame: FrameType | None, end: FrameType | None) -> Iterator[FrameType]:
    while frame is not None and frame is not end:
        yield frame
        frame = frame.f_back


class _Local(threading.local):
    """The scheduler of this thread."""

    def __init__(self) -> None:
        self.scheduler = Scheduler()


_local = _Local()


def scheduler() -> Scheduler:
    """The scheduler of this thread."""
    return _local.scheduler
