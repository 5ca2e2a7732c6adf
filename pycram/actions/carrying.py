"""Carrying objects: the actions fetching, delivering and transporting."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import ActionDesignator, action, place_for_an_object, portable
from pycram.actions.containers import containers, enclosing, making_room
from pycram.actions.hands import arms, check_target, free_arms, held_by, holder, holding_arm, places_for
from pycram.actions.locations import LocationDesignator
from pycram.actions.navigating import go, park
from pycram.actions.objects import ObjectDesignator, candidates_of, object_of
from pycram.actions.performing import ActionFailed, perform
from pycram.foundation.failures import Blocked, NoPlace, PerceptionError, PlanFailure, ReasoningError
from pycram.knowledge import believed
from pycram.language.retries import failure_handling
from pycram.models.surfaces import Surface
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping.grasps import GraspSide
from pycram.reasoning.places import FoundPlace, PutDown, standing_places
from pycram.reasoning.places.goals import Target
from pycram.reasoning.places.search import drives
from pycram.reasoning.queries.reachability import blocking
from pycram.scheduling.cancellation import Binding
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry

if TYPE_CHECKING:
    from pycram.actions.containers import Access

_MAX_PLACES: Final = 6  # maximum number of places from which fetching is tried
_MOVED: Final = 0.05  # error in m above which a belief is wrong
_IN_THE_WAY: Final = 2  # maximum number of times that obstacles are cleared away
_BESIDE: Final = 0.5  # maximum distance in m of an obstacle from an object
_NEAREST: Final = 3  # number of surfaces that may receive an obstacle
_STANCES: Final = 2  # number of places of the robot that are tried for each place of an object
_MAX_UNREACHABLE: Final = 6  # number of successive unreachable places of an object after which the search ends
_CLOSING_TRIES: Final = 4  # budget of closing

#: Objects that can't be taken before other objects are cleared away, the outermost first.
_waiting: ContextVar[tuple[Object, ...]] = ContextVar("pycram_waiting", default=())


def _find_and_open(object: Any) -> list[Access]:  # noqa: A002  the slot's name
    """Find an object, open its container, and fold the arms, before places are searched; return opened containers."""
    arms()
    closed = [access for access, _ in containers() if access.is_closed]
    body = _found(object)
    if holder(body) is None:
        container = enclosing(center(body))
        if container is not None:
            perform(ActionDesignator(type="opening", container=container))
        park()
    return [access for access in closed if not access.is_closed]


def _found(thing: Any) -> Any:
    """Return the object of a designator; search for the object if its place is unknown."""
    if isinstance(thing, ObjectDesignator):
        try:
            body = object_of(thing)
        except PerceptionError:
            perform(ActionDesignator(type="searching", object=thing))
            return object_of(thing)
        belief = believed(body)
        if belief is not None and math.dist(belief.position, body.get_position()) > _MOVED:
            perform(ActionDesignator(type="searching", object=body))  # the search begins at the believed place
        return body
    return thing


def _fetching_choices(
    object: Any,  # noqa: A002  the slot's name
    arm: str | None = None,
    place: LocationDesignator | None = None,
    grasp: str | None = None,
    clear: bool = False,
) -> Iterator[Mapping[str, Any]]:
    """Yield arms and places of the robot for taking an object; the last choices clear obstacles away first."""
    body = object_of(object)
    if holder(body) is not None:
        yield {}
        return
    free = free_arms(arm)
    moves = place is None and drives(BulletWorld.current_robot()) and making_room(body)
    if moves and clear:
        yield {"clear": True}
    if place is not None:
        yield from ({"arm": each, "place": place} for each in free)
        return
    nowhere: NoPlace | None = None
    try:
        yield from _from_places(body, free, body, grasp)
    except NoPlace as failure:
        nowhere = failure
        if moves and not clear:
            yield {"clear": True}
    if holder(body) is None and _crowded(body):
        if not drives(BulletWorld.current_robot()):  # the robot can't drive to other places
            yield from ({"arm": each, "clear": True} for each in free)
        else:
            with suppress(NoPlace):
                yield from ({**choice, "clear": True} for choice in _from_places(body, free, center(body)))
    if nowhere is not None:
        raise nowhere


def _from_places(
    body: Object, free: Sequence[str], reach: Target, grasp: str | None = None
) -> Iterator[Mapping[str, Any]]:
    """Yield arms, and places from which these arms reach a target, until an arm has taken the object."""
    robot = BulletWorld.current_robot()
    for spot in itertools.islice(standing_places(robot, reach=[reach], arms=free, grasp=grasp), _MAX_PLACES):
        for arm in spot.arms:
            yield {"arm": arm, "place": _stance(spot)}
            if holder(body) is not None:
                return


def _stance(place: FoundPlace) -> LocationDesignator:
    return LocationDesignator(position=place.position, orientation=place.orientation)


@action("fetching", choices=_fetching_choices, prepare=_find_and_open, checked={"object": portable})
def fetching(
    object: Any,  # noqa: A002  the slot's name
    arm: str | None = None,
    grasp: GraspSide | None = None,
    place: Any = None,
    clear: bool = False,
) -> Any:
    """Drives to a place within reach of an object, and takes the object; moves obstacles, opens drawers and doors.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper approaches: "front", "top", "left" or "right"; by default the freest
            side.
        place: Place of the robot, a LocationDesignator; by default places within reach of the object.
        clear: Whether to clear obstacles away first; by default only after they caused a failure. Without a place,
            this also closes drawers and doors beside the object, and opens the object's own as far as possible.
    """
    body = object_of(object)
    if holder(body) is not None:
        return body
    if clear and place is None and drives(BulletWorld.current_robot()) and (moves := making_room(body)):
        for move in moves:
            with suppress(PlanFailure):
                perform(move)
        if len(making_room(body)) == len(moves):
            raise ReasoningError(f"the open drawers and doors beside {body.name} can't be moved")
        return perform(ActionDesignator(type="fetching", object=body, arm=arm, grasp=grasp))
    if clear:
        go(place)
        _clear_away(body, arm)
    for attempt in failure_handling(_IN_THE_WAY).on(Blocked, lambda _: _clear_away(body, arm)):
        with attempt:
            go(place)
            with suppress(PlanFailure):  # if the object is hidden, the robot uses its belief
                perform(ActionDesignator(type="perceiving", object=body))
            perform(ActionDesignator(type="picking-up", object=body, arm=arm, grasp=grasp))
    park()
    return body


def _crowded(body: Object) -> bool:
    """Return whether a movable object, which may be an obstacle, is near an object."""
    others = [each for each in body.world.objects if not each.fixed and not each.is_robot and each.carrier is None]
    free = [each for each in others if each not in (body, *_waiting.get())]
    return any(math.dist(each.get_position(), body.get_position()) < _BESIDE for each in free)


def _clear_away(body: Object, arm: str | None) -> None:
    """Move the objects that block an arm's way to an object to other surfaces; raise ReasoningError if it fails."""
    robot = BulletWorld.current_robot()
    description = robot.description
    tools = [] if description is None else [each for each in description.arms.values() if arm in (None, each.name)]
    in_the_way = [each for each in blocking(body, robot, tools[0].tool_frame) if not each.is_robot]
    movable = [each for each in in_the_way if not each.fixed]
    if not movable:
        names = ", ".join(each.name for each in in_the_way)
        raise ReasoningError(f"obstacles of {body.name} can't be cleared away: {names or 'no obstacle is movable'}")
    waiting = (*_waiting.get(), body)
    for other in movable:
        if other in waiting:
            circle = " and ".join(each.name for each in waiting[waiting.index(other) :])
            raise ReasoningError(f"{circle} block each other, so the robot can't begin with any of them")
        elsewhere = LocationDesignator(on=_surfaces_beside(body), away_from=body)
        with Binding(_waiting, waiting):
            perform(ActionDesignator(type="transporting", object=other, target=elsewhere))


