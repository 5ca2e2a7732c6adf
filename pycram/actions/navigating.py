"""Driving somewhere, with arms that don't stick out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.actions.action import action
from pycram.actions.performing import perform
from pycram.foundation.failures import NotDrivable
from pycram.motions.designator import MotionDesignator
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence


def _places(target: Any, orientation: Sequence[float] | None = None) -> Iterator[Mapping[str, Any]]:
    robot = BulletWorld.current_robot()
    if robot.description is not None and not robot.description.drives:
        raise NotDrivable(robot.get_position(), robot.get_orientation(), "its base is fixed")
    if not hasattr(target, "solutions"):
        yield {"target": target, "orientation": orientation or robot.get_orientation()}
        return
    for place in target.solutions():
        yield {"target": place["position"], "orientation": place.get("orientation") or robot.get_orientation()}


@action("navigating", choices=_places)
def navigating(target: Any, orientation: Sequence[float] | None = None) -> None:
    """Drives to a place.

    Args:
        target: A LocationDesignator for the robot, or [x, y, z] of its base in m, world frame.
        orientation: A quaternion [x, y, z, w] of its base, world frame; that of the place, else the present one.
    """
    perform(MotionDesignator(type="moving", target=target, orientation=orientation))
