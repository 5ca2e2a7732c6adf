"""The scheduler of a thread: which of its branches runs next, and what wakes those that wait.

With a seed, the next one is drawn from all that are ready: another seed takes the plan through another order, the same
one through the same, in any process and under any load. Without a seed, it is the one that has been ready longest.
Orders that somebody asks for by name are those of :mod:`pycram.scheduling.order`.
What a clock or a worker decides is a strike, and no seed knows when it comes. The scheduler sees it when it looks: at
checkpoints, and when it chooses who runs next. Looks that have something to look for are numbered, and the strikes of
the main thread are on record; a run that a recording guides has them at the same looks.

A branch that yields switches to the scheduler's loop, a greenlet too, which starts or resumes the next one that is
ready. If none is, the first of those goes on that wait patiently, as for simulated time, which passes only while nobody
has anything to do. If there is none either, the thread sleeps until another thread rings its bell or the first deadline
has passed. The code outside of all branches takes turns with them; a thread without branches just sleeps.

The handler of any signal may raise an error between two instructions (a plan's own time limit by ``signal.alarm``), and
a deep recursion may end in any call. Then the loop ends, the code outside of all branches gets the error, and the next
loop gives everybody a turn again: so nobody's turn is lost, and waits check their predicates anyway.
"""

from __future__ import annotations

import _thread
import math
import random
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import OrderedDict
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from greenlet import getcurrent, greenlet

from pycram.scheduling.locks import refuse_held
from pycram.scheduling.order import DeadlockedBranches, Standing, order_of
from recorder.tracing import context, forking, interrupts, journal
from recorder.tracing.call_stack import call_site, plan_frame
from recorder.tracing.context import enter_branch, new_branch

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from contextvars import Context
    from types import FrameType
    from typing import Self

    from pycram.scheduling.order import Order, Ranked
    from recorder.tracing.call_stack import CallSite


#: Python doesn't wake a thread for a signal that arrives just before it goes to sleep: seconds until that is noticed.
MISSED_SIGNALS_EVERY: Final = 0.1
_OWN: Final = ("pycram.language", "pycram.scheduling")


class Waiter:
    """One wait, in a branch or outside of all; the sources wake it until its ``with`` block ends.

    Args:
        sources: What wakes it.
        patience: Of a patient wait, which goes on when nothing else of its thread is ready: whether it would now.

    Attributes:
        branch: That branch; None outside of all.
        patience: As given.
        parked: Whether it sleeps.
        undisturbed: Whether it went on because nothing else was ready.
    """

    __slots__ = ("_greenlet", "_scheduler", "_sources", "branch", "parked", "patience", "undisturbed")

    def __init__(self, sources: Collection[Condition] = (), patience: Callable[[], bool] | None = None) -> None:
        self._greenlet = getcurrent()
        self._scheduler = scheduler()
        self._sources = sources
        self.branch = self._scheduler.running
        self.patience = patience
        self.parked = self.undisturbed = False

    def wake(self) -> None:
        """Schedule it to check its predicate again; from any thread."""
        self._scheduler.add(self)

    def resume(self) -> None:
        """Switch to the waiting code; for the scheduler's loop."""
        self._greenlet.switch()

    def standing(self) -> Standing:
        """Where the plan waits."""
        return _standing(self.branch, self._greenlet)

    def sleep(self) -> bool:
        """Yield until woken, perhaps spuriously.

        Returns:
            Whether a patient wait goes on because nothing else of the thread is ready.
        """
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
        if self._scheduler.order is not None or self.patience is not None:
            self._scheduler.forget(self)


@dataclass(slots=True, eq=False)
class _Branch:
    """A branch that hasn't started, or hasn't ended."""

    scheduler: Scheduler
    name: str
    context: Context
    action: Callable[[], None]
    failed: Callable[[BaseException], None]
    site: CallSite
    ranked: Ranked | None = None
    _greenlet: greenlet | None = None
    _started: bool = False  # whether its greenlet will also end it

    @property
    def branch(self) -> _Branch:
        """Itself, as a wait has its branch."""
        return self

    def standing(self) -> Standing:
        """Where it waits; before its start where it was added."""
        return _standing(self, self._greenlet)

    @property
    def ended(self) -> bool:
        """Whether its greenlet has ended."""
        return self._started and self._greenlet is not None and self._greenlet.dead

    def resume(self) -> None:
        """Start it, or have it check what it waits for; for the scheduler's loop."""
        if not self._started or self._greenlet is None:
            self._greenlet = greenlet(self._run)
            self._greenlet.gr_context = self.context
        self._greenlet.switch()

    def _run(self) -> None:
        try:
            self._started = True
            enter_branch(new_branch(self.name))
            self.action()
        except BaseException as error:
            self.failed(error)
            raise
        finally:
            self.scheduler.leave(self)


