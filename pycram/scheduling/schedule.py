"""The scheduler of a thread: it chooses the branch that runs next, and wakes branches that wait.

A branch that yields switches to the scheduler's loop, a greenlet, which starts or resumes the next ready branch. A
signal handler may raise an error between any two instructions, and any call may exceed the recursion limit. In both
cases, the loop ends, the error is raised outside of all branches, and the next loop schedules all branches again.
"""

from __future__ import annotations

import _thread
import math
import random
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from contextvars import Context
from copy import copy
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Final, Self, TypeAlias

from greenlet import getcurrent, greenlet

from pycram.foundation.errors import UsageError
from pycram.foundation.forcing import decider, forced
from pycram.foundation.refusals import refused
from pycram.scheduling.order import BlockedWait, BranchLine, DeadlockedBranches, Order, Ranked, order_of
from recorder import notebook
from recorder.plan_lines import deciding
from recorder.tracing import context, forking, interrupts, journal
from recorder.tracing.call_stack import CallSite, plan_frame, plan_frames, recorded_file
from recorder.tracing.context import enter_branch, new_branch

if TYPE_CHECKING:
    from pycram.scheduling.cancellation import StrikeSource

_BEFORE: Final = frozenset(sys._current_frames())  # noqa: SLF001  ids of threads that existed before the plan
#: Limit in s of a sleep; Python doesn't wake a thread for a signal that arrives just before the thread sleeps.
MISSED_SIGNALS_EVERY: Final = 0.1
_OWN: Final = ("pycram.language", "pycram.scheduling")

#: Returns three values that describe a wait in a deadlock: the awaited event as text; the words between this text and
#: the names ("" if the text contains the names); and the names of the branches on which the wait depends.
Reason: TypeAlias = "Callable[[], tuple[str, str, Collection[str]]]"


def unknown_reason() -> tuple[str, str, Collection[str]]:
    """Return an empty reason, for waits that have none."""
    return "", "", ()


class Waiter:
    """A wait of a branch, or of code outside of all branches. During the ``with`` block, ``sources`` wake the wait.

    With ``patience``, the wait is patient: if no branch is ready and ``patience()`` is true, the wait also resumes.
    Waits with ``last`` resume after all other patient waits.
    """

    def __init__(
        self,
        sources: Collection[Condition] = (),
        patience: Callable[[], bool] | None = None,
        *,
        last: bool = False,
        reason: Reason = unknown_reason,
    ) -> None:
        self._greenlet = getcurrent()
        self._scheduler = scheduler()
        self._sources = sources
        self.branch = self._scheduler.running  # None for code outside of all branches
        self.patience, self.last = patience, last
        self.reason = reason
        self.parked = False  # whether the waiting code sleeps
        self.undisturbed = False  # whether the wait resumed because no branch was ready

    def wake(self) -> None:
        """Make the wait check its predicate again; any thread may call this."""
        self._scheduler.add(self)

    def resume(self) -> None:
        """Switch to the waiting code; only the scheduler's loop calls this."""
        self._greenlet.switch()

    @property
    def ended(self) -> bool:
        """Whether the waiting code has ended."""
        return self._greenlet.dead

    def fail(self, error: BaseException) -> None:
        """Switch to the waiting code, and raise an error there."""
        self._greenlet.throw(error)

    def plan_line(self) -> BranchLine:
        """Return the line of the plan that waits."""
        return _plan_line(self.branch, self._greenlet)

    def sleep(self) -> bool:
        """Yield until something wakes the wait. Return whether a patient wait resumes because no branch is ready."""
        self._scheduler.park(self)
        return self.undisturbed

    def __enter__(self) -> Self:
        for source in self._sources:
            source.waiters[self] = None
        if self.patience is not None:
            self._scheduler.patient[self] = None
        return self

    def __exit__(self, *_: object) -> None:
        for source in self._sources:
            source.waiters.pop(self, None)
        self._scheduler.patient.pop(self, None)
        if self._scheduler.order is not None or (self.patience is not None and not self.last):
            self._scheduler.forget(self)


