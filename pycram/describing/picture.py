"""A picture of a parked robot, with the axes of its tool frames, or of furniture with its surfaces."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.models.surfaces import DOOR, DRAWER
from pycram.vision import Camera, drawable
from recorder import geometry
from recorder.geometry import Vector
from recorder.packages import needed

if TYPE_CHECKING:
    from pycram.world.object import Object

with needed():
    from PIL import Image, ImageDraw

_SIZE: Final = (800, 600)  # pixels
_AWAY: Final = (1.0, 0.7, 0.45)  # direction from the robot to the viewpoint
_ABOVE: Final = (-0.45, -0.5, 1.0)  # direction from furniture to the camera: it sees over walls, and sees the doors
_MARGIN: Final = 1.1  # distance of the camera, as a multiple of the distance at which the robot just fills the picture
_OVERSAMPLING: Final = 2
_FIELD: Final = math.tan(math.radians(25))  # tangent of half the horizontal field of view
_AXIS: Final = 0.12  # length in m of a tool frame's axes
_COLORS: Final = ("#e03030", "#30a030", "#3060e0")  # x, y, z
_OPEN: Final = (48, 160, 48)  # RGB of surfaces outside containers
_INSIDE: Final = {DRAWER: (230, 120, 20), DOOR: (48, 96, 224)}  # RGB of surfaces in containers
_FILLED: Final = 110  # opacity of surfaces, 0 to 255


def draw(body: Object, file: Path) -> None:
    """Draw a robot or furniture into a picture file; the suffix of the file determines the format.

    Surfaces are drawn over the parts that hide them: open ones green, in drawers orange, behind doors blue.

    Raises:
        OSError: The file can't be written.
        ValueError: No image format has the suffix.
    """
    low, high = (np.array(corner) for corner in body.get_AABB())
    surfaces = {
        surface: [geometry.transform(body.surface_pose(surface), (x, y, 0.0)) for x, y in surface.outline]
        for surface in body.surfaces.values()
    }
    if surfaces:  # the walls of a kitchen are left out
        corners = np.array([*itertools.chain(*surfaces.values())])
        low[:2], high[:2] = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
        high[2] = corners[:, 2].max()
    arms = body.description.arms.values() if body.description else ()
    poses = [arm.tool_pose(body.get_link_position_and_orientation(arm.tool_frame)) for arm in arms]
    tools = [[pose[0], *(geometry.transform(pose, end) for end in (_AXIS * np.eye(3)).tolist())] for pose in poses]
    points = np.vstack([*itertools.product(*zip(low, high, strict=True)), *itertools.chain(*tools)])
    camera = _camera(points, (low + high) / 2, _AWAY if body.is_robot else _ABOVE)
    pixels = (_SIZE[0] * _OVERSAMPLING, _SIZE[1] * _OVERSAMPLING)
    with body.world.lock:
        sight = camera.draw([drawable(body)], camera.window, pixels)
    image = Image.fromarray(sight.picture(camera.up)).resize(_SIZE, Image.Resampling.BOX)
    pen = ImageDraw.Draw(image, "RGBA")
    for surface, outline in surfaces.items():
        color = _INSIDE[body.container(surface.container).kind] if surface.container else _OPEN
        pen.polygon([(x, y) for x, y in _flat(camera, outline)], fill=(*color, _FILLED), outline=color)
    for tool in tools:
        origin, *ends = _flat(camera, tool)
        for end, axis in zip(ends, _COLORS, strict=True):
            pen.line([*origin, *end], fill=axis, width=3)
    image.save(file)


def _camera(points: NDArray[np.float64], middle: NDArray[np.float64], away: Vector) -> Camera:
    """Return a camera that looks from the direction ``away``, and sees all points (n, 3)."""
    height = _FIELD * _SIZE[1] / _SIZE[0]
    turn = geometry.look_at(away, (0.0, 0.0, 0.0))
    right, down, ahead = ((points - middle) @ geometry.to_matrix(turn)).T
    distance = _MARGIN * float(np.maximum(np.abs(right) / _FIELD - ahead, np.abs(down) / height - ahead).max())
    x, y, z = (middle + distance * np.array(away) / math.hypot(*away)).tolist()
    return Camera(((x, y, z), turn), _FIELD, height)


def _flat(camera: Camera, points: Sequence[Vector]) -> list[list[float]]:
    """Return the pixels of points in the world."""
    seen = camera.to_frame(np.array(points))
    flat: list[list[float]] = ((seen[:, :2] / seen[:, 2:] / [camera.right, camera.down] + 1) / 2 * _SIZE).tolist()
    return flat