Ready: TypeAlias = "Waiter | _Branch"


def _standing(branch: _Branch | None, suspended: greenlet | None) -> Standing:
    frame = plan_frame(suspended.gr_frame)[0] if suspended is not None else None
    site = (frame.f_code.co_filename, frame.f_lineno) if frame is not None else branch.site if branch else ("", 0)
    return Standing(threading.current_thread().name if branch is None else branch.name, *site)


def schedule(ready: OrderedDict[Ready, None], dice: random.Random | None, order: Order | None = None) -> Ready:
    """Remove and return what runs next: by an order, drawn, or ready longest. Nothing else decides that of a plan."""
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
    """Draw the order of this thread's branches from a seed from now on, and that of threads that begin later.

    Args:
        seed: The seed; None for the order in which branches became ready.
        order: Another order, as :mod:`pycram.scheduling.order` has it as text.

    Raises:
        BadArgument: It is no order.
    """
    global _seed, _order  # of the run, which is the process's
    order_of(order, seed)
    _seed, _order = seed, order
    scheduler().draw_from(seed, order)


def run_seed() -> int | None:
    """Return the run's seed; None where nobody has set one."""
    return _seed


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


#: The strikes of a recorded run: what strikes at a look, by its number; None when the recording guides no more.
Foreseen: TypeAlias = "Callable[[int], Collection[int] | None]"


