"""Typed constructors of action designators: ``perform(transporting(object=milk, target="island"))``.

Written by ``make reference`` from the slots of the actions; don't edit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

from pycram.actions.action import ActionDesignator
from pycram.motions.slots import filled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.actions import LocationDesignator, ObjectDesignator
    from pycram.models.surfaces import Container, Surface
    from pycram.reasoning.grasping.grasps import GraspSide
    from pycram.world.object import Object


def closing(
    *,
    container: Container | Object | str,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Closes a drawer or door by its handle.

    Args:
        container: A container such as a drawer, its name, or the whole furniture.
        joint: Name of the container's joint, if ``container`` is the furniture.
        handle: Link of the container's handle, if ``container`` is the furniture.
        arm: Name of the arm; by default any arm within reach.
        place: Place of the robot's base, [x, y, z] in m; by default a place from which the arm can move the handle.
        orientation: Orientation of the robot's base at that place, a quaternion [x, y, z, w].
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("closing", **locals()))


def delivering(
    *,
    object: Object | ObjectDesignator | str,
    target: LocationDesignator | Surface | Object | str | Sequence[float],
    put: LocationDesignator | None = None,
    place: LocationDesignator | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Drives to a place within reach of a target, puts down an object that a hand holds, and folds the arms.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        target: A LocationDesignator, the name of a surface, an Object to put it on, or [x, y, z] in m, world frame.
        put: Exact place of the object, a LocationDesignator with a position; by default places of the target.
        place: Place of the robot, a LocationDesignator; by default places within reach of the target.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("delivering", **locals()))


def fetching(
    *,
    object: Object | ObjectDesignator | str,
    arm: str | None = None,
    grasp: GraspSide | None = None,
    place: LocationDesignator | None = None,
    clear: bool | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Drives to a place within reach of an object, and takes the object; moves obstacles, opens drawers and doors.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper approaches: "front", "top", "left" or "right"; by default the freest
            side.
        place: Place of the robot, a LocationDesignator; by default places within reach of the object.
        clear: Whether to clear obstacles away first; by default only after they caused a failure. Without a place, this
            also closes drawers and doors beside the object, and opens the object's own as far as possible.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("fetching", **locals()))


def handing_over(
    *,
    object: Object | ObjectDesignator | str,
    arm: str | None = None,
    target: Sequence[float] | Object | None = None,
    orientation: Sequence[float] | None = None,
    place: LocationDesignator | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Passes an object from one hand to another hand, in front of the robot, and returns the object.

    The second hand grasps the object beside the first hand; then the first hand releases the object. If the robot
    doesn't hold the object, or has no other gripper, the action fails before anything moves.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        arm: Name of the arm that takes the object; by default any other arm.
        target: Place of the giving hand's tool, [x, y, z] in m, or an Object (its middle); by default a place that both
            arms reach.
        orientation: Orientation of the giving hand's tool at that place, a quaternion [x, y, z, w].
        place: Place of the robot, a LocationDesignator; by default its present place, if necessary turned away from
            obstacles.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("handing-over", **locals()))


@overload
def looking(
    *,
    object: Object | ObjectDesignator | str,
    target: None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator: ...


@overload
def looking(
    *,
    target: LocationDesignator | Surface | Object | str | Sequence[float],
    object: None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator: ...


def looking(
    *,
    object: Object | ObjectDesignator | str | None = None,
    target: LocationDesignator | Surface | Object | str | Sequence[float] | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Turns the camera to an object, or to a place.

    Exactly one of ``object`` or ``target`` is required.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        target: A LocationDesignator, the name of a surface (to its middle), an Object, or [x, y, z] in m, world frame.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("looking", **locals()))


def navigating(
    *,
    target: LocationDesignator | Sequence[float],
    orientation: Sequence[float] | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Drives the robot to a place, unless it is already at this place.

    Args:
        target: A LocationDesignator for the robot, or the position [x, y, z] of its base in m, world frame.
        orientation: Orientation of the base, a quaternion [x, y, z, w] in the world frame; by default the orientation
            of the place, else unchanged.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("navigating", **locals()))


def opening(
    *,
    container: Container | Object | str,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    distance: float | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Opens a drawer or door by its handle; returns the name of the arm.

    Args:
        container: A container such as a drawer, its name, or the whole furniture.
        joint: Name of the container's joint, if ``container`` is the furniture.
        handle: Link of the container's handle, if ``container`` is the furniture.
        arm: Name of the arm; by default any arm within reach.
        distance: Width of a drawer in m, or angle of a door in rad; by default 0.4 m or 1.2 rad, or at least half of
            that.
        place: Place of the robot's base, [x, y, z] in m; by default a place from which the arm can move the handle.
        orientation: Orientation of the robot's base at that place, a quaternion [x, y, z, w].
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("opening", **locals()))


def parking_arms(
    *,
    arm: str | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Folds the arms, if possible at the same time; held objects move along.

    In an environment with ``level``, an arm that holds an object isn't folded: the arm moves back, and keeps the object
    upright.

    Args:
        arm: Name of the arm; by default all arms.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("parking-arms", **locals()))


def perceiving(
    *,
    object: Object | ObjectDesignator | str,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Turns the camera to the believed place of an object, detects the object and returns it.

    Without a belief, the action detects the object in the present view. Without a camera, the action uses the state of
    the world. The action fails with PerceptionError if the robot doesn't see the object.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("perceiving", **locals()))


def picking_up(
    *,
    object: Object | ObjectDesignator | str,
    arm: str | None = None,
    grasp: GraspSide | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Takes an object with a gripper, without driving.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper approaches: "front", "top", "left" or "right"; by default the freest
            side.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("picking-up", **locals()))


def placing(
    *,
    object: Object | ObjectDesignator | str,
    target: LocationDesignator | Surface | Object | str | Sequence[float],
    orientation: Sequence[float] | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Puts down an object that a hand holds, without driving.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        target: A LocationDesignator, the name of a surface, an Object to put it on, or [x, y, z] in m, world frame.
        orientation: Orientation of the object, a quaternion [x, y, z, w] in the world frame; by default upright.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("placing", **locals()))


def searching(
    *,
    object: Object | ObjectDesignator | str,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Searches for an object until the camera sees it, and returns the object.

    The search begins at the believed place of the object. Next, the robot looks at all surfaces, the nearest first:
    from its present place, then from places near the surfaces. Finally, the robot opens closed drawers and doors,
    looks inside, and closes them. If the robot finds no object, the action fails with ObjectNotFound, which has the
    searched places. A robot without a camera uses the state of the world.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("searching", **locals()))


def transporting(
    *,
    object: Object | ObjectDesignator | str,
    target: LocationDesignator | Surface | Object | str | Sequence[float],
    arm: str | None = None,
    grasp: GraspSide | None = None,
    place: LocationDesignator | None = None,
    clear: bool | None = None,
    close: bool | None = None,
    budget: int | None = None,
    projected: bool | None = None,
) -> ActionDesignator:
    """Fetches an object and delivers it; opens the drawer or door of the object, and closes it at the end.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        target: New place of the object: a LocationDesignator, the name of a surface, an Object to put it on, or [x, y,
            z] in m, world frame, with a support as for the motion ``place``.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper approaches: "front", "top", "left" or "right"; by default the freest
            side.
        place: Place of the robot while it takes the object, a LocationDesignator; by default places within reach.
        clear: Whether to clear obstacles away first.
        close: Whether to close opened drawers and doors at the end, if possible.
        budget: Number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget.
        projected: Whether to try the best choices in projections first; False by default.
    """
    return ActionDesignator(filled("transporting", **locals()))
