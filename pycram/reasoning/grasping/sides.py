"""The sides from which a gripper takes an object, as seen by the robot: "front" is the side that faces it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import UnknownName
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion

GRASPS: Final[Mapping[str, Quaternion]] = {
    "front": (0.0, 0.0, 0.0, 1.0),
    "top": geometry.from_rpy(0.0, math.pi / 2, 0.0),
    "left": geometry.from_rpy(0.0, 0.0, -math.pi / 2),  # from the robot's left side to its right
    "right": geometry.from_rpy(0.0, 0.0, math.pi / 2),
}
"""Tool orientations in a frame that has the robot's heading."""


def grasp_orientation(grasp: str, robot: Object, base: Pose | None = None) -> Quaternion:
    """Return the orientation of the tool for a grasp, in the world.

    Args:
        grasp: "front", "top", "left" or "right".
        robot: whose heading says what is front.
        base: pose that its base is taken to have.

    Raises:
        UnknownName: another grasp.
    """
    if checks.text("grasp", grasp) not in GRASPS:
        raise UnknownName("grasp", grasp, "a gripper", GRASPS)
    return geometry.product(heading(robot, base), GRASPS[grasp])


def heading(robot: Object, base: Pose | None = None) -> Quaternion:
    """Return a robot's orientation about the vertical, as it stands or with its base at another pose."""
    return geometry.from_rpy(0.0, 0.0, yaw(robot) if base is None else yaw_of(base[1]))


def yaw(body: Object) -> float:
    """Return the angle about the vertical by which an object's x axis is turned, rad."""
    return yaw_of(body.get_orientation())


def yaw_of(orientation: Sequence[float]) -> float:
    """Return the angle about the vertical by which an orientation turns the x axis, rad."""
    x, y, _ = geometry.rotate(orientation, (1.0, 0.0, 0.0))
    return math.atan2(y, x)