@dataclass(slots=True, eq=False)
class _Branch:
    """A branch that hasn't ended."""

    scheduler: Scheduler
    name: str
    context: Context
    action: Callable[[], None]
    failed: Callable[[BaseException], None]
    site: CallSite
    label: Callable[[], str]
    ranked: Ranked | None = None
    _greenlet: greenlet | None = None
    _started: bool = False

    @property
    def branch(self) -> _Branch:
        """The branch itself; waits have a property with the same name."""
        return self

    def plan_line(self) -> BranchLine:
        """Return the plan's line at which the branch waits; before its start, the line that added the branch."""
        return _plan_line(self, self._greenlet)

    @property
    def ended(self) -> bool:
        return self._started and self._greenlet is not None and self._greenlet.dead

    def resume(self) -> None:
        """Start or resume the branch; only the scheduler's loop calls this."""
        if not self._started or self._greenlet is None:
            self._greenlet = greenlet(self._run)
            self._greenlet.gr_context = self.context
        self._greenlet.switch()

    def _run(self) -> None:
        try:
            self._started = True
            enter_branch(new_branch(self.name))
            self.action()
        except BaseException as error:  # any error, also of a signal handler, ends the scheduler's loop
            self.failed(error)
            raise
        finally:
            self.scheduler.leave(self)


Ready: TypeAlias = "Waiter | _Branch"


def _plan_line(branch: _Branch | None, suspended: greenlet | None) -> BranchLine:
    innermost = None
    if suspended is not None:
        innermost = sys._getframe() if suspended is getcurrent() else suspended.gr_frame  # noqa: SLF001  as in ``inspect``
    lines = [(recorded_file(frame.f_code.co_filename), frame.f_lineno) for frame in plan_frames(innermost)]
    if branch is not None:  # prefer a line of the file that added the branch to a line of a helper function
        own = [line for line in lines if line[0] == branch.site[0]] or [branch.site]
        return BranchLine(branch.name, *own[deciding(own)], branch.label())
    own = [line for line in lines if line[0] == lines[-1][0]]
    return BranchLine(threading.current_thread().name, *(own[deciding(own)] if own else ("", 0)))


def schedule(ready: OrderedDict[Ready, None], dice: random.Random | None, order: Order | None = None) -> Ready:
    """Remove and return the branch or wait that runs next. Only this function decides the order of a plan's branches.

    An ``order`` chooses, or ``dice`` draw. Without both, the branch that has been ready longest runs next.
    """
    if order is not None:
        candidates: dict[Ranked, Ready] = {}
        for each in ready:
            branch = each.branch
            candidates.setdefault(order.outside if branch is None or branch.ranked is None else branch.ranked, each)
        chosen = candidates[order.choose(candidates)] if len(candidates) > 1 else next(iter(ready))
        del ready[chosen]
        return chosen
    if len(ready) > 1 and decider() is not None:
        named = {"" if each.branch is None else each.branch.name: each for each in reversed(ready)}
        if first := forced("order order", {"ready": list(named)}):
            del ready[named[first]]
            return named[first]
    if dice is None or len(ready) == 1:
        return ready.popitem(last=False)[0]
    drawn = next(islice(ready, int(dice.random() * len(ready)), None))
    del ready[drawn]
    return drawn


_seed: int | None = None
_order = ""


def seed_order(seed: int | None, order: str = "") -> None:
    """Draw the order of branches from a seed, or use an order, in this thread and in threads that start later.

    Without both, the branch that has been ready longest runs next. A text that is no order raises BadArgument.
    """
    global _seed, _order  # a process runs one plan
    order_of(order, seed)
    _seed, _order = seed, order
    scheduler().draw_from(seed, order)


def run_seed() -> int | None:
    """Return the run's seed; None if none was set."""
    return _seed


class Condition:
    """A condition that branches and threads wait for; see :func:`pycram.scheduling.cancellation.wait`."""

    def __init__(self) -> None:
        self.waiters: dict[Waiter, None] = {}  # present waits; the wait that began first is first

    def notify_all(self) -> None:
        """Wake all waits after a change, so that they check their predicates again; any thread may call this."""
        for waiter in list(self.waiters):
            waiter.wake()


#: Returns the recorded strikes of a poll, given the poll's number; None after the end of the recording.
RecordedStrikes: TypeAlias = "Callable[[int], Collection[int] | None]"


