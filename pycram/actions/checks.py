"""Checks of the values of actions' slots; an action's function gets the values that they return."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import candidates_of, thing
from pycram.foundation.failures import BadArgument
from pycram.motions import slot_checks
from pycram.motions.designator import Designator

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pycram.motions.slot_checks import Check


def anything(name: str, value: Any) -> Any:  # noqa: ARG001  a check
    """Whatever the action takes."""
    if isinstance(value, Designator):
        value.check()
    return value


def place(name: str, value: Any) -> Any:
    """A LocationDesignator, the name of a surface, or [x, y, z] in m, world frame."""
    if isinstance(value, LocationDesignator):
        value.check()
        return value
    if isinstance(value, str) or hasattr(value, "outline"):
        described = LocationDesignator(on=value)
        described.check()
        return described
    return slot_checks.position(name, value)


def place_for_an_object(name: str, value: Any) -> Any:
    """A LocationDesignator, the name of a surface, or [x, y, z] in m, world frame."""
    wanted = place(name, value)
    if isinstance(wanted, LocationDesignator) and not (wanted.for_objects or wanted.prop_value("position")):
        raise BadArgument(name, value, "a place where an object can be put: with on or in, or a position")
    return wanted


def place_for_the_robot(name: str, value: Any) -> Any:
    """A LocationDesignator for the robot, or [x, y, z] of its base in m, world frame."""
    wanted = place(name, value)
    if isinstance(wanted, LocationDesignator) and wanted.for_objects:
        known = "a place where the robot can stand, as LocationDesignator(near=...) or (reachable_for=...)"
        raise BadArgument(name, value, f"{known}; this is one for an object")
    return wanted


def portable(name: str, value: Any) -> Any:
    """An Object, an ObjectDesignator, or a type of objects, which isn't a robot or furniture."""
    wanted = thing(name, value)
    if all(body.fixed for body in candidates_of(wanted)):
        raise BadArgument(name, value, "an object that can be taken; robots and the environment can't")
    return wanted


def location(name: str, value: Any) -> Any:
    """A LocationDesignator."""
    if not isinstance(value, LocationDesignator):
        raise BadArgument(name, value, "a LocationDesignator")
    value.check()
    return value


def budget(name: str, value: Any) -> Any:
    """How many tries may fail, from 0 up."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise BadArgument(name, value, "a whole number from 0 up")
    return value


def flag(name: str, value: Any) -> Any:
    """True or False."""
    if not isinstance(value, bool):
        raise BadArgument(name, value, "True or False")
    return value


BY_SLOT: Final[Mapping[str, Check]] = {
    "object": thing,
    "target": place,
    "place": location,
    "put": location,
    "clear": flag,
    "close": flag,
    "orientation": slot_checks.orientation,
    "arm": slot_checks.arm,
    "grasp": slot_checks.grasp,
}
"""The checks of the slots of PyCRAM's own actions, by name."""
