"""Bringing what a hand holds somewhere, and putting it down."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import ActionDesignator, action
from pycram.actions.checks import place_for_an_object
from pycram.actions.fetching import go, location, park
from pycram.actions.hands import holder, holding_arm
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.actions.placing import places_for
from pycram.foundation.failures import NoPlace
from pycram.reasoning.places import PutDown, standing_places
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_EACH: Final = 2  # places to stand at that are tried for one place of the object
_MAX_UNREACHABLE: Final = 6  # places of the object that are reached from nowhere, after which no others are tried


def _choices(object: Any, target: Any, place: LocationDesignator | None = None) -> Iterator[Mapping[str, Any]]:  # noqa: A002
    """Yield where the object is put, and where the robot stands then; nothing of it when a try has lost the object."""
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
            for found in itertools.islice(standing_places(robot, reach=[goal], arms=[arm.name]), _EACH):
                reached = True
                yield {"put": there, "place": location(found)}
                if holder(body) is None:  # it fell, or leans: it is taken again, perhaps by another arm
                    yield {}
                    return
        except NoPlace as failure:
            unreachable.append(failure)
            if len(unreachable) == _MAX_UNREACHABLE:
                break
    if unreachable and not reached:
        raise unreachable[-1]


@action("delivering", choices=_choices, prepare=park, checked={"target": place_for_an_object})
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
        return perform(ActionDesignator(type="delivering", object=body, target=target, put=put, place=place))
    go(place)
    perform(ActionDesignator(type="placing", object=body, target=put or target))
    park()
    return body
