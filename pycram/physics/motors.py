"""The motors of joints: with which force they hold a robot, whatever it weighs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pycram.physics.body import Joint
    from recorder.geometry import Vector

GAIN: Final = 0.1
"""Share of a joint's error that motors correct in a step that aren't a robot's: PyBullet's own."""

#: Least forces (N, N m) with which joints keep their position. With less than 1e4 the PR2's torso sinks.
_LEAST: Final = {"revolute": 500.0, "prismatic": 1e4}
_GRAVITY: Final = 9.81  # m/s^2, of the ground on which robots' motors are to bear what hangs on them


class Load(NamedTuple):
    """A link that hangs on a joint.

    Attributes:
        parent: index of the joint before, -1 for none; joints come after those that they hang on.
        place: of the joint in the world, with all joints at 0, m.
        mass: of the link, kg.
        lever: from the joint to the link's centre of mass, m.
    """

    parent: int
    place: Vector
    mass: float
    lever: float


def least_forces(joints: Collection[Joint]) -> dict[str, float]:
    """Return the forces (N, N m) that the motors of all bodies' joints have, by joint."""
    return {joint.name: _LEAST[joint.kind] for joint in joints}


def holding_forces(joints: Collection[Joint], loads: Sequence[Load], strength: float) -> dict[str, float]:
    """Return the forces (N, N m) of motors that bear what hangs on a robot's joints, by joint; the least, or more.

    Args:
        joints: those that have motors.
        loads: of all joints, also fixed ones, by index.
        strength: how many times the most that gravity may pull in any posture they hold.
    """
    slides = [joint for joint in joints if joint.kind == "prismatic" and math.isfinite(joint.upper - joint.lower)]
    travels = {joint.index: max(abs(joint.lower), abs(joint.upper)) for joint in slides}
    weights = [_GRAVITY * load.mass for load in loads]  # of all that hangs on each joint
    torques = [_GRAVITY * load.mass * load.lever for load in loads]
    for index in reversed(range(len(loads))):
        load = loads[index]
        if load.parent >= 0:
            lever = math.dist(load.place, loads[load.parent].place) + travels.get(index, 0.0)
            weights[load.parent] += weights[index]
            torques[load.parent] += torques[index] + weights[index] * lever
    pulls = {"prismatic": weights, "revolute": torques}
    least = least_forces(joints)
    return {joint.name: max(least[joint.name], strength * pulls[joint.kind][joint.index]) for joint in joints}
