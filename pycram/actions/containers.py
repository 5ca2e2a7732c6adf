"""The actions opening and closing, for drawers and doors with handles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from pycram.actions.action import ActionDesignator, action
from pycram.actions.performing import perform
from pycram.foundation.failures import AccessFailed, BadArgument, NoPlace, PlanFailure, UnknownName
from pycram.motions.designator import MotionDesignator
from pycram.motions.slots import BODY, DISTANCE, NAME, POSITION, Check, ValueKind
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping.handles import Handle
from pycram.reasoning.places import Pull, standing_places
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import convex_hull, margin_in_polygon

_PLACES: Final = 3  # number of places of the robot that are tried for each width of opening
_SAME: Final = (0.005, math.radians(0.5))  # maximum distance in m and rad of a robot from its place
_BESIDE: Final = 1.3  # maximum distance in m from an object to the handle of an open container that is in the way
_TRIES: Final = 4  # failed tries to move a drawer or door that is in the way
_CLOSED: Final = 0.1  # maximum position in m or rad of a closed drawer or door


@dataclass(frozen=True, slots=True)
class Access:
    """A drawer or door, with its joint and handle."""

    name: str
    body: Object  # the furniture with the drawer or door
    joint: str
    handle: str  # link of the handle
    closed: float  # position of the joint when closed, rad or m
    open: float  # position of the joint when fully open, rad or m

    def __record__(self) -> object:
        """Return the name of the drawer or door."""
        return self.name

    @property
    def position(self) -> float:
        """Position of the joint now, in rad or m."""
        return self.body.get_joint_position(self.joint)

    @property
    def is_closed(self) -> bool:
        """Whether the drawer or door is too little open for a hand, or for a view inside."""
        return abs(self.position - self.closed) < _CLOSED


def _known_container(name: str, value: Any) -> Any:
    """Return the Access for a container or for its name; an Object is only checked, and returned unchanged."""
    if isinstance(value, Object):
        return BODY(name, value)
    known = containers()
    for access, container in known:
        if value in (access.name, container):
            return access
    if isinstance(value, str):
        raise UnknownName("container", value, "the world", [access.name for access, _ in known])
    raise BadArgument(name, value, "a container, its name, or an Object")


_CHECKS: Final[Mapping[str, Check]] = {
    "container": ValueKind("A container of furniture", _known_container, "Container | Object | str"),
    "joint": NAME,
    "handle": NAME,
    "distance": DISTANCE,
    "place": POSITION,
}


def containers() -> list[tuple[Access, Any]]:
    """Return the drawers and doors of the robot's world, and their containers."""
    return [
        (Access(each.name, body, each.joint, each.handle, each.closed, each.open), each)
        for body in BulletWorld.current_robot().world.objects
        for each in body.containers.values()
    ]


def enclosing(position: Sequence[float]) -> Any:
    """Return the closed container around a position in the world frame, m; None without such a container."""
    return next((each for access, each in containers() if access.is_closed and _holds(access, each, position)), None)


def _holds(access: Access, container: Any, position: Sequence[float]) -> bool:
    """Return whether a position in the world frame, m, is in a container."""
    x, y, z = position
    for name in container.surfaces:
        surface = access.body.surfaces[name]
        u, v, above = geometry.transform(geometry.invert(access.body.surface_pose(surface)), (x, y, z))
        corners = convex_hull(np.array(surface.outline))
        if 0.0 <= above <= surface.clearance and margin_in_polygon(corners, (u, v)) >= 0.0:
            return True
    return False


def making_room(body: Object) -> list[ActionDesignator]:
    """Return actions that make room for a robot near an object, ordered by the distance of the handles.

    These actions open the object's own drawer or door as far as possible, and close other drawers and doors beside it.
    """
    position = center(body)
    found: list[tuple[float, ActionDesignator]] = []
    for access, container in containers():
        wide, name = abs(access.open - access.closed), access.name
        away = math.dist(access.body.get_link_position(access.handle)[:2], position[:2])
        if access.is_closed:
            continue
        if _holds(access, container, position):
            if wide - abs(access.position - access.closed) > _CLOSED:
                opened = ActionDesignator(type="opening", container=name, distance=wide, budget=_TRIES)
                found.append((away, opened))
        elif away < _BESIDE:
            found.append((away, ActionDesignator(type="closing", container=name, budget=_TRIES)))
    return [designator for _, designator in sorted(found, key=lambda each: each[0])]


