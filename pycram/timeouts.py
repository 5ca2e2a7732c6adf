"""Timeouts: a stretch of the plan that has to be done within a time.

When the time is up, what runs in it is told to stop, and stops where that is safe (:mod:`pycram.cancellation`): at its
next action, change of the world or wait. Then the stretch fails with :class:`TimedOut`, which a plan may handle or try
again after. A stretch that got to its end meanwhile has succeeded.
"""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pycram.cancellation import Cancelled, Scope, checkpoint, current_scope, entered
from pycram.foundation.checks import number
from pycram.foundation.failures import BadArgument, NoWorld, PlanFailure
from pycram.nesting import stretch
from pycram.open_block import alone
from recorder.records import STEPS_PER_SECOND
from recorder.tracing.span import span

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


class TimedOut(PlanFailure):
    """Something was not done in time.

    Attributes:
        seconds: the time that it had.
        clock: "wall" or "simulated".
    """

    def __init__(self, seconds: float, clock: str) -> None:
        simulated = " of simulated time" if clock == "simulated" else ""
        super().__init__(f"not done within {seconds:g} s{simulated}")
        self.seconds = seconds
        self.clock = clock


@stretch
def timeout(seconds: float, *, simulated: bool = False) -> Iterator[None]:
    """Gives its block so much time. In the block actions happen one after the other.

    Args:
        seconds: the time in s.
        simulated: whether it is that of the current world, which passes only when that is simulated, instead of the
            clock's.

    Raises:
        TimedOut: it was not done in time.
        BadArgument: not a number from 0 up.
        NoWorld: there is no world to simulate.
    """
    limit = number("seconds", seconds)
    if limit < 0:
        raise BadArgument("seconds", seconds, "a number from 0 up")
    clock = "simulated" if simulated else "wall"
    with alone() as settle, _watch(limit) if simulated else _timer(limit) as scope:
        outer = current_scope()
        with span("timeout", f"{limit:g} s", {"seconds": limit, "clock": clock}):
            try:
                with entered(scope):
                    checkpoint()
                    yield
                    settle()
            except Cancelled as stopped:
                if scope.overdue and not (outer is not None and outer.cancelled):
                    raise TimedOut(limit, clock) from stopped
                raise


@contextmanager
def _timer(seconds: float) -> Iterator[Scope]:
    """A scope whose deadline is on the clock."""
    end = time.monotonic() + seconds
    yield Scope(current_scope(), lambda: max(0.0, end - time.monotonic()))


@contextmanager
def _watch(seconds: float) -> Iterator[Scope]:
    """A scope whose deadline is on the current world's time."""
    from pycram.world.world import BulletWorld  # noqa: PLC0415  worlds know nothing of plans

    world = BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    end = world.sim_step + round(seconds * STEPS_PER_SECOND)
    remaining: Callable[[], float] = lambda: 0.0 if world.sim_step >= end else math.inf  # noqa: E731
    scope = Scope(current_scope(), remaining)
    world.time_listeners.add(scope.wake)
    try:
        yield scope
    finally:
        world.time_listeners.discard(scope.wake)
