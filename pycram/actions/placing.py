"""Putting down what a hand holds, from where the robot stands."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import action
from pycram.actions.checks import place_for_an_object
from pycram.actions.containers import containers, enclosing_at
from pycram.actions.hands import held_by, holding_arm
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.foundation.failures import NoPlace, PlaceFailed
from pycram.motions.designator import MotionDesignator
from pycram.reasoning.grasping import placing as settling
from pycram.world.world import BulletWorld
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.models.robots.description import Arm
    from pycram.world.object import Object


_UPRIGHT: Final = [geometry.from_rpy(0.0, 0.0, step * math.pi / 6) for step in range(12)]


def places_for(body: Object, target: Any, arm: Arm | None = None) -> Iterator[Mapping[str, Any]]:
    """Yield where an object can be put, by a slot ``target``: ``position`` and ``orientation``, None for any.

    Args:
        body: The object.
        target: The slot's value.
        arm: Of the current robot, which is to get there; None for whoever would.
    """
    if not isinstance(target, LocationDesignator):
        yield {"position": target, "orientation": None}
        return
    wanted = target.prop_value("orientation")  # else as is natural for the hand: what was found is one of many
    if target.for_objects:
        reached = [] if arm is None else [("reachable-for", BulletWorld.current_robot()), ("arm", arm.name)]
        target = target.copy([("for", body), *reached])
    for place in target.solutions():
        yield {"position": place["position"], "orientation": wanted}
        if arm is not None and held_by(arm) is not body:
            return  # it was put down, but doesn't stand as it should


def check_target(body: Object, target: Any) -> None:
    """Check, before anything moves, that an object has a place at a target at all, whoever would bring it there.

    Raises:
        NoPlace: It has none: the surfaces are too small, too full or closed, or constraints exclude each other.
        PlaceFailed: Nothing is below that it could stand on, or something is there.
    """
    place = next(places_for(body, target))
    if closed := _closed_at(target):
        last = f"{' and '.join(closed)}, which {'is' if len(closed) == 1 else 'are'} closed: open it first"
        raise NoPlace(body.name, {}, last)
    if isinstance(target, LocationDesignator) and target.for_objects:
        return  # as was checked
    turns = [place["orientation"]] if place["orientation"] is not None else _UPRIGHT
    for number, turn in enumerate(turns):
        try:
            settling.set_down(body, place["position"], turn)
        except PlaceFailed:
            if number == len(turns) - 1:
                raise
        else:
            return


def _closed_at(target: Any) -> list[str]:
    """Return the names of the containers that have to be opened before an object can be put at a target."""
    if not isinstance(target, LocationDesignator) or not target.for_objects:
        place = target.reference()["position"] if isinstance(target, LocationDesignator) else target
        container = enclosing_at(place)
        return [] if container is None else [container.name]
    owners = {(body, surface.container) for body, surface in target.surfaces()}
    if any(not name for _, name in owners):
        return []  # other surfaces are open
    return [access.name for access, _ in containers() if access.is_closed and (access.body, access.name) in owners]


def _places(object: Any, target: Any, orientation: Sequence[float] | None = None) -> Iterator[Mapping[str, Any]]:  # noqa: A002
    body = object_of(object)
    for place in places_for(body, target, holding_arm(body)):
        yield {"target": place["position"], "orientation": orientation or place["orientation"]}


@action("placing", choices=_places, checked={"target": place_for_an_object})
def placing(object: Any, target: Any, orientation: Sequence[float] | None = None) -> Any:  # noqa: A002  the slot's name
    """Puts down what a hand holds, from where the robot stands, and folds the arm.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects; in a hand.
        target: A LocationDesignator, the name of a surface, or [x, y, z] in m, world frame.
        orientation: A quaternion [x, y, z, w] of the object there, world frame; upright by default.
    """
    body = object_of(object)
    perform(MotionDesignator(type="place", object=body, target=target, orientation=orientation))
    return body
