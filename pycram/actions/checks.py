"""Checks of the values of actions' slots; the values that they return are what an action's function gets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import thing
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
    "orientation": slot_checks.orientation,
    "arm": slot_checks.arm,
    "grasp": slot_checks.grasp,
}
"""The checks of slots that PyCRAM's own actions have, by name."""
