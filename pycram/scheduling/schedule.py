"""The scheduler of a thread: it chooses the branch that runs next, and wakes branches that wait.

With a seed, the scheduler draws the next branch from all that are ready: the same seed gives the same order, in any
process and under any load. Without a seed, the branch runs that has been ready longest. Orders that are requested by
name are in :mod:`pycram.scheduling.order`.

A strike is an event from outside of this order: a deadline passes, or a worker ends. No seed determines its timing. The
scheduler polls for strikes at checkpoints and when it chooses the next branch. Polls are numbered, and strikes of the
main thread are recorded; a run that a recording guides has its strikes at the same polls. The sources of strikes are in
:mod:`pycram.scheduling.strikes`.

A branch that yields switches to the scheduler's loop, a greenlet, which starts or resumes the next ready branch. If
none is ready, the first patient wait resumes, such as a wait in simulated time. If there is none, the thread sleeps
until another thread rings its bell or the first deadline passes. If neither can come, all branches are in a deadlock,
and the code outside of them gets the error. That code takes turns, too.

A signal handler may raise an error between any two instructions, and a deep recursion may end in any call. Then the
loop ends and the code outside of all branches gets the error. The next loop schedules all branches again.

Locks of threads are held for a short time, and never across a checkpoint.
"""

from __future__ import annotations

import _thread
import math
import random
import sys
import threading
import time
from collections import OrderedDict
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from greenlet import getcurrent, greenlet

from pycram.foundation.errors import UsageError
from pycram.foundation.refusals import refused
from pycram.scheduling.order import BlockedWait, BranchLine, DeadlockedBranches, order_of
from recorder import notebook
from recorder.tracing import context, forking, interrupts, journal
from recorder.tracing.call_stack import plan_frame, plan_frames, recorded_file
from recorder.tracing.context import enter_branch, new_branch

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from contextvars import Context
    from types import FrameType, TracebackType
    from typing import Self

    from pycram.scheduling.order import Order, Ranked
    from pycram.scheduling.strikes import StrikeSource
    from recorder.tracing.call_stack import CallSite


_BEFORE: Final = frozenset(sys._current_frames())  # noqa: SLF001  idents of threads that aren't the plan's
#: Seconds until a signal is noticed that arrives just before the thread sleeps: Python doesn't wake it then.
MISSED_SIGNALS_EVERY: Final = 0.1
_OWN: Final = ("pycram.language", "pycram.scheduling")


#: Returns what a wait waits for, words before the names of the branches that it depends on ("" if it names them), and
#: these names; called only in a deadlock.
Reason: TypeAlias = "Callable[[], tuple[str, str, Collection[str]]]"


def unknown_reason() -> tuple[str, str, Collection[str]]:
    """Return that it isn't known what a wait waits for."""
    return "", "", ()


class Waiter:
    """A wait, in a branch or outside of all branches; its conditions wake it until its ``with`` block ends.

    Args:
        sources: The conditions that wake it.
        patience: For a patient wait, which resumes when nothing else of its thread is ready: whether it may resume now.
        last: Whether it resumes only if no other patient wait may resume.
        reason: What it waits for.
    """

    __slots__ = ("_greenlet", "_scheduler", "_sources", "branch", "last", "parked", "patience", "reason", "undisturbed")

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
        self.branch = self._scheduler.running  # None outside of all branches
        self.patience, self.last = patience, last
        self.reason = reason
        self.parked = False  # whether it sleeps
        self.undisturbed = False  # whether it resumed because nothing else was ready

    def wake(self) -> None:
        """Schedule the wait to check its predicate again; from any thread."""
        self._scheduler.add(self)

    def resume(self) -> None:
        """Switch to the waiting code; called by the scheduler's loop."""
        self._greenlet.switch()

    @property
    def ended(self) -> bool:
        """Whether the code that waited has ended."""
        return self._greenlet.dead

    def fail(self, error: BaseException) -> None:
        """Switch to the waiting code, which raises an error."""
        self._greenlet.throw(error)

    def plan_line(self) -> BranchLine:
        """Return the plan's line that waits."""
        return _plan_line(self.branch, self._greenlet)

    def sleep(self) -> bool:
        """Yield until woken, perhaps spuriously; return whether a patient wait resumes: nothing else is ready."""
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
        """The branch itself: the schedule takes waits and branches."""
        return self

    def plan_line(self) -> BranchLine:
        """Return the plan's line that waits, or that added the branch before it starts."""
        return _plan_line(self, self._greenlet)

    @property
    def ended(self) -> bool:
        """Whether the branch has ended."""
        return self._started and self._greenlet is not None and self._greenlet.dead

    def resume(self) -> None:
        """Start the branch or switch to it; called by the scheduler's loop."""
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
        innermost = sys._getframe() if suspended is getcurrent() else suspended.gr_frame  # noqa: SLF001  as inspect has it
    lines = [(recorded_file(frame.f_code.co_filename), frame.f_lineno) for frame in plan_frames(innermost)]
    if branch is not None:  # the line in the file that added it, which tells more than a helper's
        site = next((line for line in lines if line[0] == branch.site[0]), branch.site)
        return BranchLine(branch.name, *site, branch.label())
    outermost = lines[-1][0] if lines else ""
    site = next((line for line in lines if line[0] == outermost), None) or ("", 0)
    return BranchLine(threading.current_thread().name, *site)


