"""How fast the coordinates of a body may move: by its URDF, its description, or else by defaults."""

from __future__ import annotations

import math
import warnings
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.robots.description import MotionLimits
from pycram.planning.timing import Rates
from recorder.tracing.call_stack import call_site

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object

_DEFAULTS: Final = MotionLimits()
_OCTAGON: Final = math.cos(math.pi / 8)  # of a circle's radius that the sides of the octagon in it are away


class NoVelocityLimit(UserWarning):
    """Joints of a robot have no velocity limit in its URDF: they move as fast as its description says, or a default."""


def joint_rates(body: Object, joints: Sequence[str]) -> Rates:
    """Return the limits of some joints; warn once of a robot whose URDF has no velocities for them."""
    limits = body.description.limits if body.description else _DEFAULTS
    velocities, accelerations, unlimited = [], [], []
    for name in joints:
        joint = body.urdf.joint(name)
        slides = joint.type == "prismatic"
        velocity = joint.velocity
        if not 0 < velocity < math.inf:
            velocity = limits.sliding_velocity if slides else limits.turning_velocity
            unlimited.append(name)
        velocities.append(velocity)
        accelerations.append(limits.sliding_acceleration if slides else limits.turning_acceleration)
    if unlimited and body.is_robot:
        _warn(body.name, body.urdf.name, tuple(unlimited), limits)
    lower, upper = np.array([body.joint_limits(name) for name in joints]).reshape(-1, 2).T
    return Rates(lower, upper, np.eye(len(joints)), np.array(velocities), np.array(accelerations))


@cache
def _warn(name: str, robot: str, joints: tuple[str, ...], limits: MotionLimits) -> None:
    """Warn once in a process of joints of a robot."""
    text = (
        f"{name}: the URDF {robot!r} has no velocity limit for {', '.join(joints)}; they move with up to "
        f"{limits.turning_velocity:g} rad/s or {limits.sliding_velocity:g} m/s: a <limit velocity=...> there says "
        "otherwise, or [limits] turning_velocity and sliding_velocity in the robot's description"
    )
    warnings.warn_explicit(text, NoVelocityLimit, *call_site())


def base_rates(robot: Object) -> Rates:
    """Return the limits of a base's x, y and heading: its speed is limited in eight directions, and so in all."""
    limits = robot.description.limits if robot.description else _DEFAULTS
    half = math.sqrt(0.5)
    directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [half, half, 0.0], [half, -half, 0.0], [0.0, 0.0, 1.0]])
    velocities = np.array([_OCTAGON * limits.base_velocity] * 4 + [limits.base_turning_velocity])
    accelerations = np.array([_OCTAGON * limits.base_acceleration] * 4 + [limits.base_turning_acceleration])
    endless = np.full(3, math.inf)
    return Rates(-endless, endless, directions, velocities, accelerations)


def stacked(parts: Sequence[Rates]) -> Rates:
    """Return the limits of the columns of several bodies, one after the other."""
    rows, columns = (sum(part.directions.shape[axis] for part in parts) for axis in (0, 1))
    directions = np.zeros((rows, columns))
    row = column = 0
    for part in parts:
        height, width = part.directions.shape
        directions[row : row + height, column : column + width] = part.directions
        row, column = row + height, column + width
    return Rates(
        np.concatenate([part.lower for part in parts]),
        np.concatenate([part.upper for part in parts]),
        directions,
        np.concatenate([part.velocities for part in parts]),
        np.concatenate([part.accelerations for part in parts]),
    )
