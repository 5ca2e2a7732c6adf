"""Pictures of the moment in which something failed: what the robot saw, and robot and things from the side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.viewer.scene_lookup import camera_of
from replay.errors import ReplayError

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.geometry import Vector
    from replay.explain.explanation import Why
    from replay.file.log import Log


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
    from replay.restore.render import seen  # noqa: PLC0415  both need the physics engine
    from replay.restore.world import unrecorded  # noqa: PLC0415

    robot = next((thing.body for thing in found.things if thing.robot), None)
    camera = camera_of(robot.loaded).get("frame") if robot is not None else None
    files = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not found.things:
            return []
        with unrecorded(log, found.step, found.world.name if found.world is not None else None) as world:
            if isinstance(camera, str):
                files.append(folder / f"step_{found.step}_robot.png")
                seen(world, camera=camera).save(files[-1])
            files.append(folder / f"step_{found.step}_side.png")
            seen(world, target=_middle(found)).save(files[-1])
    except OSError as error:
        raise ReplayError(f"{folder}: {error.strerror or error}") from error
    return files


def _middle(found: Why) -> Vector:
    """Between robot and things, at the height of the things."""
    places = [thing.body.position for thing in found.things]
    x, y = (sum(place[axis] for place in places) / len(places) for axis in (0, 1))
    return x, y, max(place[2] for place in places)
