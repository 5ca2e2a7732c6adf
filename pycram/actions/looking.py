"""Turning the camera to something."""

from __future__ import annotations

from typing import Any

from pycram.actions.action import action
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import object_of
from pycram.actions.performing import perform
from pycram.motions.designator import MotionDesignator


@action("looking")
def looking(object: Any = None, target: Any = None) -> None:  # noqa: A002  the slot's name
    """Turns the camera to an object, or to a place; one of both is required.

    Args:
        object: An Object, an ObjectDesignator, or a type of objects.
        target: A LocationDesignator, the name of a surface (to its middle), or [x, y, z] in m, world frame.
    """
    body = None if object is None else object_of(object)
    if isinstance(target, LocationDesignator) and target.for_objects:
        target = target.middle()
    perform(MotionDesignator(type="looking", object=body, target=target))