class Scheduler:
    """Makes the branches of one thread take turns."""

    order: Order | None  # the requested order; None for the default order

    def __init__(self) -> None:
        self.branches: dict[_Branch, None] = {}  # branches that haven't ended; the first was added first
        self.joining = False  # whether the code outside of all branches waits for the branches to end after Ctrl-C
        self.checkpoints = 0  # number of checkpoints that this thread has passed
        self.running: _Branch | None = None  # None while the code outside of all branches runs
        self.failing: dict[_Branch | None, BaseException] = {}  # errors that branches raise at their next checkpoints
        self._ready: OrderedDict[Ready, None] = OrderedDict()
        self.draw_from(_seed, _order)
        self._parked: dict[Waiter, None] = {}  # waits that sleep
        self._deadlocked = False  # whether the present deadlock was already raised outside of the branches
        self.patient: dict[Waiter, None] = {}  # patient waits; the wait that began first is first
        self._first: Waiter | None = None  # a wait that resumes before everything that is ready
        self.strike_sources: dict[StrikeSource, None] = {}  # sources of strikes, in the order of polling
        self.polls = 0  # number of polls so far
        self.recorded_strikes: RecordedStrikes | None = None  # None if no recording guides this thread
        self._bell = _thread.allocate_lock()
        self._bell.acquire()
        self._loop: greenlet | None = None
        self._outside: Waiter | None = None  # the wait of the code outside of all branches, while a branch runs

    def draw_from(self, seed: int | None, order: str = "") -> None:
        """Set the order of branches; see :func:`seed_order`."""
        self._dice = None if seed is None else random.Random(f"order {seed}")  # not the plan's random numbers
        self.order = order_of(order, seed)
        for ready in list(self._ready):
            if isinstance(ready, Waiter) and not ready.parked:  # this wait has already been woken
                self.forget(ready)

    def continue_order(self, other: Scheduler) -> None:
        """Continue the order of another scheduler, which must not be used any more."""
        self.checkpoints = other.checkpoints
        self._dice = copy(other._dice)
        self.order = other.order
        if self.order is not None and other.running is not None and other.running.ranked is not None:
            self.order.outside = other.running.ranked

    def begin(
        self,
        name: str,
        context: Context,
        action: Callable[[], None],
        failed: Callable[[BaseException], None],
        site: CallSite = ("", 0),
        label: Callable[[], str] = str,
    ) -> None:
        """Schedule a new branch; any thread may call this. After an error, the branch isn't scheduled.

        Args:
            context: Context in which the branch runs; it isn't copied.
            action: Runs the branch. ``action`` handles the branch's errors; an error that ``action`` raises ends the
                scheduler's loop.
            failed: Called with an error that ``action`` raises, before the loop ends.
            label: Returns the branch's name with its arguments, for messages; "" to show ``name`` there.
        """
        branch = _Branch(self, name, context, action, failed, site, label)
        if self.order is not None:
            branch.ranked = self.order.begin(self._ranked(self.order))
        try:
            self.branches[branch] = None
            self.add(branch)
        except BaseException:  # a signal handler may raise any error here
            self.branches.pop(branch, None)
            self._ready.pop(branch, None)
            raise

    def add(self, ready: Ready) -> None:
        """Make a branch or a wait ready; any thread may call this."""
        self._ready[ready] = None
        self.ring()

    def forget(self, ended: Waiter) -> None:
        """Remove an ended wait from the ready waits."""
        self._ready.pop(ended, None)

    def ring(self) -> None:
        """Wake the thread if it sleeps; any thread and any signal handler may call this."""
        if self._bell.locked():  # otherwise the thread is awake
            with suppress(RuntimeError):  # another thread has released the bell at the same time
                self._bell.release()

    def fail_later(self, error: BaseException) -> None:
        """Raise an error at the running branch's next checkpoint or end; an earlier error takes precedence."""
        self.failing.setdefault(self.running, error)

    def take_failure(self) -> BaseException | None:
        """Return and forget the error that the running branch must raise."""
        return self.failing.pop(self.running, None)

    def yield_turn(self) -> None:
        """Run the other ready branches first; outside of all branches, raise a deferred Ctrl-C."""
        refuse_held()
        if interrupts.is_pending() and self._is_outside() and not self.joining:
            interrupts.raise_pending()
        if self.branches and getcurrent() is not self._loop:
            self.poll()
            if self._ready:
                waiter = Waiter()
                waiter.wake()
                waiter.sleep()
                return
        if self.order is not None:  # another order might let other branches run here
            self._ranked(self.order).stops += 1

    def park(self, waiter: Waiter) -> None:
        """Run other branches until something wakes the waiter; see :meth:`Waiter.sleep`."""
        refuse_held()
        if self.order is not None:
            self._ranked(self.order).stops += 1
        outside = self._is_outside()
        waiter.parked, waiter.undisturbed = True, False
        self._parked[waiter] = None
        try:
            if not self.branches:
                self._sleep_alone()
            else:
                if outside:
                    self._outside = waiter
                if not self._loop:
                    context.greenlets_begin()
                    self._loop = greenlet(self._run)
                self._loop.switch()
        finally:
            waiter.parked = False
            self._parked.pop(waiter, None)
            if outside:
                self._outside = None
        if outside and not self.joining:
            interrupts.raise_pending()

    def leave(self, branch: _Branch) -> None:
        """Return from an ended branch to the present loop, because the branch may have begun in an earlier loop."""
        if self._loop is not None:
            getcurrent().parent = self._loop
        self.branches.pop(branch, None)
        if self.order is not None and branch.ranked is not None:
            self.order.end(branch.ranked)

    def _ranked(self, order: Order) -> Ranked:
        return order.outside if self.running is None or self.running.ranked is None else self.running.ranked

    def suspended(self) -> Iterator[tuple[FrameType, Context]]:
        """Yield the innermost frame and the context of each suspended branch, and of the suspended code outside."""
        waiting = [branch._greenlet for branch in self.branches]  # noqa: SLF001  same module
        if self._loop is not None:
            waiting.append(self._loop.parent)
        for each in waiting:
            if each is not None and each.gr_frame is not None and each.gr_context is not None:
                yield each.gr_frame, each.gr_context

    def _is_outside(self) -> bool:
        return not self._loop or getcurrent() is self._loop.parent

    def _run(self) -> None:
        try:
            slept = False
            while self.branches:
                self.poll(again=slept)
                slept = False
                first, self._first = self._first, None
                chosen: Ready
                if first is not None and first in self._ready:
                    self._ready.pop(first)
                    chosen = first
                elif self._ready:
                    chosen = schedule(self._ready, self._dice, self.order)
                elif (patient := self._next_patient()) is not None:
                    chosen = patient
                elif not self.can_be_woken():
                    error = DeadlockedBranches(self._blocked())
                    inside = next((each for each in self._parked if each.branch is not None), None)
                    if not self._deadlocked or inside is None:
                        self._deadlocked = True
                        raise error
                    self.running = inside.branch
                    inside.fail(error)
                    continue
                else:
                    self._sleep()
                    slept = True
                    continue
                self.running = chosen.branch if not chosen.ended else None  # then the code outside continues
                chosen.resume()
            self._deadlocked = False
        finally:
            # after an error in the loop, a wake-up may be lost
            for branch in list(self.branches):
                if branch.ended:
                    self.branches.pop(branch, None)
                else:
                    self.add(branch)
            self._loop = None
            self.running = None

    def _next_patient(self) -> Waiter | None:
        """Return the first patient wait that may resume when no branch is ready."""
        for waiter in sorted(self.patient, key=lambda each: each.last):
            if waiter.parked and waiter.patience is not None and waiter.patience():
                waiter.undisturbed = True
                return waiter
        return None

    def is_awaited(self) -> bool:
        """Return whether a branch or wait is ready, or a Ctrl-C is deferred; a patient wait then returns."""
        self.poll()
        return bool(self._ready) or (interrupts.is_pending() and self._is_outside() and not self.joining)

    def _sleep_alone(self) -> None:
        self.poll()
        while not self._ready and self._next_patient() is None and not interrupts.is_pending():
            if not self.can_be_woken():
                raise DeadlockedBranches(self._blocked())
            self._sleep()
            self.poll(again=True)
        for ready in list(self._ready):
            if isinstance(ready, Waiter):  # the waiting code then checks its predicate
                self._ready.pop(ready, None)

    def _sleep(self) -> None:
        first = min((each.end for each in self.strike_sources if not each.struck), default=math.inf)
        while not self._bell.acquire(timeout=min(max(0.0, first - time.monotonic()), MISSED_SIGNALS_EVERY)):
            if first <= time.monotonic() or self.patient:  # otherwise a signal handler has run
                break

    def awaits_strike(self) -> bool:
        """Return whether a deadline in wall-clock time, or a worker, will wake a wait."""
        return any(not each.struck for each in self.strike_sources)

    def can_be_woken(self) -> bool:
        """Return whether a deadline, or a thread or signal handler of the plan, may wake a wait of this thread."""
        if self.awaits_strike() or threads_of_plan() or interrupts.has_handlers():
            return True
        return not self._bell.locked()  # checked last, because another thread may wake this thread and end

    def _blocked(self) -> list[BlockedWait]:
        """Return the waits of the branches, and of the code outside if that code doesn't only wait for the branches."""
        waits = {each.branch: each for each in self._parked}
        names = {each.name: each.label() or each.name for each in self.branches}
        blocked: list[BlockedWait] = []
        for branch in (*self.branches, None):
            if (waiter := waits.get(branch)) is not None:
                reason, before, depends_on = waiter.reason()
                name, file, line, label = waiter.plan_line()
                if branch is not None or not depends_on or not {*depends_on} <= names.keys():
                    others = tuple(names.get(each, each) for each in depends_on)
                    reason += f", {before} {', '.join(others)}" if before and others else ""
                    place = notebook.place(Path(file).name, line) if file else ""
                    blocked.append(BlockedWait(label or name, place, reason, others))
        return blocked

    def poll(self, *, again: bool = False) -> None:
        """Notify the waits of each source that strikes. ``again``: the thread has only slept since the last poll."""
        waiting = [each for each in self.strike_sources if not each.struck]
        if not waiting:
            return
        if not again:
            self.polls += 1
        which = None if self.recorded_strikes is None else self.recorded_strikes(self.polls)
        if which is None or (again and not which):
            which = [number for number, each in enumerate(waiting) if each.is_due()]
        struck = [number for number in which if number < len(waiting)]
        for each in (waiting[number] for number in struck):
            each.await_due()
            each.struck = True
            each.notify_all()
        if struck and threading.current_thread() is threading.main_thread():
            journal.strike(self.polls, struck)

    def defers(self, frame: FrameType) -> bool:
        """Return whether a Ctrl-C that arrives in this frame must wait for the next checkpoint."""
        return not self._is_outside() or _in_own_code(frame)

    def interrupt(self) -> None:
        """Handle a deferred Ctrl-C: the code outside of all branches runs next, and raises KeyboardInterrupt."""
        if self.branches and (self.joining or interrupts.is_pending()) and sys.stderr is not None:
            names = ", ".join(branch.name for branch in list(self.branches))
            sys.stderr.write(f"waiting for {names} to reach the next action; Ctrl-\\ ends the process immediately\n")
        if self._outside is not None:
            self._first = self._outside
            self.add(self._outside)
        self.ring()


