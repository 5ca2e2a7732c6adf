"""Getting to know where an object is: what is believed, else what is seen."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

from pycram.actions.action import TYPES, ActionDesignator
from pycram.actions.objects import ObjectDesignator
from pycram.actions.performing import perform
from pycram.foundation.failures import LookingFailed, PerceptionError
from pycram.motions.designator import MotionDesignator
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from pycram.world.object import Object


def find(thing: Any) -> None:
    """Look for an object unless something is believed of it.

    Raises:
        PerceptionError: It isn't found.
    """
    if not isinstance(thing, ObjectDesignator):
        return
    try:
        thing.reference()
    except PerceptionError:
        if "searching" in TYPES and _camera():
            perform(ActionDesignator(type="searching", object=thing))
        else:
            perform(MotionDesignator(type="world-state-detecting", object=thing))
        thing.reference()


def look_at(body: Object) -> None:
    """Look at an object, if there is a camera; what is hidden is taken to be where it was."""
    if _camera():
        with suppress(LookingFailed, PerceptionError):
            perform(MotionDesignator(type="looking", object=body))
            perform(MotionDesignator(type="detecting", object=body))


def _camera() -> bool:
    description = BulletWorld.current_robot().description
    return description is not None and description.camera is not None
