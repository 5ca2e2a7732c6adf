"""Types of the slots of object and location designators, for type checkers.

Written by ``make reference`` from the slots of both; don't edit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.actions.objects import ObjectDesignator
    from pycram.models.surfaces import Container, Surface
    from pycram.reasoning.places import PutDown
    from pycram.reasoning.places.free import Side
    from pycram.world.object import Object


class ObjectSlots(TypedDict, total=False):
    """Slots of an ObjectDesignator."""

    type: str | None
    name: str | None


class LocationSlots(TypedDict, total=False):
    """Slots of a LocationDesignator."""

    position: Sequence[float] | None
    orientation: Sequence[float] | None
    on: Surface | Object | str | Sequence[Surface | Object | str] | None
    in_: Container | Object | str | None
    for_: Object | ObjectDesignator | str | None
    near: Object | ObjectDesignator | str | Sequence[float] | None
    side: Side | tuple[Side, Object | ObjectDesignator | str] | None
    reachable_for: Object | ObjectDesignator | str | Sequence[float] | PutDown | None
    visible_for: Object | ObjectDesignator | str | None
    away_from: Object | ObjectDesignator | str | Sequence[float] | None
    arm: str | None
