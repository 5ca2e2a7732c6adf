"""The actions perceiving, looking and searching: turning the camera, and searching surfaces and containers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from pycram.actions.action import ActionDesignator, action, looked_at
from pycram.actions.containers import Access, containers
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import candidates_of, object_of
from pycram.actions.performing import perform
from pycram.foundation.errors import export
from pycram.foundation.failures import PerceptionError, PlanFailure
from pycram.knowledge import beliefs
from pycram.motions.designator import MotionDesignator
from pycram.motions.modules.perception import RECOGNISABLE
from pycram.reasoning.places import FoundPlace, standing_places
from pycram.reasoning.queries.visibility import in_sight, visible
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import PoseLike, Quaternion, Vector

_FAR: Final = 3.0  # maximum distance in m from the robot's present place to a point at which the robot looks
_NEAR: Final = 1.6  # maximum distance in m from a place near a surface to a point that the robot looks at
_STRIDE: Final = 0.8  # distance in m between viewed points of a surface; a camera 1 m away sees this width
_PLACES: Final = 2  # number of places of the robot that are tried for one point
_SEEING: Final = 4  # number of places of the robot that are checked for a view of hidden points
_TRIES: Final = 4  # budget of each opening and closing of a container


@action("perceiving")
def perceiving(object: Any) -> Object:  # noqa: A002  the slot's name
    """Turns the camera to the believed place of an object, detects the object and returns it.

    Without a belief, the action detects the object in the present view. Without a camera, the action uses the state of
    the world. The action fails with PerceptionError if the robot doesn't see the object.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
    """
    bodies = candidates_of(object)
    known = next((belief for belief in beliefs() if belief.object in bodies), None)
    if known is not None and has_camera():
        perform(MotionDesignator(type="looking", target=known.position))
    return detected(bodies)


def has_camera() -> bool:
    """Return whether the description of the robot has a camera."""
    description = BulletWorld.current_robot().description
    return description is not None and description.camera is not None


def detected(bodies: Sequence[Object]) -> Object:
    """Return the object that the robot's camera sees best in its present direction; else raise PerceptionError."""
    kind, robot = bodies[0].type, BulletWorld.current_robot()
    camera = robot.description.camera if robot.description else None
    found: Object = perform(MotionDesignator(type="detecting" if camera else "world-state-detecting", object_type=kind))
    if found in bodies:
        return found
    for body in bodies:
        if camera and visible(body, camera.frame, robot=robot, threshold=RECOGNISABLE):
            return body
    raise PerceptionError(kind, {body.name: f"is not seen, but {found.name} is" for body in bodies})


@action("looking", one_of=("object", "target"), checked={"target": looked_at})
def looking(object: Any = None, target: Any = None) -> None:  # noqa: A002  the slot's name
    """Turns the camera to an object, or to a place.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        target: A LocationDesignator, the name of a surface (to its middle), an Object, or [x, y, z] in m, world frame.
    """
    body = None if object is None else object_of(object)
    if isinstance(target, LocationDesignator) and target.for_objects:
        target = target.middle()
    perform(MotionDesignator(type="looking", object=body, target=target))


class ObjectNotFound(PerceptionError):
    """The robot looked at all places, but didn't find the object; ``reasons`` has the last failure at each place."""

    def __init__(self, object_type: str, looked: Sequence[tuple[str, BaseException]]) -> None:
        super().__init__(object_type, {where: str(failure) for where, failure in looked})
        self.looked = list(looked)  # the searched places, in order, and the failures to see the object there
        seen = dict.fromkeys(where for where, failure in looked if isinstance(failure, PerceptionError))
        vain = [where for where in dict.fromkeys(where for where, _ in looked) if where not in seen]
        text = f"the robot looked {', '.join(seen)}" if seen else "there was no place to look at"
        rest = f"; the robot couldn't look {', '.join(vain)}" if vain else ""
        self.args = (f"no {object_type} found: {text}{rest}",)


export("pycram.actions", ObjectNotFound)


@dataclass(frozen=True, slots=True)
class _Point:
    where: str  # text for messages, such as "on the island"
    position: Vector  # world frame, m
    container: str  # the container around the surface, as "BODY/CONTAINER"; "" without a container


@action("searching")
def searching(object: Any) -> Object:  # noqa: A002  the slot's name
    """Searches for an object until the camera sees it, and returns the object.

    The search begins at the believed place of the object. Next, the robot looks at all surfaces, the nearest first:
    from its present place, then from places near the surfaces. Finally, the robot opens closed drawers and doors,
    looks inside, and closes them. If the robot finds no object, the action fails with ObjectNotFound, which has the
    searched places. A robot without a camera uses the state of the world.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
    """
    bodies = candidates_of(object)
    if not has_camera():
        return detected(bodies)
    search = _Search(bodies)
    for step in (search.where_believed, search.from_here, search.from_elsewhere, search.in_containers):
        for _ in step():  # each iteration looks at one point on the surfaces
            if search.found is not None:
                return search.found
    raise ObjectNotFound(bodies[0].type, search.looked)


