"""Putting down what a hand holds, from where the robot stands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.actions.action import action
from pycram.actions.hands import holder
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.foundation.failures import PlaceFailed
from pycram.motions.designator import MotionDesignator
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.world.object import Object


def places_for(body: Object, target: Any) -> Iterator[Mapping[str, Any]]:
    """Yield where an object can be put, by a slot ``target``: ``position`` and ``orientation``, None for any."""
    if not isinstance(target, LocationDesignator):
        yield {"position": target, "orientation": None}
        return
    wanted = target.prop_value("orientation")  # else as is natural for the hand: what was found is one of many
    for place in target.copy([("for", body)]).solutions() if target.for_objects else target.solutions():
        yield {"position": place["position"], "orientation": wanted}


def _places(object: Any, target: Any, orientation: Sequence[float] | None = None) -> Iterator[Mapping[str, Any]]:  # noqa: A002
    body, robot = object_of(object), BulletWorld.current_robot()
    arm = holder(body)
    if arm is None:
        raise PlaceFailed(body.name, body.get_position(), f"{robot.name} doesn't hold it")
    constraints = [("reachable-for", robot), ("arm", arm.name)]
    from_here = isinstance(target, LocationDesignator) and target.for_objects
    for place in places_for(body, target.copy(constraints) if from_here else target):
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
