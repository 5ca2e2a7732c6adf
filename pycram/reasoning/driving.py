"""The ground of a base: a base drives on it, upright."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import NotDrivable
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object
    from recorder.geometry import Quaternion

_UNEVEN: Final = 0.05  # m of height on the ground
_TILT: Final = math.radians(2)


def drives(robot: Object) -> bool:
    """Return whether a robot's base drives; a robot without a description is assumed to drive."""
    return robot.description is None or robot.description.drives


def check_drives(robot: Object, target: Sequence[float], orientation: Quaternion) -> None:
    """Check that a robot's base drives.

    Raises:
        NotDrivable: It is fixed.
    """
    if not drives(robot):
        raise NotDrivable(target, orientation, "its base is fixed")


def check_ground(robot: Object, target: Sequence[float], orientation: Quaternion) -> None:
    """Check that a pose is on the ground on which a robot stands.

    Raises:
        NotDrivable: The wheels would leave the ground, or the robot would lean over.
    """
    position, heading = robot.get_position_and_orientation()
    height = target[2] - position[2]
    if abs(height) > _UNEVEN:
        side = "above" if height > 0 else "below"
        raise NotDrivable(target, orientation, f"its wheels would be {abs(height):.2f} m {side} the ground")
    lean = geometry.lean(orientation, heading)
    if lean > _TILT:
        raise NotDrivable(target, orientation, f"it would lean over by {math.degrees(lean):.0f} degrees")