def _in_own_code(frame: FrameType) -> bool:
    """Return whether a frame runs code of PyCRAM's language or scheduler, which the plan has called."""
    plan = plan_frame(frame)[0]
    current: FrameType | None = frame
    while current is not None and current is not plan:
        if str(current.f_globals.get("__name__", "")).startswith(_OWN):
            return True
        current = current.f_back
    return False


def threads_of_plan() -> bool:
    """Return whether another thread may run the plan's code; the threading module doesn't know all threads."""
    if forking.others():
        return True
    known = {thread.ident for thread in threading.enumerate()}
    return bool(sys._current_frames().keys() - known - _BEFORE)  # noqa: SLF001  no other function returns all threads


class _Local(threading.local):
    locks = 0  # number of locks that this thread holds

    def __init__(self) -> None:
        self.scheduler = Scheduler()


_local = _Local()


def scheduler() -> Scheduler:
    """Return the scheduler of this thread."""
    return _local.scheduler


journal.looks = lambda: scheduler().polls


def schedule_alone() -> None:
    """Give this thread of a forked child process a new scheduler, which has no branches, but continues the order."""
    before, _local.scheduler = _local.scheduler, Scheduler()
    _local.scheduler.continue_order(before)


class LockHeld(UsageError):
    """A branch waits or yields while it holds a lock: the other branches of its thread would then hold the lock too."""

    def __init__(self) -> None:
        super().__init__("a branch must not wait or perform a motion while it holds the lock of a world or of fluents")


class Lock:
    """A re-entrant lock as a context manager; each thread counts the locks that it holds."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    @property
    def is_mine(self) -> bool:
        """Whether this thread holds the lock."""
        return bool(self._lock._is_owned())  # type: ignore[attr-defined]  # noqa: SLF001  as threading.Condition does

    def __enter__(self) -> None:
        self._lock.acquire()
        _local.locks += 1

    def _try(self) -> bool:
        acquired = self._lock.acquire(blocking=False)
        _local.locks += acquired
        return acquired

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        _local.locks -= 1
        self._lock.release()


def is_held() -> bool:
    """Return whether this thread holds a lock."""
    return _local.locks > 0


def refuse_held() -> None:
    """Raise LockHeld if this thread holds a lock; called before a branch may yield."""
    if is_held():
        raise refused(LockHeld(), "wait", {})
