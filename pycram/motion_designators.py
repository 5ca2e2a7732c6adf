"""Typed constructors of motion designators: ``perform(pick_up(object=milk, arm="left"))``.

Written by ``make reference`` from the slots of the motions; don't edit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

from pycram.motions.designator import MotionDesignator
from pycram.motions.slots import filled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.actions import LocationDesignator, ObjectDesignator
    from pycram.reasoning.grasping.grasps import GraspSide
    from pycram.world.object import Object


def moving(
    *,
    target: Sequence[float] | LocationDesignator,
    orientation: Sequence[float] | None = None,
) -> MotionDesignator:
    """Moves the robot and the objects that it holds to a pose without collisions.

    Args:
        target: [x, y, z] in m, world frame.
        orientation: A quaternion [x, y, z, w], world frame; by default the robot's present orientation.
    """
    return MotionDesignator(filled("moving", **locals()))


def pick_up(
    *,
    object: Object | ObjectDesignator,
    arm: str | None = None,
    grasp: GraspSide | None = None,
    from_: str | None = None,
) -> MotionDesignator:
    """Moves the gripper to an object, closes the fingers on two sides of the object, and takes the object.

    Args:
        object: An Object of a world.
        arm: The name of an arm: "left" or "right" on the PR2; by default the only arm, or "left".
        grasp: The side from which the gripper approaches: "front", "top", "left" or "right"; by default the freest
            side.
        from_: Name of the arm that holds the object, and releases it to the other arm.
    """
    return MotionDesignator(filled("pick-up", **locals()))


def place(
    *,
    object: Object | ObjectDesignator,
    target: Sequence[float] | LocationDesignator,
    orientation: Sequence[float] | None = None,
    arm: str | None = None,
) -> MotionDesignator:
    """Puts a held object down on a support; without a given orientation, the object is upright.

    Args:
        object: An Object of a world.
        target: [x, y, z] in m, world frame.
        orientation: A quaternion [x, y, z, w], world frame; by default upright, in the best orientation for the arm.
        arm: The name of an arm: "left" or "right" on the PR2; by default the arm that holds the object; if no arm does,
            the only arm, or "left".
    """
    return MotionDesignator(filled("place", **locals()))


def accessing(
    *,
    drawer_joint: str,
    drawer_handle: str,
    part_of: Object | ObjectDesignator,
    arm: str | None = None,
    distance: float | None = None,
) -> MotionDesignator:
    """Opens or closes a drawer or door by its handle, up to a distance; a distance of 0 means closed.

    Args:
        drawer_joint: A name.
        drawer_handle: A name.
        part_of: An Object of a world.
        arm: The name of an arm: "left" or "right" on the PR2; by default the only arm, or "left".
        distance: A distance in m, or the angle of a door in rad; 0 or more; by default 0.3.
    """
    return MotionDesignator(filled("accessing", **locals()))


@overload
def looking(
    *,
    target: Sequence[float] | Object | LocationDesignator | ObjectDesignator,
    object: None = None,
) -> MotionDesignator: ...


@overload
def looking(
    *,
    object: Object | ObjectDesignator,
    target: None = None,
) -> MotionDesignator: ...


def looking(
    *,
    target: Sequence[float] | Object | LocationDesignator | ObjectDesignator | None = None,
    object: Object | ObjectDesignator | None = None,
) -> MotionDesignator:
    """Points the camera's axis at a point, or at the centre of an object.

    Exactly one of ``target`` or ``object`` is required.

    Args:
        target: [x, y, z] in m, world frame, or an Object: the middle of its bounds now.
        object: An Object of a world.
    """
    return MotionDesignator(filled("looking", **locals()))


def opening_gripper(
    *,
    gripper: str | None = None,
) -> MotionDesignator:
    """Opens or closes the gripper of an arm until something stops the fingers; opening releases a held object.

    Args:
        gripper: The name of an arm: "left" or "right" on the PR2; by default the only arm; required if the robot has
            several arms.
    """
    return MotionDesignator(filled("opening-gripper", **locals()))


def closing_gripper(
    *,
    gripper: str | None = None,
) -> MotionDesignator:
    """Opens or closes the gripper of an arm until something stops the fingers; opening releases a held object.

    Args:
        gripper: The name of an arm: "left" or "right" on the PR2; by default the only arm; required if the robot has
            several arms.
    """
    return MotionDesignator(filled("closing-gripper", **locals()))


def detecting(
    *,
    object_type: str | Object | ObjectDesignator,
) -> MotionDesignator:
    """Finds the most visible object of a type in the camera's present view; perform ``looking`` first.

    Args:
        object_type: A type of objects, or an object of that type.
    """
    return MotionDesignator(filled("detecting", **locals()))


def move_tcp(
    *,
    target: Sequence[float] | Object | LocationDesignator | ObjectDesignator,
    orientation: Sequence[float] | None = None,
    arm: str | None = None,
    level: bool | None = None,
) -> MotionDesignator:
    """Moves the tool frame of an arm to a position, and to the orientation if the plan gives one.

    Args:
        target: [x, y, z] in m, world frame, or an Object: the middle of its bounds now.
        orientation: A quaternion [x, y, z, w], world frame; by default any.
        arm: The name of an arm: "left" or "right" on the PR2; by default the only arm, or "left".
        level: Whether the held object stays level, within 15 degrees; by default false.
    """
    return MotionDesignator(filled("move-tcp", **locals()))


def move_arm_joints(
    *,
    arms: Mapping[str, str | Sequence[float]],
) -> MotionDesignator:
    """Moves arms to postures, given by names such as "park" or by joint values.

    Args:
        arms: For each name of an arm: a named posture such as "park", or a list of joint values in rad. Other arms
            don't move.
    """
    return MotionDesignator(filled("move-arm-joints", **{f"{arm}-arm": value for arm, value in arms.items()}))


def world_state_detecting(
    *,
    object_type: str | Object | ObjectDesignator,
) -> MotionDesignator:
    """Finds the nearest object of a type in the state of the world, even if the object is hidden.

    Args:
        object_type: A type of objects, or an object of that type.
    """
    return MotionDesignator(filled("world-state-detecting", **locals()))