def _access_of(container: Access | Object, joint: str | None, handle: str | None) -> Access:
    """Return the drawer or door that the slots describe; raise BadArgument for ambiguous slots."""
    if isinstance(container, Access):
        return container
    body = container
    own = [access for access, _ in containers() if access.body is body]
    meant = [each for each in own if joint in (None, each.joint) and handle in (None, each.handle)]
    if len(meant) == 1:
        return meant[0]
    if handle is not None and joint is None:
        body.check_link(handle)
        joint = next((name for name in body.joints if handle in attachment.moved_links(body.urdf, [name])), None)
        if joint is None:
            raise BadArgument("handle", handle, f"a link of {body.name} that a joint moves")
    if joint is None or handle is None:
        names = ", ".join(access.name for access in meant) or "none"
        expected = f"a container of {body.name} ({names}), or also the slots 'joint' and 'handle'"
        raise BadArgument("container", body.name, expected)
    return Access(handle, body, joint, handle, Handle(body, joint, handle).closed, body.joint_limits(joint)[1])


def _handle_choices(
    access: Access,
    arm: str | None,
    values: Sequence[float],
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Iterator[Mapping[str, Any]]:
    """Yield arms and places from which a handle can be held during its whole motion.

    ``values`` has goal positions of the joint, rad or m, the best first. If ``place`` is None, places are searched.
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
    return {"arm": arm, "distance": abs(value - access.closed), "place": list(place), "orientation": list(orientation)}


def _free_arms(robot: Object, access: Access, wanted: str | None) -> list[str]:
    """Return the names of the arms that have a gripper and hold no object; only the wanted arm, if any."""
    arms = robot.description.arms.values() if robot.description else ()
    chosen = [arm for arm in arms if wanted in (None, arm.name) and arm.hand is not None]
    held = {each.carrier_link: each.body.name for each in robot.carried}
    free = [arm.name for arm in chosen if arm.tool_frame not in held]
    if not free:
        full = ", ".join(f"the {arm.name} gripper holds {held[arm.tool_frame]}" for arm in chosen)
        raise AccessFailed(access.joint, full or "the robot has no gripper", handle=access.handle)
    return free


def _move(access: Access, arm: str, distance: float, place: Sequence[float], orientation: Sequence[float]) -> None:
    position, turn = BulletWorld.current_robot().get_position_and_orientation()
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
    with suppress(PlanFailure):  # the door itself may be in the arm's way
        perform(MotionDesignator([("type", "move-arm-joints"), (f"{arm}-arm", "park")]))


_WIDE: Final = {True: 0.4, False: 1.2}  # default opening of a drawer in m, or of a door in rad
_SHARES: Final = (1.0, 0.75, 0.5)  # tried openings as shares of the default opening, in order


def _opening_choices(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    distance: float | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Iterator[Mapping[str, Any]]:
    access = _access_of(container, joint, handle)
    wide = min(access.open - access.closed, _WIDE[access.body.urdf.joint(access.joint).type == "prismatic"])
    widths = [share * wide for share in _SHARES] if distance is None else [distance]
    yield from _handle_choices(access, arm, [access.closed + width for width in widths], place, orientation)


@action("opening", choices=_opening_choices, checked=_CHECKS)
def opening(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    distance: float | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> str:
    """Opens a drawer or door by its handle; returns the name of the arm.

    Args:
        container: A container such as a drawer, its name, or the whole furniture.
        joint: Name of the container's joint, if ``container`` is the furniture.
        handle: Link of the container's handle, if ``container`` is the furniture.
        arm: Name of the arm; by default any arm within reach.
        distance: Width of a drawer in m, or angle of a door in rad; by default 0.4 m or 1.2 rad, or at least
            half of that.
        place: Place of the robot's base, [x, y, z] in m; by default a place from which the arm can move the handle.
        orientation: Orientation of the robot's base at that place, a quaternion [x, y, z, w].
    """
    assert arm is not None and distance is not None and place is not None and orientation is not None  # noqa: S101, PT018  chosen
    _move(_access_of(container, joint, handle), arm, distance, place, orientation)
    return arm


def _closing_choices(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Iterator[Mapping[str, Any]]:
    access = _access_of(container, joint, handle)
    for choice in _handle_choices(access, arm, [access.closed], place, orientation):
        yield {slot: value for slot, value in choice.items() if slot != "distance"}


@action("closing", choices=_closing_choices, checked=_CHECKS)
def closing(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> None:
    """Closes a drawer or door by its handle.

    Args:
        container: A container such as a drawer, its name, or the whole furniture.
        joint: Name of the container's joint, if ``container`` is the furniture.
        handle: Link of the container's handle, if ``container`` is the furniture.
        arm: Name of the arm; by default any arm within reach.
        place: Place of the robot's base, [x, y, z] in m; by default a place from which the arm can move the handle.
        orientation: Orientation of the robot's base at that place, a quaternion [x, y, z, w].
    """
    assert arm is not None and place is not None and orientation is not None  # noqa: S101, PT018  chosen
    _move(_access_of(container, joint, handle), arm, 0.0, place, orientation)
