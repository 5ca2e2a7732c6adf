"""Places in the scene that records speak of: targets, things, cameras; values are those that records carry."""

from __future__ import annotations

import json
import math
import tomllib
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.geometry import Vector
    from recorder.records import Argument, LoadBody
    from recorder.viewer.scene import Body, Scene

Values: TypeAlias = "dict[str, Any]"


def values_of(arguments: Sequence[Argument]) -> Values:
    """Named values as plain data.

    Args:
        arguments: as records carry them.
    """
    return {argument.name: json.loads(argument.json) for argument in arguments[:]}


def name_of(value: object) -> str:
    """The name of an object that a value is, or the value itself if it is a text; else "".

    Args:
        value: as it stands in a record.
    """
    told = value.get("object") if isinstance(value, dict) else value
    return told if isinstance(told, str) else ""


def numbers(value: object, count: int) -> tuple[float, ...] | None:
    """So many finite numbers, if a value is that.

    Args:
        value: as it stands in a record.
        count: how many.
    """
    if not isinstance(value, list | tuple) or len(value) != count:
        return None
    sound = all(isinstance(one, int | float) and math.isfinite(one) for one in value)
    return tuple(float(one) for one in value) if sound else None


def position(value: object) -> Vector | None:
    """A position, or that of a pose, if a value is one.

    Args:
        value: as it stands in a record.
    """
    if isinstance(value, list) and len(value) == 2:
        value = value[0]
    found = numbers(value, 3)
    return (found[0], found[1], found[2]) if found is not None else None


def camera_of(robot: LoadBody) -> Mapping[str, Any]:
    """What a robot's description says of its camera; empty if it says nothing.

    Args:
        robot: how it was loaded.
    """
    try:
        camera = tomllib.loads(robot.robot_description).get("camera", {})
    except ValueError:
        return {}
    return camera if isinstance(camera, dict) else {}


def target(scene: Scene, world: str, values: Values) -> Vector | None:
    """Where values want something: at a position, else where an object is; None if they don't say.

    Args:
        scene: whose bodies they speak of.
        world: name of the world.
        values: by name.
    """
    for value in values.values():
        place = position(value)
        if place is not None:
            return place
    for value in values.values():
        body = scene.bodies.get(world, {}).get(name_of(value))
        if body is not None and not body.loaded.robot_description:
            return body.pose[0]
    return None


def robot(scene: Scene, world: str, name: str = "") -> tuple[str, Body] | None:
    """A world's robot; None if it has none.

    Args:
        scene: whose bodies are looked at.
        world: name of the world.
        name: of the robot; by default the one that plans control, or any.
    """
    there = scene.bodies.get(world, {})
    for wanted in (name, scene.robots.get(world, "")):
        if wanted in there:
            return wanted, there[wanted]
    return next(((name, body) for name, body in there.items() if body.loaded.robot_description), None)


def eye(scene: Scene, world: str, camera: object = None, whose: str = "") -> Vector | None:
    """Where a camera is; None if that isn't known.

    Args:
        scene: whose robot it is.
        world: name of the world.
        camera: a position, a pose, or the name of a frame; the robot's camera by default.
        whose: name of the robot; by default the world's.
    """
    found = robot(scene, world, whose)
    if isinstance(camera, list) or found is None:
        return position(camera)
    name, body = found
    frame = str(camera or camera_of(body.loaded).get("frame", ""))
    pose = scene.pose(world, name, frame) if frame else None
    return pose[0] if pose is not None else None
