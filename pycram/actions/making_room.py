"""Clearing away what is in the way of a hand."""

from __future__ import annotations

import math
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final

from pycram.actions.action import ActionDesignator
from pycram.actions.locations import LocationDesignator
from pycram.actions.performing import perform
from pycram.foundation.failures import ReasoningError
from pycram.reasoning.queries.blocking import blocking
from pycram.scheduling.cancellation import Binding
from pycram.world.world import BulletWorld
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.models.surfaces import Surface
    from pycram.world.object import Object

_BESIDE: Final = 0.5  # m between things one of which may be in the way of the other
_NEAREST: Final = 3  # surfaces to which something is cleared away

#: What waits until something is cleared away, from the outside in.
_waiting: ContextVar[tuple[Object, ...]] = ContextVar("pycram_waiting", default=())


def crowded(body: Object) -> bool:
    """Whether something is beside an object that could be put elsewhere."""
    others = [each for each in body.world.objects if each is not body and not each.fixed and not each.is_robot]
    free = [each for each in others if each.carrier is None and each not in _waiting.get()]
    return any(math.dist(each.get_position(), body.get_position()) < _BESIDE for each in free)


def clear(body: Object, arm: str | None) -> None:
    """Put what blocks an object elsewhere, where it is free.

    Args:
        body: The object.
        arm: The arm that is to reach it.

    Raises:
        ReasoningError: What is in the way can't be moved, or waits for this object itself.
    """
    robot = BulletWorld.current_robot()
    description = robot.description
    tools = [] if description is None else [each for each in description.arms.values() if arm in (None, each.name)]
    in_the_way = [each for each in blocking(body, robot, tools[0].tool_frame) if not each.is_robot]
    movable = [each for each in in_the_way if not each.fixed]
    if not movable:
        names = ", ".join(each.name for each in in_the_way)
        raise ReasoningError(
            f"what is in the way of {body.name} can't be cleared away: {names or 'nothing movable is'}"
        )
    waiting = (*_waiting.get(), body)
    for other in movable:
        if other in waiting:
            circle = " and ".join(each.name for each in waiting[waiting.index(other) :])
            raise ReasoningError(f"{circle} block each other: none can go first")
        elsewhere = LocationDesignator(on=_surfaces(body), away_from=body)
        with Binding(_waiting, waiting):
            perform(ActionDesignator(type="transporting", object=other, target=elsewhere))


def _surfaces(body: Object) -> list[Surface]:
    """Return the surfaces that are nearest to an object, of those that are in no container and reach beyond it."""
    position = body.get_position()
    found = [
        (math.dist(furniture.surface_pose(surface)[0], position), surface)
        for furniture in body.world.objects
        for surface in furniture.surfaces.values()
        if not surface.container and _beyond(furniture, surface, position)
    ]
    return [surface for _, surface in sorted(found, key=lambda each: each[0])[:_NEAREST]]


def _beyond(furniture: Object, surface: Surface, position: Sequence[float]) -> bool:
    """Whether a surface reaches beyond what is beside a position: the top of a fridge doesn't, for what is in it."""
    pose = furniture.surface_pose(surface)
    corners = (geometry.transform(pose, (x, y, 0.0)) for x, y in surface.outline)
    return any(math.dist(corner[:2], position[:2]) > _BESIDE for corner in corners)