def schedule(ready: OrderedDict[Ready, None], dice: random.Random | None, order: Order | None = None) -> Ready:
    """Remove and return the branch or wait that runs next: by an order, at random, or the longest ready.

    Only this function decides the order of a plan's branches.
    """
    if order is not None:
        candidates: dict[Ranked, Ready] = {}
        for each in ready:
            branch = each.branch
            candidates.setdefault(order.outside if branch is None or branch.ranked is None else branch.ranked, each)
        chosen = candidates[order.choose(candidates)] if len(candidates) > 1 else next(iter(ready))
        del ready[chosen]
        return chosen
    if dice is None or len(ready) == 1:
        return ready.popitem(last=False)[0]
    drawn = next(islice(ready, int(dice.random() * len(ready)), None))
    del ready[drawn]
    return drawn


_seed: int | None = None
_order = ""


def seed_order(seed: int | None, order: str = "") -> None:
    """Draw the order of branches from a seed from now on, in this thread and in threads that start later.

    Args:
        seed: None for the order in which branches became ready.
        order: Another order, as text of :mod:`pycram.scheduling.order`; raises BadArgument if it isn't an order.
    """
    global _seed, _order  # seed of the run: a process has one run
    order_of(order, seed)
    _seed, _order = seed, order
    scheduler().draw_from(seed, order)


def run_seed() -> int | None:
    """Return the run's seed; None if none was set."""
    return _seed


class Condition:
    """A condition that branches and threads wait for; see :func:`pycram.scheduling.cancellation.wait`."""

    def __init__(self) -> None:
        self.waiters: dict[Waiter, None] = {}  # present waits, in order of arrival

    def notify_all(self) -> None:
        """Wake all waits to check their predicates again; called after the change, from any thread."""
        for waiter in list(self.waiters):
            waiter.wake()


#: Returns the recorded strikes of a poll by its number; None after the end of the recording.
RecordedStrikes: TypeAlias = "Callable[[int], Collection[int] | None]"