def _surfaces_beside(body: Object) -> list[Surface]:
    """Return the nearest surfaces outside containers that have room at a distance from an object."""
    position = body.get_position()
    found = []
    for furniture in body.world.objects:
        for surface in furniture.surfaces.values():
            pose = furniture.surface_pose(surface)
            corners = (geometry.transform(pose, (x, y, 0.0)) for x, y in surface.outline)
            if any(math.dist(corner[:2], position[:2]) > _BESIDE for corner in corners) and not surface.container:
                found.append((math.dist(pose[0], position), surface))
    return [surface for _, surface in sorted(found, key=lambda each: each[0])[:_NEAREST]]


def _delivering_choices(
    object: Any,  # noqa: A002  the slot's name
    target: Any,
    place: LocationDesignator | None = None,
) -> Iterator[Mapping[str, Any]]:
    """Yield places for the object, each with one for the robot; at the end {} if the robot lost the object."""
    body, robot = object_of(object), BulletWorld.current_robot()
    arm = holding_arm(body)
    unreachable: list[NoPlace] = []
    reached = False
    for put in places_for(body, target, arm):
        there = LocationDesignator(position=put["position"], orientation=put["orientation"])
        if place is not None:
            yield {"put": there, "place": place}
            continue
        goal = PutDown(tuple(put["position"]), put["orientation"], body)
        try:
            for found in itertools.islice(standing_places(robot, reach=[goal], arms=[arm.name]), _STANCES):
                reached = True
                yield {"put": there, "place": _stance(found)}
                if holder(body) is None:  # the object fell or leans: fetch it again, perhaps with another arm
                    yield {}
                    return
        except NoPlace as failure:
            unreachable.append(failure)
            if len(unreachable) == _MAX_UNREACHABLE:
                break
    if unreachable and not reached:
        raise unreachable[-1]