class Scheduler:
    """Lets the branches of one thread take turns.

    Attributes:
        branches: Those that haven't ended, in the order in which they were added.
        joining: Whether the code outside of all branches, interrupted by Ctrl-C, waits for their ends.
        checkpoints: How many there were in this thread, where branches stop that are cancelled.
        running: The branch that runs; None while the code outside of all does.
        order: The order that was asked for; None for the ordinary one.
        alone: Whether no signal is waited for, as in a forked copy: where nothing can wake anybody is a deadlock.
        patient: The patient waits, in order of arrival; the first that would goes on when nothing is ready.
        outer: What it looks for, in the order in which that began.
        looks: How many there were.
        foreseen: Says what strikes where a recording guides; None where none does.
    """

    order: Order | None

    def __init__(self) -> None:
        self.branches: dict[_Branch, None] = {}
        self.joining = False
        self.checkpoints = 0
        self.running: _Branch | None = None
        self._ready: OrderedDict[Ready, None] = OrderedDict()
        self.draw_from(_seed, _order)
        self.alone = False
        self._deadlocked = False  # nobody runs any more, and one branch has had the error for it
        self.patient: dict[Waiter, None] = {}
        self._first: Waiter | None = None  # runs next, whatever else is ready
        self.outer: dict[Outer, None] = {}
        self.looks = 0
        self.foreseen: Foreseen | None = None
        self._bell = _thread.allocate_lock()
        self._bell.acquire()
        self._loop: greenlet | None = None
        self._outside: Waiter | None = None  # the code outside of all branches, while a branch runs

    def draw_from(self, seed: int | None, order: str = "") -> None:
        """Take the order from a seed, or one that is asked for; None for the order in which branches became ready."""
        self._dice = None if seed is None else random.Random(f"order {seed}")  # not that of the plan's own
        self.order = order_of(order, seed)
        for ready in list(self._ready):
            if isinstance(ready, Waiter) and not ready.parked:  # a wait that has ended: its turn is nobody's
                self.forget(ready)

    def continue_order(self, other: Scheduler) -> None:
        """Draw what another scheduler would draw next, in a process that has no use for that one any more."""
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
    ) -> None:
        """Schedule a new branch, or raise; from any thread.

        Args:
            name: Its name in records.
            context: The context that it runs in, this very one.
            action: Runs the branch. An error of it ends the loop; it has none of its own.
            failed: Called with that error first.
            site: The plan's line that adds it.
        """
        branch = _Branch(self, name, context, action, failed, site)
        if self.order is not None:
            branch.ranked = self.order.begin(self._ranked(self.order))
        try:
            self.branches[branch] = None
            self.add(branch)
        except BaseException:
            self.branches.pop(branch, None)
            self._ready.pop(branch, None)
            raise

    def add(self, ready: Ready) -> None:
        """Append to what is ready, unless it is; from any thread."""
        self._ready[ready] = None
        self.ring()

    def forget(self, ended: Waiter) -> None:
        """Take a wait that has ended from what is ready; else its branch would have a turn for nothing."""
        self._ready.pop(ended, None)

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
            self.look()
            if self._ready:
                waiter = Waiter()
                waiter.wake()
                waiter.sleep()
                return
        if self.order is not None:  # in the order of another run it might have been a turn
            self._ranked(self.order).stops += 1

    def park(self, waiter: Waiter) -> None:
        """Run others until the waiter is woken; see :meth:`Waiter.sleep`."""
        refuse_held()
        if self.order is not None:
            self._ranked(self.order).stops += 1
        outside = self._is_outside()
        waiter.parked, waiter.undisturbed = True, False
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
            if outside:
                self._outside = None
        if outside and not self.joining:
            interrupts.raise_pending()

    def leave(self, branch: _Branch) -> None:
        """Have a branch that ends return to the current loop: an error may have ended the one that started it."""
        if self._loop is not None:
            getcurrent().parent = self._loop
        self.branches.pop(branch, None)
        if self.order is not None and branch.ranked is not None:
            self.order.end(branch.ranked)

    def _ranked(self, order: Order) -> Ranked:
        """Return what runs, as the order knows it."""
        return order.outside if self.running is None or self.running.ranked is None else self.running.ranked

    def suspended(self) -> Iterator[tuple[FrameType, Context]]:
        """Yield innermost frames and contexts of the code that waits for its turn: branches, and outside of all."""
        waiting = [branch._greenlet for branch in self.branches]  # noqa: SLF001  same module
        if self._loop is not None:
            waiting.append(self._loop.parent)
        for each in waiting:
            if each is not None and each.gr_frame is not None and each.gr_context is not None:
                yield each.gr_frame, each.gr_context

    def _is_outside(self) -> bool:
        """Whether the running code is outside of all branches."""
        return not self._loop or getcurrent() is self._loop.parent

    def _run(self) -> None:
        """Loop as long as there are branches."""
        try:
            slept = False
            while self.branches:
                self.look(again=slept)
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
                else:
                    self._sleep()
                    slept = True
                    continue
                self.running = chosen.branch
                chosen.resume()
        except BaseException:
            self._resume_all()
            raise
        finally:
            self._loop = None
            self.running = None

    def _next_patient(self) -> Waiter | None:
        """Return the first patient wait that would go on, now that nothing is ready."""
        for waiter in self.patient:
            if waiter.parked and waiter.patience is not None and waiter.patience():
                waiter.undisturbed = True
                return waiter
        return None

    def is_awaited(self) -> bool:
        """Whether something is ready while a patient wait goes on, or a Ctrl-C is deferred to its next checkpoint."""
        self.look()
        return bool(self._ready) or (interrupts.is_pending() and self._is_outside() and not self.joining)

    def _resume_all(self) -> None:
        """Schedule all branches: the one that was to run next, or that was being woken, may have been lost."""
        for branch in list(self.branches):
            if branch.ended:
                self.branches.pop(branch, None)
            else:
                self.add(branch)

    def _sleep_alone(self) -> None:
        self.look()
        while not self._ready and self._next_patient() is None and not interrupts.is_pending():
            self._sleep()
            self.look(again=True)
        for ready in list(self._ready):
            if isinstance(ready, Waiter):  # its wait checks the predicate anyway
                self._ready.pop(ready, None)

    def _sleep(self) -> None:
        """Block the thread until the bell rings or a deadline passes."""
        first = min((each.end for each in self.outer if not each.struck), default=math.inf)
        known = self.alone or self.order is not None
        if known and first == math.inf and self._bell.locked() and not forking.others():
            self._tell_deadlock()
        while not self._bell.acquire(timeout=min(max(0.0, first - time.monotonic()), MISSED_SIGNALS_EVERY)):
            if first <= time.monotonic():  # else Python has called the handlers of signals
                break

    def _tell_deadlock(self) -> None:
        """Raise DeadlockedBranches, once: the cleaning up after it may wait again."""
        if not self._deadlocked:
            self._deadlocked = True
            standing = [branch.standing() for branch in list(self.branches)]
            standing = standing or [Standing(threading.current_thread().name, *call_site())]
            raise DeadlockedBranches({each.branch: f"{Path(each.file).name}:{each.line}" for each in standing})

    def look(self, *, again: bool = False) -> None:
        """See what has come by now, and have it strike.

        Args:
            again: Whether the thread has slept since it last looked, and nothing else: that is one look.
        """
        waiting = [each for each in self.outer if not each.struck]
        if not waiting:
            return
        if not again:
            self.looks += 1
        which = None if self.foreseen is None else self.foreseen(self.looks)
        if which is None or (again and not which):
            which = [number for number, each in enumerate(waiting) if each.is_due()]
        struck = [number for number in which if number < len(waiting)]
        for each in (waiting[number] for number in struck):
            each.await_due()
            each.struck = True
            each.notify_all()
        if struck and threading.current_thread() is threading.main_thread():
            journal.strike(self.looks, struck)

    def defers(self, frame: FrameType) -> bool:
        """Whether a Ctrl-C that arrives in this frame has to wait for the next checkpoint."""
        return not self._is_outside() or _in_own_code(frame)

    def interrupt(self) -> None:
        """Take note of a deferred Ctrl-C: the code outside of all branches runs next, and raises it."""
        if self.branches and (self.joining or interrupts.is_pending()) and sys.stderr is not None:
            names = ", ".join(branch.name for branch in list(self.branches))
            sys.stderr.write(f"waiting for {names} to get to the next action; Ctrl-\\ ends the process at once\n")
        if self._outside is not None:
            self._first = self._outside
            self.add(self._outside)
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


