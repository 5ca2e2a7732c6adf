"""Picking up an object and placing it, from where the robot stands."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import action
from pycram.actions.checks import place_for_an_object, portable
from pycram.actions.containers import containers, enclosing_at
from pycram.actions.hands import free_arms, held_by, holding_arm
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


def _arms(arm: str | None = None) -> Iterator[Mapping[str, Any]]:
    yield from ({"arm": each} for each in free_arms(arm))


@action("picking-up", choices=_arms, checked={"object": portable})
def picking_up(object: Any, arm: str | None = None, grasp: str | None = None) -> Any:  # noqa: A002  the slot's name
    """Takes an object with a gripper, from where the robot stands.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        arm: Name of the arm; by default each of the robot's is tried that is free.
        grasp: The side from which the gripper comes: "front", "top", "left" or "right"; by default the freest.
    """
    return perform(MotionDesignator(type="pick-up", object=object_of(object), arm=arm, grasp=grasp))


_UPRIGHT: Final = [geometry.from_rpy(0.0, 0.0, step * math.pi / 6) for step in range(12)]


def places_for(body: Object, target: Any, arm: Arm | None = None) -> Iterator[Mapping[str, Any]]:
    """Yield places of an object at a target: ``position`` and ``orientation``, None for any.

    Args:
        body: The object.
        target: The value of a slot ``target``.
        arm: The arm of the current robot that is to reach the place; None if any may.
    """
    if not isinstance(target, LocationDesignator):
        yield {"position": target, "orientation": None}
        return
    wanted = target.prop_value("orientation")  # else the hand's natural one: the found orientation is one of many
    if target.for_objects:
        reached = [] if arm is None else [("reachable-for", BulletWorld.current_robot()), ("arm", arm.name)]
        target = target.copy([("for", body), *reached])
    for place in target.solutions():
        yield {"position": place["position"], "orientation": wanted}
        if arm is not None and held_by(arm) is not body:
            return  # it was put down, but doesn't stand as it should


def check_target(body: Object, target: Any) -> None:
    """Check, before anything moves, that a target has room for an object, for any arm.

    Raises:
        NoPlace: The surfaces are too small, too full or closed, or constraints exclude each other.
        PlaceFailed: There is no support below, or the place is occupied.
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
    """Return the names of the closed containers that block a target."""
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
