"""The actions navigating and parking-arms: driving to a place, and folding the arms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from pycram.actions.action import ActionDesignator, action, place_for_the_robot
from pycram.actions.locations import LocationDesignator
from pycram.actions.performing import perform
from pycram.foundation import checks
from pycram.foundation.failures import NoPath, PlanFailure, PostureInCollision
from pycram.models.robots.description import Arm
from pycram.motions.designator import MotionDesignator
from pycram.motions.execution import level
from pycram.reasoning.places.search import check_drives
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry

_THERE: Final = (1e-3, 1e-3)  # maximum distance in m and rad of a robot from its place
_CARRIED: Final = ((0.5, 0.1, 0.0), (0.5, -0.1, 0.0), (0.6, 0.0, 0.0), (0.6, 0.0, -0.2))  # from the shoulder, m
_PARKED: Final = 0.01  # maximum deviation in rad or m of a joint of a parked arm


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
    """Drives the robot to a place, unless it is already at this place.

    Args:
        target: A LocationDesignator for the robot, or the position [x, y, z] of its base in m, world frame.
        orientation: Orientation of the base, a quaternion [x, y, z, w] in the world frame; by default the
            orientation of the place, else unchanged.
    """
    position, turn = BulletWorld.current_robot().get_position_and_orientation()
    there = orientation is None or geometry.angle(turn, orientation) < _THERE[1]
    if there and math.dist(position, target) < _THERE[0]:
        return
    perform(MotionDesignator(type="moving", target=target, orientation=orientation))


def go(place: LocationDesignator | None) -> None:
    """Fold the arms and drive to a place, if ``place`` isn't None and the robot can drive."""
    description = BulletWorld.current_robot().description
    if place is not None and description is not None and description.drives:
        park()
        perform(ActionDesignator(type="navigating", target=place))


def park() -> None:
    """Fold the arms; ignore a failure."""
    with suppress(PlanFailure):
        perform(ActionDesignator(type="parking-arms"))


@action("parking-arms")
def parking_arms(arm: str | None = None) -> None:
    """Folds the arms, if possible at the same time; held objects move along.

    In an environment with ``level``, an arm that holds an object isn't folded: the arm moves back, and keeps the object
    upright.

    Args:
        arm: Name of the arm; by default all arms.
    """
    robot = BulletWorld.current_robot()
    arms = robot.description.arms.values() if robot.description else ()
    every = [each for each in arms if arm in (None, each.name) and "park" in each.poses]
    for each in every:
        if level(robot, each):
            _carry(robot, each)
    now = robot.get_joint_positions()
    open_ = [
        each.name
        for each in every
        if not level(robot, each)
        and any(abs(now[joint] - value) >= _PARKED for joint, value in each.posture("park").items())
    ]
    if not open_:
        return
    try:
        perform(MotionDesignator([("type", "move-arm-joints"), *((f"{name}-arm", "park") for name in open_)]))
    except (PostureInCollision, NoPath):
        if len(open_) == 1:
            raise
        for name in open_:
            perform(MotionDesignator([("type", "move-arm-joints"), (f"{name}-arm", "park")]))


def _carry(robot: Object, arm: Arm) -> None:
    """Move the hand of an arm back to a point before the shoulder, with the held object upright; ignore a failure."""
    shoulder = robot.urdf.forward_kinematics(robot.get_joint_positions(), robot.urdf.joint(arm.joints[0]).child)[0]
    base = robot.get_position_and_orientation()
    places = [geometry.transform(geometry.multiply(base, (shoulder, geometry.IDENTITY[1])), each) for each in _CARRIED]
    here = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))[0]
    if min(math.dist(here, place) for place in places) < _THERE[0]:
        return
    for place in places:
        with suppress(PlanFailure):
            perform(MotionDesignator(type="move-tcp", arm=arm.name, target=place, level=True))
            return
