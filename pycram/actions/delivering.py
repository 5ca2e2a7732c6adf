"""Bringing what a hand holds somewhere, and putting it down."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import ActionDesignator, action
from pycram.actions.checks import place_for_an_object
from pycram.actions.fetching import go, location, park
from pycram.actions.hands import holder
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.actions.placing import places_for
from pycram.foundation.failures import NoPlace, PlaceFailed
from pycram.reasoning.places import PutDown, standing_places
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_EACH: Final = 2  # places to stand at that are tried for one place of the object
_VAIN: Final = 6  # places of the object that can be reached from nowhere, after which no others are looked at


def _ways(object: Any, target: Any, place: LocationDesignator | None = None) -> Iterator[Mapping[str, Any]]:  # noqa: A002
    """Yield where the object is put, and where the robot stands then."""
    body, robot = object_of(object), BulletWorld.current_robot()
    arm = holder(body)
    if arm is None:
        raise PlaceFailed(body.name, body.get_position(), f"{robot.name} doesn't hold it")
    vain: list[NoPlace] = []
    reached = False
    if isinstance(target, LocationDesignator) and target.for_objects:
        target = target.copy([("reachable-for", robot), ("arm", arm.name)])
    for put in places_for(body, target):
        there = LocationDesignator(position=put["position"], orientation=put["orientation"])
        if place is not None:
            yield {"put": there, "place": place}
            continue
        goal = PutDown(tuple(put["position"]), put["orientation"], body)
        try:
            for found in itertools.islice(standing_places(robot, reach=[goal], arms=[arm.name]), _EACH):
                reached = True
                yield {"put": there, "place": location(found)}
        except NoPlace as failure:
            vain.append(failure)
            if len(vain) == _VAIN:
                break
    if vain and not reached:
        raise vain[-1]


@action("delivering", choices=_ways, prepare=park, checked={"target": place_for_an_object})
def delivering(object: Any, target: Any, put: Any = None, place: Any = None) -> Any:  # noqa: A002  the slot's name
    """Goes where it reaches a place, puts down there what a hand holds, and folds the arms.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        target: A LocationDesignator, the name of a surface, or [x, y, z] in m, world frame.
        put: The exact place, a LocationDesignator with a position; by default those that the target stands for.
        place: Where the robot stands then, a LocationDesignator; by default places from which it reaches that place.
    """
    body = object_of(object)
    if holder(body) is None:  # it was put down, but doesn't stand where it should
        perform(ActionDesignator(type="fetching", object=body))
    go(place)
    perform(ActionDesignator(type="placing", object=body, target=put or target))
    park()
    return body
