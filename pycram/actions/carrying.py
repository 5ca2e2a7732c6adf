"""Carrying objects: transporting fetches and delivers; fetching clears obstacles away."""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import ActionDesignator, action, place_for_an_object, portable
from pycram.actions.containers import containers, enclosing
from pycram.actions.hands import arms, check_target, free_arms, held_by, holder, holding_arm, places_for
from pycram.actions.locations import LocationDesignator
from pycram.actions.navigating import go, park
from pycram.actions.objects import ObjectDesignator, candidates_of, object_of
from pycram.actions.performing import ActionFailed, perform
from pycram.foundation.failures import Blocked, NoPlace, PerceptionError, PlanFailure, ReasoningError
from pycram.knowledge import believed
from pycram.language.retries import failure_handling
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.places import PutDown, standing_places
from pycram.reasoning.places.search import drives
from pycram.reasoning.queries.reachability import blocking
from pycram.scheduling.cancellation import Binding
from pycram.world.world import BulletWorld
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.actions.containers import Access
    from pycram.models.surfaces import Surface
    from pycram.reasoning.grasping.grasps import GraspSide
    from pycram.reasoning.places import FoundPlace
    from pycram.reasoning.places.goals import Target
    from pycram.world.object import Object


_MAX_PLACES: Final = 6  # places with room for the hand that are tried before others
_MOVED: Final = 0.05  # m between an object and its belief, above which the belief is wrong
_IN_THE_WAY: Final = 2  # objects that are cleared away, one after the other
_BESIDE: Final = 0.5  # m, maximum distance of an obstacle from an object
_NEAREST: Final = 3  # surfaces to which an obstacle may be cleared away
_STANCES: Final = 2  # places of the robot that are tried for a place of the object
_MAX_UNREACHABLE: Final = 6  # unreachable places of the object, after which the search ends
_CLOSING_TRIES: Final = 4  # failed tries of closing

#: Objects that wait until other objects are cleared away, outermost first.
_waiting: ContextVar[tuple[Object, ...]] = ContextVar("pycram_waiting", default=())


def _find_and_open(object: Any) -> list[Access]:  # noqa: A002  the slot's name
    """Find an object, open its container and fold the arms; return the opened containers.

    The search for places of the robot needs folded arms.
    """
    arms()
    closed = [access for access, _ in containers() if access.is_closed]
    body = _found(object)
    if holder(body) is None:
        container = enclosing(body)
        if container is not None:
            perform(ActionDesignator(type="opening", container=container))
        park()
    return [access for access in closed if not access.is_closed]


def _found(thing: Any) -> Any:
    """Return the object of a designator, after a search if its place is unknown."""
    if isinstance(thing, ObjectDesignator):
        try:
            body = object_of(thing)
        except PerceptionError:
            perform(ActionDesignator(type="searching", object=thing))
            return object_of(thing)
        belief = believed(body)
        if belief is not None and math.dist(belief.position, body.get_position()) > _MOVED:
            perform(ActionDesignator(type="searching", object=body))  # looks there first
        return body
    return thing


def _fetching_choices(
    object: Any,  # noqa: A002  the slot's name
    arm: str | None = None,
    place: LocationDesignator | None = None,
    grasp: str | None = None,
) -> Iterator[Mapping[str, Any]]:
    """Yield places of the robot and arms to take an object; last, places that need obstacles cleared away."""
    body = object_of(object)
    if holder(body) is not None:
        yield {}
        return
    free = free_arms(arm)
    if place is not None:
        yield from ({"arm": each, "place": place} for each in free)
        return
    nowhere: NoPlace | None = None
    try:
        yield from _from_places(body, free, body, grasp)
    except NoPlace as failure:
        nowhere = failure
    if holder(body) is None and _crowded(body):
        if not drives(BulletWorld.current_robot()):  # the robot can only stay where it is
            yield from ({"arm": each, "clear": True} for each in free)
        else:
            with suppress(NoPlace):
                yield from ({**choice, "clear": True} for choice in _from_places(body, free, center(body)))
    if nowhere is not None:
        raise nowhere


def _from_places(
    body: Object, free: Sequence[str], reach: Target, grasp: str | None = None
) -> Iterator[Mapping[str, Any]]:
    """Yield places from which a target is reachable, and arms, until an arm has taken the object."""
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
    """Drives to a place where it reaches an object, and takes it; clears obstacles away.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper comes: "front", "top", "left" or "right"; by default the freest side.
        place: Place of the robot, a LocationDesignator; by default places from which it reaches the object.
        clear: Whether to clear obstacles away first; by default only after they caused a failure.
    """
    body = object_of(object)
    if holder(body) is not None:
        return body
    if clear:
        go(place)
        _clear_away(body, arm)
    for attempt in failure_handling(_IN_THE_WAY).on(Blocked, lambda _: _clear_away(body, arm)):
        with attempt:
            go(place)
            with suppress(PlanFailure):  # if the object is hidden from here, its belief is used
                perform(ActionDesignator(type="perceiving", object=body))
            perform(ActionDesignator(type="picking-up", object=body, arm=arm, grasp=grasp))
    park()
    return body