@action("delivering", choices=_delivering_choices, prepare=park, checked={"target": place_for_an_object})
def delivering(object: Any, target: Any, put: Any = None, place: Any = None) -> Any:  # noqa: A002  the slot's name
    """Drives to a place within reach of a target, puts down an object that a hand holds, and folds the arms.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        target: A LocationDesignator, the name of a surface, an Object to put it on, or [x, y, z] in m, world frame.
        put: Exact place of the object, a LocationDesignator with a position; by default places of the target.
        place: Place of the robot, a LocationDesignator; by default places within reach of the target.
    """
    body = object_of(object)
    if holder(body) is None:  # an earlier try has put the object down at a wrong place
        perform(ActionDesignator(type="fetching", object=body))
        return perform(ActionDesignator(type="delivering", object=body, target=target, put=put, place=place))
    go(place)
    perform(ActionDesignator(type="placing", object=body, target=put or target))
    park()
    return body


def _prepare_transporting(object: Any, target: Any, close: bool = True) -> Iterator[None]:  # noqa: A002  the slot's name
    """Check that the target has room before fetching the object; at the end, close opened containers."""
    arms()
    check_target(candidates_of(object)[0], target)
    opened = _find_and_open(object)
    try:
        yield
    except PlanFailure:
        _close(opened if close else ())
        raise
    _close(opened if close else ())


def _close(opened: Sequence[Access]) -> None:
    for access in opened:
        with suppress(PlanFailure):
            perform(ActionDesignator(type="closing", container=access.name, budget=_CLOSING_TRIES))


@action(
    "transporting",
    choices=_fetching_choices,
    prepare=_prepare_transporting,
    checked={"object": portable, "target": place_for_an_object},
)
def transporting(
    object: Any,  # noqa: A002  the slot's name
    target: Any,
    arm: str | None = None,
    grasp: GraspSide | None = None,
    place: Any = None,
    clear: bool = False,
    close: bool = True,  # noqa: ARG001  _prepare_transporting uses it
) -> Any:
    """Fetches an object and delivers it; opens the drawer or door of the object, and closes it at the end.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        target: New place of the object: a LocationDesignator, the name of a surface, an Object to put it on, or
            [x, y, z] in m, world frame, with a support as for the motion ``place``.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper approaches: "front", "top", "left" or "right"; by default the freest
            side.
        place: Place of the robot while it takes the object, a LocationDesignator; by default places within reach.
        clear: Whether to clear obstacles away first.
        close: Whether to close opened drawers and doors at the end, if possible.
    """
    body = object_of(object)
    perform(ActionDesignator(type="fetching", object=body, arm=arm, grasp=grasp, place=place, clear=clear))
    deliver = ActionDesignator(type="delivering", object=body, target=target)
    try:
        return perform(deliver)
    except (NoPlace, ActionFailed):  # the arm that holds the object may not reach the target
        if holder(body) is None or not any(held_by(other) is None for other in arms()):
            raise
        perform(ActionDesignator(type="handing-over", object=body))  # another arm may reach farther
        return perform(deliver.copy())