class Scheduler:
    """Lets the branches of one thread take turns."""

    order: Order | None
    """The requested order; None for the default one."""

    def __init__(self) -> None:
        self.branches: dict[_Branch, None] = {}  # branches that haven't ended, in the order in which they were added
        self.joining = False  # whether the code outside of all branches waits for their ends after Ctrl-C
        self.checkpoints = 0  # number of checkpoints in this thread
        self.running: _Branch | None = None  # None while the code outside of all branches runs
        self.failing: dict[_Branch | None, BaseException] = {}  # errors that branches raise at their next checkpoints
        self._ready: OrderedDict[Ready, None] = OrderedDict()
        self.draw_from(_seed, _order)
        self._parked: dict[Waiter, None] = {}  # waits that sleep
        self._deadlocked = False  # whether the code outside of the present branches has had the error of a deadlock
        self.patient: dict[Waiter, None] = {}  # patient waits, in order of arrival
        self._first: Waiter | None = None  # runs next, before all that are ready
        self.strike_sources: dict[StrikeSource, None] = {}  # polled in this order
        self.polls = 0  # number of polls
        self.recorded_strikes: RecordedStrikes | None = None  # None if no recording guides this thread
        self._bell = _thread.allocate_lock()
        self._bell.acquire()
        self._loop: greenlet | None = None
        self._outside: Waiter | None = None  # the code outside of all branches, while a branch runs

    def draw_from(self, seed: int | None, order: str = "") -> None:
        """Set the order of branches; see :func:`seed_order`."""
        self._dice = None if seed is None else random.Random(f"order {seed}")  # separate from the plan's random numbers
        self.order = order_of(order, seed)
        for ready in list(self._ready):
            if isinstance(ready, Waiter) and not ready.parked:  # a wait that has ended
                self.forget(ready)

    def continue_order(self, other: Scheduler) -> None:
        """Continue the order of another scheduler, which this process doesn't use any more."""
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
        """Schedule a new branch; after an error it isn't scheduled. May be called from any thread.

        Args:
            name: Name in records.
            context: The branch runs in this context, not in a copy.
            action: Runs the branch. It handles the branch's errors; an error that it raises ends the scheduler's loop.
            failed: Called first with an error that ``action`` raises.
            site: The plan's line that adds the branch.
            label: Returns its name for people, with its arguments; "" for the name in records.
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
        """Append a branch or wait to the ready ones, if it isn't among them; from any thread."""
        self._ready[ready] = None
        self.ring()

    def forget(self, ended: Waiter) -> None:
        """Remove a wait that has ended from the ready ones."""
        self._ready.pop(ended, None)

    def ring(self) -> None:
        """Wake the thread if it sleeps; from any thread, and from signal handlers."""
        if self._bell.locked():  # otherwise the bell has rung already
            with suppress(RuntimeError):  # another thread has just rung it
                self._bell.release()

    def fail_later(self, error: BaseException) -> None:
        """Let the running branch raise an error at its next checkpoint, or at its end; an earlier error comes first."""
        self.failing.setdefault(self.running, error)

    def take_failure(self) -> BaseException | None:
        """Return the error that the running branch has to raise, and forget it."""
        return self.failing.pop(self.running, None)

    def yield_turn(self) -> None:
        """Let the other branches that are ready run first; outside of all branches, raise a deferred Ctrl-C."""
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
        if self.order is not None:  # in another order, others might have run here
            self._ranked(self.order).stops += 1

    def park(self, waiter: Waiter) -> None:
        """Run other branches until the waiter is woken; see :meth:`Waiter.sleep`."""
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
        """Let a branch that ends return to the present loop: an error may have ended the loop that started it."""
        if self._loop is not None:
            getcurrent().parent = self._loop
        self.branches.pop(branch, None)
        if self.order is not None and branch.ranked is not None:
            self.order.end(branch.ranked)

    def _ranked(self, order: Order) -> Ranked:
        """Return the running code's rank in an order."""
        return order.outside if self.running is None or self.running.ranked is None else self.running.ranked

    def suspended(self) -> Iterator[tuple[FrameType, Context]]:
        """Yield innermost frames and contexts of suspended code: of branches, and of the code outside of them."""
        waiting = [branch._greenlet for branch in self.branches]  # noqa: SLF001  same module
        if self._loop is not None:
            waiting.append(self._loop.parent)
        for each in waiting:
            if each is not None and each.gr_frame is not None and each.gr_context is not None:
                yield each.gr_frame, each.gr_context

    def _is_outside(self) -> bool:
        """Return whether the running code is outside of all branches."""
        return not self._loop or getcurrent() is self._loop.parent

    def _run(self) -> None:
        """Run branches as long as there are any."""
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
                    self._fail_deadlocked()
                    continue
                else:
                    self._sleep()
                    slept = True
                    continue
                self.running = chosen.branch if not chosen.ended else None  # the code outside may run then
                chosen.resume()
            self._deadlocked = False
        finally:
            self._resume_all()
            self._loop = None
            self.running = None

    def _next_patient(self) -> Waiter | None:
        """Return the first patient wait that may resume, because nothing is ready."""
        for waiter in sorted(self.patient, key=lambda each: each.last):
            if waiter.parked and waiter.patience is not None and waiter.patience():
                waiter.undisturbed = True
                return waiter
        return None

    def is_awaited(self) -> bool:
        """Return whether something is ready, or a Ctrl-C waits for the next checkpoint, while a patient wait runs."""
        self.poll()
        return bool(self._ready) or (interrupts.is_pending() and self._is_outside() and not self.joining)

    def _resume_all(self) -> None:
        """Schedule all branches that an error has interrupted: it may have lost the next one, or a wake-up."""
        for branch in list(self.branches):
            if branch.ended:
                self.branches.pop(branch, None)
            else:
                self.add(branch)

    def _sleep_alone(self) -> None:
        self.poll()
        while not self._ready and self._next_patient() is None and not interrupts.is_pending():
            if not self.can_be_woken():
                raise DeadlockedBranches(self._blocked())
            self._sleep()
            self.poll(again=True)
        for ready in list(self._ready):
            if isinstance(ready, Waiter):  # the waiting code checks its predicate anyway
                self._ready.pop(ready, None)

    def _sleep(self) -> None:
        """Block the thread until the bell rings or a deadline passes."""
        first = min((each.end for each in self.strike_sources if not each.struck), default=math.inf)
        while not self._bell.acquire(timeout=min(max(0.0, first - time.monotonic()), MISSED_SIGNALS_EVERY)):
            if first <= time.monotonic() or self.patient:  # otherwise Python has called signal handlers
                break

    def awaits_strike(self) -> bool:
        """Return whether a deadline of the clock or a worker will wake a wait."""
        return any(not each.struck for each in self.strike_sources)

    def can_be_woken(self) -> bool:
        """Return whether a deadline, a thread or a signal handler of the plan may wake a wait of this thread.

        A thread of native code isn't known before it has run Python.
        """
        if self.awaits_strike() or threads_of_plan() or interrupts.has_handlers():
            return True
        return not self._bell.locked()  # last: a thread may have rung it before it ended

    def _fail_deadlocked(self) -> None:
        """Raise DeadlockedBranches outside of the branches, or in one of them if that didn't end their waits.

        The first error cancels the branches. Then only their cleanup code can wait.
        """
        error = DeadlockedBranches(self._blocked())
        inside = next((each for each in self._parked if each.branch is not None), None)
        if not self._deadlocked or inside is None:
            self._deadlocked = True
            raise error
        self.running = inside.branch
        inside.fail(error)

    def _blocked(self) -> list[BlockedWait]:
        """Return the waits of all branches, and of the code outside unless it only waits for these branches."""
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
        """Poll the sources of strikes, and notify the waits of each source that strikes.

        Args:
            again: Whether the thread only slept since the last poll; both count as one.
        """
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
        """Return whether a Ctrl-C that arrives in this frame has to wait for the next checkpoint."""
        return not self._is_outside() or _in_own_code(frame)

    def interrupt(self) -> None:
        """Handle a deferred Ctrl-C: the code outside of all branches runs next, and raises it."""
        if self.branches and (self.joining or interrupts.is_pending()) and sys.stderr is not None:
            names = ", ".join(branch.name for branch in list(self.branches))
            sys.stderr.write(f"waiting for {names} to reach the next action; Ctrl-\\ ends the process immediately\n")
        if self._outside is not None:
            self._first = self._outside
            self.add(self._outside)
        self.ring()


