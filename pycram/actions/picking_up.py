"""Taking an object from where the robot stands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.actions.action import action
from pycram.actions.checks import portable
from pycram.actions.hands import free_arms
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.motions.designator import MotionDesignator

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


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
