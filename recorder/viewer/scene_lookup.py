"""Positions of targets, bodies and cameras, from the values in records."""

from __future__ import annotations

import json
import math
import tomllib
from typing import TYPE_CHECKING, Any, TypeAlias

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.geometry import Pose, Vector
    from recorder.records import Argument, LoadBody
    from recorder.viewer.scene import Scene, SceneBody

Values: TypeAlias = "dict[str, Any]"


def parsed(arguments: Sequence[Argument]) -> Values:
    """Recorded values as plain data, by name."""
    return {argument.name: json.loads(argument.json) for argument in arguments[:]}


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


def camera_of(robot: LoadBody) -> Mapping[str, Any]:
    """The camera in a robot's description; empty if there is none."""
    try:
        camera = tomllib.loads(robot.robot_description).get("camera", {})
    except ValueError:
        return {}
    return camera if isinstance(camera, dict) else {}


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


def robot(scene: Scene, world: str, name: str = "") -> tuple[str, SceneBody] | None:
    """The robot of that name, else the one that plans control, else any; None if the world has none."""
    bodies = scene.bodies.get(world, {})
    for candidate in (name, scene.robots.get(world, "")):
        if candidate in bodies:
            return candidate, bodies[candidate]
    return next(((name, body) for name, body in bodies.items() if body.loaded.robot_description), None)


def camera_offset(camera: Mapping[str, Any]) -> Pose:
    """Pose of a described camera's optical frame in its link."""
    offset = camera.get("frame_offset", {})
    x, y, z = offset.get("xyz", (0.0, 0.0, 0.0))
    return (x, y, z), geometry.from_rpy(*offset.get("rpy", (0.0, 0.0, 0.0)))


def camera_position(scene: Scene, world: str, camera: object = None, robot_name: str = "") -> Vector | None:
    """Where a camera is, given as position, pose or frame, by default the robot's own; None if that isn't known."""
    owner = robot(scene, world, robot_name)
    if isinstance(camera, list) or owner is None:
        return position(camera)
    name, body = owner
    frame = str(camera or camera_of(body.loaded).get("frame", ""))
    pose = scene.pose(world, name, frame) if frame else None
    return pose[0] if pose is not None else None
