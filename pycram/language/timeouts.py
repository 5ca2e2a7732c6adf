"""Timeouts: a part of the plan that has to be done within a time.

When the time is up, what runs in it is cancelled and stops where that is safe, at its next checkpoint
(:mod:`pycram.scheduling`). Then it fails with :class:`TimedOut`, which a plan may handle or try again after. What got
to its end meanwhile has succeeded.
"""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pycram.foundation.checks import number
from pycram.foundation.failures import BadArgument, NoWorld, PlanFailure
from pycram.language.body import sequential
from pycram.language.nesting import scope
from pycram.scheduling.cancellation import Cancelled, CancelScope, current_scope, entered, raise_if_cancelled
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


@scope
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
    with sequential() as settle, _watch(limit) if simulated else _timer(limit) as cancel_scope:
        outer = current_scope()
        with span("timeout", f"{limit:g} s", {"seconds": limit, "clock": clock}):
            try:
                with entered(cancel_scope):
                    raise_if_cancelled()
                    yield
                    settle()
            except Cancelled as stopped:
                if cancel_scope.is_overdue and not (outer is not None and outer.is_cancelled):
                    raise TimedOut(limit, clock) from stopped
                raise


@contextmanager
def _timer(seconds: float) -> Iterator[CancelScope]:
    """A scope whose deadline is on the clock."""
    end = time.monotonic() + seconds
    yield CancelScope(current_scope(), lambda: max(0.0, end - time.monotonic()))


@contextmanager
def _watch(seconds: float) -> Iterator[CancelScope]:
    """A scope whose deadline is on the current world's time."""
    from pycram.world.world import BulletWorld  # noqa: PLC0415  worlds know nothing of plans

    world = BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    end = world.sim_step + round(seconds * STEPS_PER_SECOND)
    remaining: Callable[[], float] = lambda: 0.0 if world.sim_step >= end else math.inf  # noqa: E731
    made = CancelScope(current_scope(), remaining)
    world.time_listeners.add(made.notify_all)
    try:
        yield made
    finally:
        world.time_listeners.discard(made.notify_all)
