"""Actions of the robot's hands: picking up, placing, and handing an object over to another hand."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from pycram.actions.action import action, place_for_an_object, portable
from pycram.actions.containers import containers, enclosing
from pycram.actions.locations import LocationDesignator
from pycram.actions.navigating import go
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.foundation.failures import Blocked, CollisionPair, MissingPart, NoPlace, PlaceFailed, ReasoningError
from pycram.models.robots.description import Arm
from pycram.motions.designator import MotionDesignator
from pycram.motions.slots import POINT
from pycram.reasoning.collision import checker
from pycram.reasoning.grasping import placing as settling
from pycram.reasoning.grasping.grasps import GraspSide
from pycram.reasoning.kinematics.inverse import postures
from pycram.reasoning.places.search import drives
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Pose, PoseLike


def arms() -> list[Arm]:
    """Return the arms of the current robot that have a gripper; raise MissingPart without such an arm."""
    robot = BulletWorld.current_robot()
    found = [] if robot.description is None else [arm for arm in robot.description.arms.values() if arm.hand]
    if not found:
        raise MissingPart(robot.name, "arm with a gripper")
    return found


def held_by(arm: Arm) -> Object | None:
    """Return the object that an arm of the current robot holds; None for an empty hand."""
    return attachment.attached_to(BulletWorld.current_robot(), arm.tool_frame)


def holder(body: Object) -> Arm | None:
    """Return the arm of the current robot that holds an object; None if no arm holds it."""
    return next((arm for arm in arms() if held_by(arm) is body), None)


def holding_arm(body: Object) -> Arm:
    """Return the arm of the current robot that holds an object; raise PlaceFailed if no arm holds it."""
    arm = holder(body)
    if arm is None:
        raise PlaceFailed(body.name, body.get_position(), f"{BulletWorld.current_robot().name} doesn't hold it")
    return arm


def free_arms(name: str | None = None) -> list[str]:
    """Return the names of the free arms, or of the arm ``name`` if free; raise ReasoningError if no arm is free."""
    wanted = [arm for arm in arms() if name is None or arm.name == name]
    found = [arm.name for arm in wanted if held_by(arm) is None]
    if not found:
        holding = ", ".join(f"the {arm.name} arm holds {held.name}" for arm in wanted if (held := held_by(arm)))
        raise ReasoningError(f"no arm is free: {holding or f'there is no {name} arm with a gripper'}")
    return found


_AHEAD: Final = (0.55, 0.45, 0.65)  # distance in m of the handover in front of the shoulders
_DOWN: Final = (0.2, 0.35, 0.05)  # distance in m of the handover below the shoulders
_TURNS: Final = (30, 60, 0, 90)  # turns of the giving hand towards the middle that are tried, in degrees
_EACH: Final = 4  # number of the giving hand's poses that are tried before the robot turns
_AWAY: Final = (180, 90, -90)  # turns of the robot away from obstacles that are tried, in degrees


def _choices(object: Any, arm: str | None = None) -> Iterator[Mapping[str, Any]]:  # noqa: A002  the slot's name
    """Yield poses of the giving hand, and the taking arm; in the last choices, the robot turns away from obstacles."""
    body = object_of(object)
    robot = BulletWorld.current_robot()
    giver = _giver(robot, body)
    takers = [each for each in arms() if each is not giver and arm in (None, each.name)]
    if arm == giver.name:
        raise ReasoningError(f"{body.name} can't be handed over to the {arm} arm, which holds it")
    if not takers:
        raise MissingPart(robot.name, "other arm with a gripper" if arm is None else f"gripper of the {arm} arm")
    if all(held_by(each) is not None for each in takers):
        holding = ", ".join(f"the {each.name} arm holds {held.name}" for each in takers if (held := held_by(each)))
        raise ReasoningError(f"{body.name} can't be handed over: no other arm is free: {holding}")
    takers = [each for each in takers if held_by(each) is None]
    here = robot.get_position_and_orientation()
    turned = list(_turned(robot, here))
    blocked: list[Blocked] = []
    found = False
    for place in (None, *turned):
        goes_to = None if place is None else LocationDesignator(position=place[0], orientation=place[1])
        for taker in takers:
            for pose in itertools.islice(_free_poses(robot, giver, taker, place, blocked), _EACH if turned else None):
                position, turn = geometry.multiply(place or here, pose)
                found = True
                yield {"arm": taker.name, "target": list(position), "orientation": list(turn), "place": goes_to}
    if blocked and not found:
        raise blocked[0]


@action("handing-over", choices=_choices, checked={"target": POINT})
def handing_over(
    object: Any,  # noqa: A002  the slot's name
    arm: str | None = None,
    target: Sequence[float] | Object | None = None,
    orientation: Sequence[float] | None = None,
    place: Any = None,
) -> Object:
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
    """
    body = object_of(object)
    giver = _giver(BulletWorld.current_robot(), body)
    go(place)
    perform(MotionDesignator(type="move-tcp", arm=giver.name, target=target, orientation=orientation))
    perform(MotionDesignator([("type", "pick-up"), ("object", body), ("arm", arm), ("from", giver.name)]))
    return body


def _giver(robot: Object, body: Object) -> Arm:
    for arm in robot.description.arms.values() if robot.description else ():
        if any(held.body is body and held.carrier_link == arm.tool_frame for held in robot.carried):
            return arm
    raise ReasoningError(f"{body.name} can't be handed over: no hand of {robot.name} holds it")


