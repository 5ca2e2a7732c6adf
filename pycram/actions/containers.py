"""Drawers and doors by their names, and from where their handles are moved, for opening and closing."""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.actions.performing import perform
from pycram.foundation.failures import AccessFailed, BadArgument, NoPlace, PlanFailure, UnknownName
from pycram.motions import slot_checks
from pycram.motions.designator import MotionDesignator
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping.handles import Handle
from pycram.reasoning.places import Pull, standing_places
from pycram.world import carried
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry.polygon import convex_hull, margin

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.motions.slot_checks import Check

_PLACES: Final = 3  # to stand at, that are tried for each width
_SAME: Final = (0.005, math.radians(0.5))  # m and rad within which the robot stands where it is to stand
_CLOSED: Final = 0.1  # m or rad up to which a hand doesn't get in, nor a look


@dataclass(frozen=True, slots=True)
class Access:
    """A drawer or door, and how it is moved.

    Attributes:
        name: what people call it.
        body: the furniture.
        joint: its joint.
        handle: link of its handle.
        closed: position of the joint when it is closed, rad or m.
        open: position of the joint when it is open as wide as it gets.
    """

    name: str
    body: Object
    joint: str
    handle: str
    closed: float
    open: float

    def __record__(self) -> object:
        """Return its name."""
        return self.name

    @property
    def position(self) -> float:
        """Position of the joint now, rad or m."""
        return self.body.get_joint_position(self.joint)

    @property
    def is_closed(self) -> bool:
        """Whether nothing gets in or out."""
        return abs(self.position - self.closed) < _CLOSED


def known_container(name: str, value: Any) -> Any:
    """A container of furniture, its name, or an Object, of which joint or handle say what is meant."""
    if isinstance(value, Object):
        return slot_checks.body(name, value)
    known = containers()
    for access, container in known:
        if value in (access.name, container):
            return access
    if isinstance(value, str):
        raise UnknownName("container", value, "the world", [access.name for access, _ in known])
    raise BadArgument(name, value, "a container, its name, or an Object")


#: Checks of the slots that opening and closing have.
CHECKS: Final[Mapping[str, Check]] = {
    "container": known_container,
    "joint": slot_checks.name,
    "handle": slot_checks.name,
    "distance": slot_checks.distance,
    "place": slot_checks.position,
}


def containers() -> list[tuple[Access, Any]]:
    """Return what furniture in the robot's world has, each with its container."""
    return [
        (Access(each.name, body, each.joint, each.handle, each.closed, each.open), each)
        for body in BulletWorld.current_robot().world.objects
        for each in body.containers.values()
    ]


def enclosing(body: Object) -> Any:
    """Return the closed container that an object stands or lies in; None if there is none."""
    return enclosing_at(center(body))


def enclosing_at(position: Sequence[float]) -> Any:
    """Return the closed container that a position in the world, m, is in; None if there is none."""
    x, y, z = position
    for access, container in containers():
        if not access.is_closed:
            continue
        for name in container.surfaces:
            surface = access.body.surfaces[name]
            u, v, above = geometry.transform(geometry.invert(access.body.surface_pose(surface)), (x, y, z))
            corners = convex_hull(np.array(surface.outline))
            if 0.0 <= above <= surface.clearance and margin(corners, (u, v)) >= 0.0:
                return container
    return None


def access_of(container: Access | Object, joint: str | None, handle: str | None) -> Access:
    """Return the drawer or door that is meant.

    Raises:
        BadArgument: Nothing says which one.
        UnknownName: There is no such joint or link.
    """
    if isinstance(container, Access):
        return container
    body = container
    meant = [
        access
        for access, _ in containers()
        if access.body is body and joint in (None, access.joint) and handle in (None, access.handle)
    ]
    if len(meant) == 1:
        return meant[0]
    if handle is not None and joint is None:
        body.check_link(handle)
        joint = next((name for name in body.joints if handle in carried.moved_links(body.urdf, [name])), None)
        if joint is None:
            raise BadArgument("handle", handle, f"a link of {body.name} that a joint moves")
    if joint is None or handle is None:
        names = ", ".join(access.name for access in meant) or "it has none"
        raise BadArgument("container", body.name, f"one of its containers, or also its joint and handle; {names}")
    return Access(handle, body, joint, handle, Handle(body, joint, handle).closed, body.joint_limits(joint)[1])


def choices(
    access: Access,
    arm: str | None,
    values: Sequence[float],
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Iterator[Mapping[str, Any]]:
    """Yield arms and places from which a handle can be held all the way, for the first of some values that it can be.

    Args:
        access: What is to be moved.
        arm: The arm; None for any.
        values: Of its joint, rad or m, the best first.
        place: Where the robot is to stand, m; None for where it reaches.
        orientation: Of its base there; the present one by default.

    Raises:
        AccessFailed: No arm is free.
        NoPlace: There is none for any.
    """
    robot = BulletWorld.current_robot()
    arms = _free_arms(robot, access, arm)
    if place is not None:
        for value, each in itertools.product(values, arms):
            yield _choice(access, each, value, place, orientation or robot.get_orientation())
        return
    failure: NoPlace | None = None
    found = False
    for value in values:
        pull = Pull(access.body, access.joint, access.handle, value)
        try:
            for spot in itertools.islice(standing_places(robot, reach=[pull], arms=arms), _PLACES):
                found = True
                for each in spot.arms:
                    yield _choice(access, each, value, spot.position, spot.orientation)
        except NoPlace as none:
            failure = failure or none
    if not found and failure is not None:
        raise failure


def _choice(
    access: Access, arm: str, value: float, place: Sequence[float], orientation: Sequence[float]
) -> Mapping[str, Any]:
    distance = abs(value - access.closed)
    return {"arm": arm, "distance": distance, "place": list(place), "orientation": list(orientation)}


def _free_arms(robot: Object, access: Access, wanted: str | None) -> list[str]:
    """Return the arms, or the one that is wanted, that have a gripper and hold nothing.

    Raises:
        AccessFailed: There are none.
    """
    arms = robot.description.arms.values() if robot.description else ()
    chosen = [arm for arm in arms if wanted in (None, arm.name) and arm.hand is not None]
    held = {each.carrier_link: each.body.name for each in robot.carried}
    free = [arm.name for arm in chosen if arm.tool_frame not in held]
    if not free:
        full = ", ".join(f"the {arm.name} gripper holds {held[arm.tool_frame]}" for arm in chosen)
        raise AccessFailed(access.joint, full or "the robot has no gripper for it", handle=access.handle)
    return free


def move(access: Access, arm: str, distance: float, place: Sequence[float], orientation: Sequence[float]) -> None:
    """Go somewhere, move a handle from there, and draw the arm back."""
    robot = BulletWorld.current_robot()
    position, turn = robot.get_position_and_orientation()
    if math.dist(position, place) > _SAME[0] or geometry.angle(turn, orientation) > _SAME[1]:
        perform(MotionDesignator(type="moving", target=place, orientation=orientation))
    perform(
        MotionDesignator(
            type="accessing",
            part_of=access.body,
            drawer_joint=access.joint,
            drawer_handle=access.handle,
            arm=arm,
            distance=distance,
        )
    )
    with suppress(PlanFailure):  # where the door itself is in the way of it, the arm stays
        perform(MotionDesignator([("type", "move-arm-joints"), (f"{arm}-arm", "park")]))
