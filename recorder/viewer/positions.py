"""Positions that recorded values give: of targets, given themselves or by an object's name."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from recorder.geometry import Vector
    from recorder.viewer.scene import Scene

Values: TypeAlias = "dict[str, Any]"


def name_of(value: object) -> str:
    """The name of the object that a recorded value is, or the value itself if it is a text; else ""."""
    name = value.get("object") if isinstance(value, dict) else value
    return name if isinstance(name, str) else ""


def vector(value: object, length: int) -> tuple[float, ...] | None:
    """A recorded value as that many finite numbers; None if it isn't that."""
    if not isinstance(value, list | tuple) or len(value) != length:
        return None
    finite = all(isinstance(number, int | float) and math.isfinite(number) for number in value)
    return tuple(map(float, value)) if finite else None


def position(value: object) -> Vector | None:
    """The position, or that of the pose, that a recorded value is; None if it is neither."""
    if isinstance(value, list) and len(value) == 2:
        value = value[0]
    numbers = vector(value, 3)
    return (numbers[0], numbers[1], numbers[2]) if numbers is not None else None


def target_position(scene: Scene, world: str, values: Values) -> Vector | None:
    """The target position among values: a position, else that of an object; None if there is neither."""
    for value in values.values():
        point = position(value)
        if point is not None:
            return point
    for value in values.values():
        body = scene.bodies.get(world, {}).get(name_of(value))
        if body is not None and not body.loaded.robot_description:
            return body.pose[0]
    return None
