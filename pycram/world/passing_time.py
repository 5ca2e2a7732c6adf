"""Waiting in simulated time, which passes for all who wait together.

Time stands still as long as a branch of the thread is ready to run. When all wait, for time or for something else, the
first of those that wait for time simulates in one go: until a wait for time is over, a fluent that somebody follows
changes, something listens to the time, or somebody gets ready, at one of the 30 moments of a simulated second. So
branches of ``par`` move at the same time, in an order that the run's seed decides, and a motion alone is few records.

In real time the world's clock simulates; other threads, and other branches that simulate on their own, do as well.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import WorldClosed
from pycram.scheduling.cancellation import current_scope, raise_if_cancelled, uninterruptible
from pycram.scheduling.schedule import Waiter, scheduler
from pycram.world import simulation
from pycram.world.waits import Wait
from recorder import records

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.scheduling.cancellation import CancelScope
    from pycram.world.world import BulletWorld

_MAX_STEPS: Final = 10 * records.STEPS_PER_SECOND  # of one record


def wait(world: BulletWorld, predicate: Callable[[], bool]) -> None:
    """Wait until a predicate holds, while simulated time passes; a checkpoint, also in uninterruptible code.

    Args:
        world: The world whose time passes.
        predicate: Called once now, and then once each 1/30 s of simulated time with the world's lock held: it reads
            the world, and neither changes it nor waits.

    Raises:
        Cancelled: The branch is cancelled, and the predicate doesn't hold.
        WorldClosed: The world ends meanwhile.
        LockHeld: The caller holds a lock.
    """
    waiting = Wait(predicate)
    with world.lock:
        over = waiting.sample()
    if not over:
        _pass(world, waiting)
    waiting.raise_error()


def _pass(world: BulletWorld, waiting: Wait) -> None:
    scope = current_scope()
    sources = () if scope is None else scope.sources
    with Waiter(sources, patience=lambda: not world.realtime) as waiter:
        waiting.waiter = waiter
        world.waits.add(waiting)
        try:
            while not waiting.held:
                raise_if_cancelled()
                if world.closed:
                    raise WorldClosed(world.name, "wait in its time")
                if waiter.sleep():
                    _simulate(world, scope)
        finally:
            world.waits.remove(waiting)


@uninterruptible()
def _simulate(world: BulletWorld, scope: CancelScope | None) -> None:
    """Simulate until somebody has something to do."""
    command = records.Simulate(steps=_MAX_STEPS)
    with world.transactions.begin(records.Mutation(simulate=command)) as transaction:
        simulation.simulate(world, _MAX_STEPS, transaction, partial(_is_enough, world, scope))


def _is_enough(world: BulletWorld, scope: CancelScope | None) -> bool:
    """Whether somebody has something to do now, or may have."""
    observer = world.transactions.observer
    return (
        world.waits.held
        or scheduler().is_awaited()
        or (scope is not None and scope.is_cancelled)
        or bool(world.time_listeners)
        or (observer is not None and observer.has_news())
        or world.lock.is_contended
    )
