"""How far a body has got on a trajectory that it follows: known from simulated steps alone, without physics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import STEPS_PER_SECOND

if TYPE_CHECKING:
    from recorder.records import Following

BASE_COORDINATES: Final = ("x", "y", "yaw")
"""Of the trajectory of a base: m, m and rad in the world frame."""

STOPPING_STEPS: Final = 36
"""In which a stopped trajectory slows down, 0.15 s; recordings are executed again with it, so it never changes."""


def time_of(following: Following, sim_step: int) -> float:
    """Return the trajectory's own time in s at a simulated step; it slows down evenly when it is stopped."""
    if not following.stopped or sim_step <= following.stopped:
        return (sim_step - following.began) / STEPS_PER_SECOND
    slowing = min(sim_step - following.stopped, STOPPING_STEPS)
    driven = following.stopped - following.began + slowing - slowing * slowing / (2 * STOPPING_STEPS)
    return driven / STEPS_PER_SECOND


def has_ended(following: Following, sim_step: int) -> bool:
    """Return whether a trajectory has come to its end by a simulated step, or stands since it was stopped."""
    if following.stopped and sim_step >= following.stopped + STOPPING_STEPS:
        return True
    times = following.begin.trajectory.times
    return bool(times) and sim_step > following.began and time_of(following, sim_step) >= times[-1]
