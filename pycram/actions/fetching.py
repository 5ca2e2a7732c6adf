"""Going where an object is, and taking it."""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from pycram.actions import making_room
from pycram.actions.action import ActionDesignator, action
from pycram.actions.checks import portable
from pycram.actions.containers import containers, enclosing
from pycram.actions.hands import arms, free_arms, holder
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import ObjectDesignator, object_of
from pycram.actions.performing import perform
from pycram.foundation.failures import Blocked, NoPlace, PerceptionError, PlanFailure
from pycram.knowledge import believed
from pycram.language.retries import failure_handling
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.driving import drives
from pycram.reasoning.places import standing_places
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.actions.containers import Access
    from pycram.reasoning.places import Place
    from pycram.reasoning.places.place import Target
    from pycram.world.object import Object

_MAX_PLACES: Final = 6  # places with room for the hand that are tried before others
_MOVED: Final = 0.05  # m from where an object is believed to be, at which it isn't there any more
_IN_THE_WAY: Final = 2  # things that are cleared away, one after the other


def prepare(object: Any) -> list[Access]:  # noqa: A002  the slot's name
    """Get to know where an object is, open what it is in, and fold the arms, with which places to stand are found.

    Returns:
        What was opened.
    """
    arms()
    closed = [access for access, _ in containers() if access.is_closed]
    body = found(object)
    if holder(body) is None:
        container = enclosing(body)
        if container is not None:
            perform(ActionDesignator(type="opening", container=container))
        park()
    return [access for access in closed if not access.is_closed]


def found(thing: Any) -> Any:
    """Return what an object designator stands for, after a search for it if it isn't known where it is.

    Raises:
        PerceptionError: It isn't found; the error says where it was looked for.
    """
    if isinstance(thing, ObjectDesignator):
        try:
            body = object_of(thing)
        except PerceptionError:
            perform(ActionDesignator(type="searching", object=thing))
            return object_of(thing)
        belief = believed(body)
        if belief is not None and math.dist(belief.position, body.get_position()) > _MOVED:
            perform(ActionDesignator(type="searching", object=body))  # looks there first, in vain
        return body
    return thing


def choices(
    object: Any,  # noqa: A002  the slot's name
    arm: str | None = None,
    place: LocationDesignator | None = None,
    grasp: str | None = None,
) -> Iterator[Mapping[str, Any]]:
    """Yield where to stand and with which arm to take an object; then where it can be reached if something is moved."""
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
    if holder(body) is None and making_room.crowded(body):
        if not drives(BulletWorld.current_robot()):  # there is no other place, whatever is in the way
            yield from ({"arm": each, "clear": True} for each in free)
        else:
            with suppress(NoPlace):
                yield from ({**choice, "clear": True} for choice in _from_places(body, free, center(body)))
    if nowhere is not None:
        raise nowhere


def _from_places(
    body: Object, free: Sequence[str], reach: Target, grasp: str | None = None
) -> Iterator[Mapping[str, Any]]:
    """Yield places from which a target is reached, and arms, until one has taken the object."""
    robot = BulletWorld.current_robot()
    for spot in itertools.islice(standing_places(robot, reach=[reach], arms=free, grasp=grasp), _MAX_PLACES):
        for arm in spot.arms:
            yield {"arm": arm, "place": location(spot)}
            if holder(body) is not None:
                return


def location(place: Place) -> LocationDesignator:
    """Return a place where the robot can stand as a designator."""
    return LocationDesignator(position=place.position, orientation=place.orientation)


@action("fetching", choices=choices, prepare=prepare, checked={"object": portable})
def fetching(
    object: Any,  # noqa: A002  the slot's name
    arm: str | None = None,
    grasp: str | None = None,
    place: Any = None,
    clear: bool = False,
) -> Any:
    """Goes where it reaches an object, and takes it; what is in the way it puts elsewhere.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        arm: Name of the arm; by default each is tried that is free.
        grasp: The side from which the gripper comes: "front", "top", "left" or "right"; by default the freest.
        place: Where the robot stands then, a LocationDesignator; by default places from which it reaches the object.
        clear: Whether to clear away at once what is in the way; by default only when that is the reason for a failure.
    """
    body = object_of(object)
    if holder(body) is not None:
        return body
    if clear:
        go(place)
        making_room.clear(body, arm)
    for attempt in failure_handling(_IN_THE_WAY).on(Blocked, lambda _: making_room.clear(body, arm)):
        with attempt:
            go(place)
            with suppress(PlanFailure):  # what is hidden from here is taken to be where it was believed to be
                perform(ActionDesignator(type="perceiving", object=body))
            perform(ActionDesignator(type="picking-up", object=body, arm=arm, grasp=grasp))
    park()
    return body


def go(place: LocationDesignator | None) -> None:
    """Drives to a place, if the robot drives; with arms that don't stick out, if they can be folded."""
    description = BulletWorld.current_robot().description
    if place is not None and description is not None and description.drives:
        park()
        perform(ActionDesignator(type="navigating", target=place))


def park() -> None:
    """Fold the arms, if nothing is in the way of that; else they stay as they are."""
    with suppress(PlanFailure):
        perform(ActionDesignator(type="parking-arms"))