def _crowded(body: Object) -> bool:
    """Return whether there is a possible obstacle near an object."""
    others = [each for each in body.world.objects if each is not body and not each.fixed and not each.is_robot]
    free = [each for each in others if each.carrier is None and each not in _waiting.get()]
    return any(math.dist(each.get_position(), body.get_position()) < _BESIDE for each in free)


def _clear_away(body: Object, arm: str | None) -> None:
    """Put the objects that block an arm's way to an object elsewhere.

    Raises:
        ReasoningError: The blocking objects can't be moved, or wait for this object itself.
    """
    robot = BulletWorld.current_robot()
    description = robot.description
    tools = [] if description is None else [each for each in description.arms.values() if arm in (None, each.name)]
    in_the_way = [each for each in blocking(body, robot, tools[0].tool_frame) if not each.is_robot]
    movable = [each for each in in_the_way if not each.fixed]
    if not movable:
        names = ", ".join(each.name for each in in_the_way)
        raise ReasoningError(f"obstacles of {body.name} can't be cleared away: {names or 'none of them can be moved'}")
    waiting = (*_waiting.get(), body)
    for other in movable:
        if other in waiting:
            circle = " and ".join(each.name for each in waiting[waiting.index(other) :])
            raise ReasoningError(f"{circle} block each other, so none can be cleared away first")
        elsewhere = LocationDesignator(on=_surfaces_beside(body), away_from=body)
        with Binding(_waiting, waiting):
            perform(ActionDesignator(type="transporting", object=other, target=elsewhere))


def _surfaces_beside(body: Object) -> list[Surface]:
    """Return the nearest surfaces to an object that are outside of containers and extend beyond the object."""
    position = body.get_position()
    found = [
        (math.dist(furniture.surface_pose(surface)[0], position), surface)
        for furniture in body.world.objects
        for surface in furniture.surfaces.values()
        if not surface.container and _beyond(furniture, surface, position)
    ]
    return [surface for _, surface in sorted(found, key=lambda each: each[0])[:_NEAREST]]


def _beyond(furniture: Object, surface: Surface, position: Sequence[float]) -> bool:
    """Return whether a surface extends beyond the neighbourhood of a position; the top of a small fridge doesn't."""
    pose = furniture.surface_pose(surface)
    corners = (geometry.transform(pose, (x, y, 0.0)) for x, y in surface.outline)
    return any(math.dist(corner[:2], position[:2]) > _BESIDE for corner in corners)


def _delivering_choices(
    object: Any,  # noqa: A002  the slot's name
    target: Any,
    place: LocationDesignator | None = None,
) -> Iterator[Mapping[str, Any]]:
    """Yield places for the object and places of the robot; end with an empty choice if a try has lost the object."""
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
                if holder(body) is None:  # it fell or leans: fetch it again, perhaps with another arm
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
    """Drives to a place where it reaches a target, puts down an object that a hand holds, and folds the arms.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        target: A LocationDesignator, the name of a surface, an Object to put it on, or [x, y, z] in m, world frame.
        put: The exact place, a LocationDesignator with a position; by default the places of the target.
        place: Place of the robot, a LocationDesignator; by default places from which it reaches the target.
    """
    body = object_of(object)
    if holder(body) is None:  # it was put down, but at a wrong place
        perform(ActionDesignator(type="fetching", object=body))
        return perform(ActionDesignator(type="delivering", object=body, target=target, put=put, place=place))
    go(place)
    perform(ActionDesignator(type="placing", object=body, target=put or target))
    park()
    return body


def _prepare_transporting(object: Any, target: Any, close: bool = True) -> Iterator[None]:  # noqa: A002  the slot's name
    """Check that the target has room before the object is fetched; finally close the opened containers."""
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
    """Close containers; a container that can't be closed from any place stays open."""
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
    close: bool = True,  # noqa: ARG001  used by _prepare_transporting
) -> Any:
    """Fetches an object and delivers it; opens its drawer or door, and closes it finally.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        target: Its new place: a LocationDesignator, the name of a surface, an Object to put it on, or [x, y, z] in m,
            world frame.
        arm: Name of the arm; by default all free arms are tried.
        grasp: The side from which the gripper comes: "front", "top", "left" or "right"; by default the freest side.
        place: Place of the robot when it takes the object, a LocationDesignator; by default places within reach.
        clear: Whether to clear obstacles away first.
        close: Whether to close opened drawers and doors finally, if possible.
    """
    body = object_of(object)
    perform(ActionDesignator(type="fetching", object=body, arm=arm, grasp=grasp, place=place, clear=clear))
    deliver = ActionDesignator(type="delivering", object=body, target=target)
    try:
        return perform(deliver)
    except (NoPlace, ActionFailed):  # the holding arm doesn't reach the target
        if holder(body) is None or not any(held_by(other) is None for other in arms()):
            raise
        perform(ActionDesignator(type="handing-over", object=body))  # another arm may reach farther
        return perform(deliver.copy())
