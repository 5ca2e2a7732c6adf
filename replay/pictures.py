"""Pictures of the moment in which something failed: what the robot saw, and robot and things from the side."""

from __future__ import annotations

import importlib
import math
import sys
from typing import TYPE_CHECKING, Final

from replay.errors import ReplayError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.geometry import Vector
    from replay.log import Log
    from replay.state import Body
    from replay.why import Why

_AWAY: Final = 1.8  # m to the side of what matters
_ABOVE: Final = 0.9  # m


def write_pictures(log: Log, found: Why, folder: Path) -> list[Path]:
    """Writes the pictures.

    Args:
        log: the recording.
        found: the explanation of the failure.
        folder: where they go; it is made if it isn't there.

    Returns:
        Their files.

    Raises:
        ReplayError: they can't be written.
    """
    render = importlib.import_module("replay.render").render  # rebuilds the world, which needs the physics engine
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = []
        robot = next((thing.body for thing in found.things if thing.distance is None), None)
        camera = camera_of(robot) if robot is not None else None
        if camera is not None:
            files.append(folder / f"step_{found.step}_robot.png")
            render(log, found.step, camera=camera).save(files[-1])
        if found.things:
            eye, target = _side(found)
            files.append(folder / f"step_{found.step}_side.png")
            render(log, found.step, eye=eye, target=target).save(files[-1])
    except OSError as error:
        raise ReplayError(f"{folder}: {error.strerror or error}") from error
    return files


def camera_of(robot: Body) -> str | None:
    """The frame of a robot's camera, by the description that was recorded with it; None if it says none.

    Args:
        robot: its state.
    """
    try:
        camera = tomllib.loads(robot.loaded.robot_description).get("camera", {})
    except ValueError:
        return None
    frame = camera.get("frame") if isinstance(camera, dict) else None
    return frame if isinstance(frame, str) else None


def _side(found: Why) -> tuple[Vector, Vector]:
    """From where robot and things are seen side by side: across the line between them, and where to look."""
    places = [thing.body.position for thing in found.things]
    x, y = (sum(place[axis] for place in places) / len(places) for axis in (0, 1))
    z = max(max(place[2] for place in places) * 0.8, 0.3)
    first, last = places[0], places[-1]
    along = math.atan2(last[1] - first[1], last[0] - first[0])
    away = _AWAY + math.dist(first[:2], last[:2]) / 2
    eye = x + away * math.sin(along), y - away * math.cos(along), z + _ABOVE
    return eye, (x, y, z)