class _Search:
    def __init__(self, bodies: Sequence[Object]) -> None:
        self.found: Object | None = None
        self.looked: list[tuple[str, BaseException]] = []  # places where the object wasn't seen, and the failures there
        self._bodies = bodies
        self._robot = BulletWorld.current_robot()
        self._stood: list[Vector] = []

    def where_believed(self) -> Iterator[None]:
        """Look at the believed places of the objects: from the present place, then from nearby."""
        for belief in [belief for belief in beliefs() if belief.object in self._bodies]:
            point = _Point(f"where {belief.object.name} was {belief.source}", belief.position, "")
            self._look(point)
            yield
            if not self._is_near(point.position):
                yield from self._beside(point, [point])

    def from_here(self) -> Iterator[None]:
        """Look at all near surfaces from the present place."""
        for point in self._open_points():
            if self._distance(point.position) < _FAR:
                self._look(point)
                yield

    def from_elsewhere(self) -> Iterator[None]:
        """Look at all surfaces from nearby."""
        points = self._open_points()
        for point in points:
            if not any(math.dist(place[:2], point.position[:2]) < _NEAR for place in self._stood):
                yield from self._beside(point, points)

    def in_containers(self) -> Iterator[None]:
        """Open each closed container, look inside, and close the container if the object isn't there."""
        closed = [access for access, _ in containers() if access.is_closed]
        closed.sort(key=lambda access: self._distance(access.body.get_link_position(access.handle)))
        for access in closed:
            opened = self._open(access)
            if opened is not None:
                points = _points(self._robot, access)
                for point in points:
                    self._look(point)
                    yield
                here = self._robot.get_position_and_orientation()
                hidden = [point for point in points if not self._in_sight(point, here)]
                if hidden:  # a door or the front of a container may hide points
                    yield from self._from_before(access, hidden)
                self._close(access, opened)

    def _look(self, point: _Point) -> None:
        try:
            perform(MotionDesignator(type="looking", target=point.position))
            self.found = detected(self._bodies)
        except PlanFailure as failure:
            self.looked.append((point.where, failure))

    def _open(self, access: Access) -> Mapping[str, Any] | None:
        """Open a container; return the slots of the action that closes it, or None if the robot can't open it."""
        try:
            arm = perform(ActionDesignator(type="opening", container=access.name, budget=_TRIES))
        except PlanFailure as failure:
            self.looked.append((f"in {access.name}", failure))
            return None
        place, orientation = self._robot.get_position_and_orientation()
        return {"arm": arm, "place": place, "orientation": orientation}

    @staticmethod
    def _close(access: Access, opened: Mapping[str, Any]) -> None:
        """Close a container from the same place if possible, otherwise from another place; ignore failures."""
        for slots in (opened, {}):
            with suppress(PlanFailure):
                perform(ActionDesignator(type="closing", container=access.name, budget=_TRIES, **slots))
                return

    def _beside(self, point: _Point, points: Sequence[_Point]) -> Iterator[None]:
        """Drive near a point, and look at all points nearby."""
        if self._goes_beside(point):
            x, y, z = self._robot.get_position()
            self._stood.append((x, y, z))
            for each in points:
                if self._is_near(each.position):
                    self._look(each)
                    yield

    def _goes_beside(self, point: _Point) -> bool:
        if self._robot.description is None or not self._robot.description.drives:
            return False
        places = standing_places(self._robot, near=point.position)
        for _ in range(_PLACES):
            try:
                for place in itertools.islice(places, 1):
                    perform(MotionDesignator(type="moving", target=place.position, orientation=_facing(place, point)))
                    return True
            except PlanFailure as failure:
                self.looked.append((point.where, failure))
        return False

    def _from_before(self, access: Access, hidden: Sequence[_Point]) -> Iterator[None]:
        """Look at hidden points from a place in front of the container where the camera sees some of these points."""
        handle = access.body.get_link_position(access.handle)
        before = [(one + other) / 2 for one, other in zip(handle, hidden[0].position, strict=True)]
        with suppress(PlanFailure):
            for place in itertools.islice(standing_places(self._robot, near=before), _SEEING):
                facing = _facing(place, hidden[0])
                seen = [point for point in hidden if self._in_sight(point, (place.position, facing))]
                if seen:
                    perform(MotionDesignator(type="moving", target=place.position, orientation=facing))
                    for point in seen:
                        self._look(point)
                        yield
                    return

    def _in_sight(self, point: _Point, base: PoseLike) -> bool:
        with self._robot.world.lock:
            return in_sight(self._robot, point.position, base)

    def _open_points(self) -> list[_Point]:
        """Return points of the surfaces outside closed containers, the nearest first."""
        closed = {(access.body.name, access.name) for access, _ in containers() if access.is_closed}
        points = [point for point in _points(self._robot) if tuple(point.container.split("/", 1)) not in closed]
        return sorted(points, key=lambda point: self._distance(point.position))

    def _distance(self, position: Sequence[float]) -> float:
        return math.dist(self._robot.get_position()[:2], position[:2])

    def _is_near(self, position: Sequence[float]) -> bool:
        return self._distance(position) < _NEAR


def _facing(place: FoundPlace, point: _Point) -> Quaternion:
    across, along = (point.position[axis] - place.position[axis] for axis in (0, 1))
    return geometry.from_rpy(0.0, 0.0, math.atan2(along, across))


def _points(robot: Object, inside: Access | None = None) -> list[_Point]:
    found = []
    for body in robot.world.objects:
        for surface in body.surfaces.values():
            if inside is not None and (body is not inside.body or surface.container != inside.name):
                continue
            frame = body.surface_pose(surface)
            where = f"in {surface.container}" if surface.container else f"on {surface.name}"
            container = f"{body.name}/{surface.container}" if surface.container else ""
            for x, y in _spread(surface.outline):
                found.append(_Point(where, geometry.transform(frame, (x, y, 0.0)), container))
    return found


def _spread(outline: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Yield points, in the surface's frame, m, at which a camera looks to see the whole surface."""
    sides = []
    for axis in (0, 1):
        low, high = min(corner[axis] for corner in outline), max(corner[axis] for corner in outline)
        count = max(1, round((high - low) / _STRIDE))
        sides.append([low + (high - low) * (number + 0.5) / count for number in range(count)])
    yield from ((x, y) for x in sides[0] for y in sides[1])