def _turned(robot: Object, here: PoseLike) -> Iterator[Pose]:
    """Yield collision-free poses of the robot after turns at its place."""
    for degrees in _AWAY if drives(robot) else ():
        place = geometry.multiply(here, ((0.0, 0.0, 0.0), geometry.from_rpy(0.0, 0.0, math.radians(degrees))))
        with robot.world.lock:
            free = not checker.touched(robot, {}, place, all_links=True)
        if free:
            yield place


def _free_poses(robot: Object, giver: Arm, taker: Arm, place: Pose | None, blocked: list[Blocked]) -> Iterator[Pose]:
    """Yield collision-free poses of the giving hand in the robot's frame, with the robot at ``place``.

    Other poses add their obstacles to ``blocked``. A place of None is the robot's present place.
    """
    base = geometry.invert(robot.get_position_and_orientation())
    shoulders = [robot.get_link_position(robot.urdf.joint(arm.joints[0]).child) for arm in (giver, taker)]
    (x, y, z), (u, v, w) = (geometry.transform(base, shoulder) for shoulder in shoulders)
    middle, inward = ((x + u) / 2, (y + v) / 2, (z + w) / 2), 1 if y < v else -1
    for down, ahead, degrees in itertools.product(_DOWN, _AHEAD, _TURNS):
        turn = geometry.from_rpy(0.0, 0.0, math.radians(inward * degrees))
        pose = (middle[0] + ahead, middle[1], middle[2] - down), turn
        target = geometry.multiply(robot.get_position_and_orientation(), pose)
        pairs: Sequence[CollisionPair] = ()
        for posture in postures(robot, giver.tool_frame, *target, quick=True):
            if posture.reaches():
                with robot.world.lock:
                    pairs = checker.newly_touched(robot, posture.positions, place)
                if not pairs:
                    yield pose
                    break
        if pairs:
            blocked.append(Blocked(giver.name, target[0], pairs))


@action("picking-up", choices=lambda arm=None: ({"arm": each} for each in free_arms(arm)), checked={"object": portable})
def picking_up(object: Any, arm: str | None = None, grasp: GraspSide | None = None) -> Any:  # noqa: A002  the slot's name
    """Takes an object with a gripper, without driving.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper approaches: "front", "top", "left" or "right"; by default the freest
            side.
    """
    return perform(MotionDesignator(type="pick-up", object=object_of(object), arm=arm, grasp=grasp))


_UPRIGHT: Final = [geometry.from_rpy(0.0, 0.0, step * math.pi / 6) for step in range(12)]


def places_for(body: Object, target: Any, arm: Arm | None = None) -> Iterator[Mapping[str, Any]]:
    """Yield ``position`` and ``orientation`` of an object at places of a target, the value of the slot ``target``.

    If an orientation is None, any orientation is allowed. ``arm`` is the arm that must reach the place; None for any.
    """
    if not isinstance(target, LocationDesignator):
        yield {"position": target, "orientation": None}
        return
    wanted = target.prop_value("orientation")  # other orientations are also possible
    if target.for_objects:
        reached = [] if arm is None else [("reachable-for", BulletWorld.current_robot()), ("arm", arm.name)]
        target = target.copy([("for", body), *reached])
    for place in target.solutions():
        yield {"position": place["position"], "orientation": wanted}
        if arm is not None and held_by(arm) is not body:
            return  # the object was put down, but at a wrong place


def check_target(body: Object, target: Any) -> None:
    """Check that a target has room for an object, before anything moves; raise NoPlace or PlaceFailed without room."""
    closed = _closed_at(target)
    place: Mapping[str, Any] = {}
    try:
        place = next(places_for(body, target))
    except NoPlace as failure:
        if not closed or failure.last != "room":  # a closed container never has room
            raise
    if closed:
        last = f"{' and '.join(closed)}, which {'is' if len(closed) == 1 else 'are'} closed: open it first"
        raise NoPlace(body.name, {}, last)
    if isinstance(target, LocationDesignator) and target.for_objects:
        return  # the search for places has checked the room
    turns = [place["orientation"]] if place["orientation"] is not None else _UPRIGHT
    for turn in turns[:-1]:
        with suppress(PlaceFailed):
            settling.resting_position(body, place["position"], turn)
            return
    settling.resting_position(body, place["position"], turns[-1])


def _closed_at(target: Any) -> list[str]:
    if not isinstance(target, LocationDesignator) or not target.for_objects:
        container = enclosing(target.reference()["position"] if isinstance(target, LocationDesignator) else target)
        return [] if container is None else [container.name]
    owners = {(body, surface.container) for body, surface in target.surfaces()}
    if any(not name for _, name in owners):
        return []  # at least one surface isn't in a container
    return [access.name for access, _ in containers() if access.is_closed and (access.body, access.name) in owners]


def _places(object: Any, target: Any, orientation: Sequence[float] | None = None) -> Iterator[Mapping[str, Any]]:  # noqa: A002
    body = object_of(object)
    for place in places_for(body, target, holding_arm(body)):
        yield {"target": place["position"], "orientation": orientation or place["orientation"]}


@action("placing", choices=_places, checked={"target": place_for_an_object})
def placing(object: Any, target: Any, orientation: Sequence[float] | None = None) -> Any:  # noqa: A002  the slot's name
    """Puts down an object that a hand holds, without driving.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        target: A LocationDesignator, the name of a surface, an Object to put it on, or [x, y, z] in m, world frame.
        orientation: Orientation of the object, a quaternion [x, y, z, w] in the world frame; by default upright.
    """
    body = object_of(object)
    perform(MotionDesignator(type="place", object=body, target=target, orientation=orientation))
    return body
