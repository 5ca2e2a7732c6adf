"""A picture of a robot: parked, with its tool frames as three small axes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.vision.camera import Camera, drawable
from recorder import geometry
from recorder.packages import needed

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.world.object import Object

with needed():
    from PIL import Image, ImageDraw

_SIZE: Final = (800, 600)  # pixels
_OVERSAMPLING: Final = 2
_FIELD: Final = math.tan(math.radians(25))  # of half the horizontal field of view
_AXIS: Final = 0.12  # m, length of a tool frame's axes
_COLORS: Final = ("#e03030", "#30a030", "#3060e0")  # x, y, z


def draw(robot: Object, file: Path) -> None:
    """Write a picture of a robot as it stands; the suffix of the file says in which format.

    Raises:
        OSError: the file can't be written.
        ValueError: its suffix is no picture's.
    """
    low, high = (np.array(corner) for corner in robot.get_AABB())
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    away = np.array([1.0, 0.7, 0.45])
    eye = middle + away / np.linalg.norm(away) * size * 1.25
    position = (float(eye[0]), float(eye[1]), float(eye[2]))
    height = _FIELD * _SIZE[1] / _SIZE[0]
    camera = Camera((position, geometry.look_at(position, middle.tolist())), _FIELD, height)
    pixels = (_SIZE[0] * _OVERSAMPLING, _SIZE[1] * _OVERSAMPLING)
    with robot.world.lock:
        sight = camera.draw([drawable(robot)], camera.window, pixels)
    up = geometry.rotate(geometry.conjugate(camera.pose[1]), (0.0, 0.0, 1.0))
    image = Image.fromarray(sight.picture(up)).resize(_SIZE, Image.Resampling.BOX)
    pen = ImageDraw.Draw(image)
    for arm in robot.description.arms.values() if robot.description else ():
        tool = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))
        ends = [geometry.transform(tool, [_AXIS * (i == axis) for i in range(3)]) for axis in range(3)]
        seen = camera.to_frame(np.array([tool[0], *ends]))
        flat = (seen[:, :2] / seen[:, 2:] / [_FIELD, height] + 1) / 2 * _SIZE
        for end, color in zip(flat[1:], _COLORS, strict=True):
            pen.line([*flat[0].tolist(), *end.tolist()], fill=color, width=3)
    image.save(file)
