"""Timeouts: parts of the plan with a deadline.

At the deadline, the part is cancelled. A cancelled part stops at its next checkpoint (:mod:`pycram.scheduling`), or at
its end if it has no further checkpoint. The part fails with :class:`TimedOut`, which a plan may handle or retry.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pycram.foundation.checks import number
from pycram.foundation.failures import BadArgument, NoWorld, PlanFailure
from pycram.language.nesting import scope, sequential
from pycram.scheduling import cancellation
from pycram.scheduling.schedule import scheduler
from pycram.world.simulation import WorldClock
from recorder.records import STEPS_PER_SECOND
from recorder.tracing.span import Cancelled, span

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld


class TimedOut(PlanFailure):
    """A part of the plan missed its deadline."""

    def __init__(self, seconds: float, clock: str) -> None:
        super().__init__(f"not done within {seconds:g} s{' of simulated time' if clock == 'simulated' else ''}")
        self.seconds = seconds  # the time limit
        self.clock = clock  # "wall" or "simulated"


@scope
def timeout(seconds: float, *, simulated: bool = False) -> Iterator[None]:
    """Limit the time of the ``with`` block, in which actions run in order.

    Args:
        seconds: The limit in s; 0 or more.
        simulated: Whether to measure simulated time of the current world. Simulated time passes when all branches wait,
            and nothing but time can end a wait of the block.

    Raises:
        TimedOut: The block missed its deadline.
        BadArgument: The limit is negative, or isn't a number.
        NoWorld: There is no current world.
    """
    limit = number("seconds", seconds)
    if limit < 0:
        raise BadArgument("seconds", seconds, "a number from 0 up")
    clock = "simulated" if simulated else "wall"
    with sequential() as settle, (_simulated_deadline if simulated else cancellation.Deadline)(limit) as deadline:
        outer = cancellation.current_scope()
        cancel_scope = cancellation.CancelScope(outer, deadline)
        with span("timeout", f"{limit:g} s", {"seconds": limit, "clock": clock}) as task:
            try:
                with cancellation.entered(cancel_scope):
                    cancellation.raise_if_cancelled()
                    yield
                    settle()
                    if deadline.was_missed:  # motions aren't interrupted, and may end long after the deadline
                        raise Cancelled  # noqa: TRY301  as at a checkpoint
            except Cancelled as cancelled:
                if deadline.has_come and not (outer is not None and outer.is_cancelled):
                    task.checkpoint = 0 if simulated else cancel_scope.struck or scheduler().checkpoints
                    raise TimedOut(limit, clock) from cancelled
                raise


class _SimulatedDeadline(cancellation.Limit):
    def __init__(self, world: BulletWorld, seconds: float) -> None:
        super().__init__()
        self._world = world
        self.end = world.sim_step + round(cancellation.limited(seconds) * STEPS_PER_SECOND)
        self.clock = WorldClock(world, last=True)

    @property
    def has_come(self) -> bool:
        return self._world.sim_step >= self.end

    @property
    def was_missed(self) -> bool:
        return self._world.sim_step > self.end


@contextmanager
def _simulated_deadline(seconds: float) -> Iterator[cancellation.Limit]:
    from pycram.world.world import BulletWorld  # noqa: PLC0415  worlds don't know plans

    world = BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    deadline = _SimulatedDeadline(world, seconds)
    world.time_listeners[deadline.notify_all] = deadline.end
    try:
        yield deadline
    finally:
        world.time_listeners.pop(deadline.notify_all, None)
