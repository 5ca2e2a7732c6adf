"""Trajectories made by hand, for tests of what follows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.world.driving import follow
from pycram.world.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.bullet_world import Object
    from recorder.records import PathSearch

ROWS = 12


@dataclass
class Given:
    """A motion that is only timed."""

    trajectory: Trajectory
    search: PathSearch | None = None


def smooth(joints: Sequence[str], start: Sequence[float], goal: Sequence[float], duration: float) -> Trajectory:
    """A straight line between two postures, or poses of the base, from rest to rest with continuous accelerations."""
    shares = [row / ROWS for row in range(ROWS + 1)]
    ways = [u**3 * (10 - 15 * u + 6 * u**2) for u in shares]
    speeds = [30 * u**2 * (1 - u) ** 2 / duration for u in shares]
    return Trajectory(
        tuple(joints),
        tuple(duration * u for u in shares),
        tuple(tuple(a + (b - a) * way for a, b in zip(start, goal, strict=True)) for way in ways),
        tuple(tuple((b - a) * speed for a, b in zip(start, goal, strict=True)) for speed in speeds),
    )


def to(body: Object, goal: Mapping[str, float], duration: float) -> Trajectory:
    """From where joints are to a posture."""
    return smooth(tuple(goal), [body.get_joint_position(name) for name in goal], list(goal.values()), duration)


def move(body: Object, goal: Mapping[str, float], duration: float) -> None:
    """Move joints there, and wait until that is done."""
    follow(body.world, [(body, Given(to(body, goal, duration)))])


def drive(body: Object, start: Sequence[float], goal: Sequence[float], duration: float) -> None:
    """Move the base from a pose (x, y, yaw) to another, and wait until that is done."""
    follow(body.world, [(body, Given(smooth((), start, goal, duration)))])