def _in_own_code(frame: FrameType) -> bool:
    """Return whether a frame of the plan language or the scheduler was called by the innermost frame of the plan."""
    plan = plan_frame(frame)[0]
    current: FrameType | None = frame
    while current is not None and current is not plan:
        if str(current.f_globals.get("__name__", "")).startswith(_OWN):
            return True
        current = current.f_back
    return False


def threads_of_plan() -> bool:
    """Return whether another thread may run the plan's code, also one that the threading module doesn't know."""
    if forking.others():
        return True
    known = {thread.ident for thread in threading.enumerate()}
    return bool(sys._current_frames().keys() - known - _BEFORE)  # noqa: SLF001  no other function knows them


class _Local(threading.local):
    def __init__(self) -> None:
        self.scheduler = Scheduler()


_local = _Local()


def scheduler() -> Scheduler:
    """Return the scheduler of this thread."""
    return _local.scheduler


journal.looks = lambda: scheduler().polls


def schedule_alone() -> None:
    """Give this thread a new scheduler without branches, in a forked child.

    The running code is outside of all branches then, and the order continues.
    """
    before, _local.scheduler = _local.scheduler, Scheduler()
    _local.scheduler.continue_order(before)


# --- locks -----------------------------------------------------------------------------------------------------------


class LockHeld(UsageError):
    """A branch waits or yields while it holds a lock: other branches of its thread would hold the lock too."""

    def __init__(self) -> None:
        super().__init__("a branch must not wait or perform a motion while it holds the lock of a world or of fluents")


class _Held(threading.local):
    count = 0  # number of locks that the thread holds


_held: Final = _Held()
_shared: Final[list[Callable[[], bool]]] = []  # for each shared lock, whether the thread holds it


def shared_lock() -> threading.RLock:
    """Return a lock of the whole process, which is never freed; entering it takes a fifth of a Lock's time."""
    lock = threading.RLock()
    _shared.append(lock._is_owned)  # type: ignore[attr-defined]  # noqa: SLF001  as threading.Condition does
    return lock


class Lock:
    """A re-entrant lock, as a context manager; the locks that a thread holds are counted."""

    __slots__ = ("_lock",)

    def __init__(self) -> None:
        self._lock = threading.RLock()

    @property
    def is_mine(self) -> bool:
        """Whether this thread holds the lock."""
        return bool(self._lock._is_owned())  # type: ignore[attr-defined]  # noqa: SLF001  as above

    def __enter__(self) -> None:
        self._lock.acquire()
        _held.count += 1

    def _try(self) -> bool:
        """Acquire the lock unless another thread holds it; return whether it was acquired."""
        acquired = self._lock.acquire(blocking=False)
        _held.count += acquired
        return acquired

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        _held.count -= 1
        self._lock.release()


def is_held() -> bool:
    """Return whether the thread holds a lock."""
    if _held.count:
        return True
    for is_owned in _shared:  # noqa: SIM110  any() takes three times as long
        if is_owned():
            return True
    return False


def refuse_held() -> None:
    """Raise LockHeld if the thread holds a lock; called wherever a branch may yield."""
    if is_held():
        raise refused(LockHeld(), "wait", {})
