"""Putting down what a hand holds, from where the robot stands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.actions.action import action
from pycram.actions.hands import holding_arm
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.motions.designator import MotionDesignator
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.models.robots.description import Arm
    from pycram.world.object import Object


def places_for(body: Object, arm: Arm, target: Any) -> Iterator[Mapping[str, Any]]:
    """Yield where an arm can put an object, by a slot ``target``: ``position`` and ``orientation``, None for any."""
    if not isinstance(target, LocationDesignator):
        yield {"position": target, "orientation": None}
        return
    wanted = target.prop_value("orientation")  # else as is natural for the hand: what was found is one of many
    if target.for_objects:
        target = target.copy([("for", body), ("reachable-for", BulletWorld.current_robot()), ("arm", arm.name)])
    for place in target.solutions():
        yield {"position": place["position"], "orientation": wanted}


def _places(object: Any, target: Any, orientation: Sequence[float] | None = None) -> Iterator[Mapping[str, Any]]:  # noqa: A002
    body = object_of(object)
    for place in places_for(body, holding_arm(body), target):
        yield {"target": place["position"], "orientation": orientation or place["orientation"]}


@action("placing", choices=_places)
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
