"""Where a base can drive: on its ground, and upright."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import NotDrivable
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object
    from recorder.geometry import Quaternion

_UNEVEN: Final = 0.05  # m between the ground here and there
_TILT: Final = math.radians(2)


def drives(robot: Object) -> bool:
    """Return whether a robot's base drives; one without a description is taken to."""
    return robot.description is None or robot.description.drives


def check_drives(robot: Object, target: Sequence[float], orientation: Quaternion) -> None:
    """Check that a robot's base drives at all.

    Raises:
        NotDrivable: It is fixed.
    """
    if not drives(robot):
        raise NotDrivable(target, orientation, "its base is fixed")


def check_ground(robot: Object, target: Sequence[float], orientation: Quaternion) -> None:
    """Check that a pose is on the ground that a robot stands on.

    Raises:
        NotDrivable: Its wheels would leave the ground, or it would lean over.
    """
    position, heading = robot.get_position_and_orientation()
    height = target[2] - position[2]
    if abs(height) > _UNEVEN:
        side = "above" if height > 0 else "below"
        raise NotDrivable(target, orientation, f"its wheels would be {abs(height):.2f} m {side} the ground")
    lean = geometry.lean(orientation, heading)
    if lean > _TILT:
        raise NotDrivable(target, orientation, f"it would lean over by {math.degrees(lean):.0f} degrees")
