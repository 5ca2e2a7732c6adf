"""Driving somewhere."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import action
from pycram.actions.checks import place_for_the_robot
from pycram.actions.locations import LocationDesignator
from pycram.actions.performing import perform
from pycram.foundation import checks
from pycram.motions.designator import MotionDesignator
from pycram.reasoning.driving import check_drives
from pycram.world.world import BulletWorld
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

_THERE: Final = (1e-3, 1e-3)  # m and rad within which the robot is where it is to be


def _places(target: Any, orientation: Sequence[float] | None = None) -> Iterator[Mapping[str, Any]]:
    robot = BulletWorld.current_robot()
    here = robot.get_orientation()
    there = robot.get_position() if isinstance(target, LocationDesignator) else target
    check_drives(robot, there, checks.quaternion("orientation", orientation or here))
    if not isinstance(target, LocationDesignator):
        yield {"target": target, "orientation": orientation or here}
        return
    for place in target.solutions():
        yield {"target": place["position"], "orientation": orientation or place["orientation"] or here}


@action("navigating", choices=_places, checked={"target": place_for_the_robot})
def navigating(target: Any, orientation: Sequence[float] | None = None) -> None:
    """Drives to a place, unless the robot is there.

    Args:
        target: A LocationDesignator for the robot, or [x, y, z] of its base in m, world frame.
        orientation: A quaternion [x, y, z, w] of its base, world frame; that of the place, else the present one.
    """
    position, turn = BulletWorld.current_robot().get_position_and_orientation()
    there = orientation is None or geometry.angle(turn, orientation) < _THERE[1]
    if there and math.dist(position, target) < _THERE[0]:
        return
    perform(MotionDesignator(type="moving", target=target, orientation=orientation))