journal.looks = lambda: scheduler().looks


def schedule_alone() -> None:
    """Give this thread a scheduler of its own, which knows none of its branches, in a forked child.

    The code that runs is outside of all branches for it, and the order is drawn on from where it is.
    """
    before, _local.scheduler = _local.scheduler, Scheduler()
    _local.scheduler.continue_order(before)
    _local.scheduler.alone = True


class Limit(Condition, ABC):
    """A moment at which a part of the plan is to be done; notified when it comes."""

    @property
    @abstractmethod
    def has_come(self) -> bool:
        """Whether it is now, or was."""

    @property
    @abstractmethod
    def was_missed(self) -> bool:
        """Whether it was before this moment."""


class Outer(Condition):
    """Something that the thread waits for in a ``with`` block, which strikes from outside; notified when it does.

    Attributes:
        struck: Whether it has, as far as its thread has looked.
        end: Time of time.monotonic() at which it strikes by itself; infinity if none is known.
    """

    def __init__(self, end: float = math.inf) -> None:
        super().__init__()
        self.struck = False
        self.end = end
        self._scheduler = scheduler()

    def is_due(self) -> bool:
        """Whether it may strike now."""
        return self.end <= time.monotonic()

    def await_due(self) -> None:
        """Block the thread until it may, where a recording says that it does now; a deadline may at any time."""

    @property
    def has_come(self) -> bool:
        """Whether it has struck by now: its thread looks."""
        if self.struck:
            return True
        if self._scheduler is not scheduler():  # another thread, which has looks of its own, or a forked child's
            return self.is_due()
        self._scheduler.look()
        return self.struck

    def __enter__(self) -> Self:
        self._scheduler.outer[self] = None
        return self

    def __exit__(self, *_: object) -> None:
        self._scheduler.outer.pop(self, None)


class Deadline(Outer, Limit):
    """A moment of the clock.

    Args:
        seconds: How far it is from now.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__(time.monotonic() + seconds)

    @property
    def was_missed(self) -> bool:
        """Whether it was before this moment: the clock never stands still."""
        return self.has_come


def guide_strikes(foreseen: Foreseen, looks: int) -> None:
    """Have strikes come in this thread as they did in a recorded run.

    Where the thread sleeps and the recording says nothing, they come by themselves: a signal or a thread of the plan's
    own has woken it then, or the plan is another one.

    Args:
        foreseen: Gives them, by the numbers of the recorded looks.
        looks: How many the recorded run had had by now.
    """
    thread = scheduler()
    difference = looks - thread.looks
    thread.foreseen = lambda look: foreseen(look + difference)
