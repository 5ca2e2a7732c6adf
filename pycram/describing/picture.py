"""A picture of a robot: parked, with its tool frames as three small axes."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.vision.camera import Camera, drawable
from recorder import geometry
from recorder.packages import needed

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.models.robots.arm import Arm
    from pycram.world.object import Object
    from recorder.geometry import Vector

with needed():
    from PIL import Image, ImageDraw

_SIZE: Final = (800, 600)  # pixels
_AWAY: Final = (1.0, 0.7, 0.45)  # direction from the robot to the viewpoint
_MARGIN: Final = 1.1  # times the distance from which the robot fills the picture
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
    middle = (low + high) / 2
    height = _FIELD * _SIZE[1] / _SIZE[0]
    tools = [_axes(robot, arm) for arm in robot.description.arms.values()] if robot.description else []
    points = np.vstack([*itertools.product(*zip(low, high, strict=True)), *itertools.chain(*tools)]) - middle
    turn = geometry.look_at(_AWAY, (0.0, 0.0, 0.0))
    right, down, ahead = (points @ geometry.to_matrix(turn)).T
    distance = _MARGIN * float(np.maximum(np.abs(right) / _FIELD - ahead, np.abs(down) / height - ahead).max())
    x, y, z = (middle + distance * np.array(_AWAY) / math.hypot(*_AWAY)).tolist()
    camera = Camera(((x, y, z), turn), _FIELD, height)
    pixels = (_SIZE[0] * _OVERSAMPLING, _SIZE[1] * _OVERSAMPLING)
    with robot.world.lock:
        sight = camera.draw([drawable(robot)], camera.window, pixels)
    up = geometry.rotate(geometry.conjugate(camera.pose[1]), (0.0, 0.0, 1.0))
    image = Image.fromarray(sight.picture(up)).resize(_SIZE, Image.Resampling.BOX)
    pen = ImageDraw.Draw(image)
    for tool in tools:
        seen = camera.to_frame(np.array(tool))
        flat = (seen[:, :2] / seen[:, 2:] / [_FIELD, height] + 1) / 2 * _SIZE
        for end, color in zip(flat[1:], _COLORS, strict=True):
            pen.line([*flat[0].tolist(), *end.tolist()], fill=color, width=3)
    image.save(file)


def _axes(robot: Object, arm: Arm) -> list[Vector]:
    """Return the origin of an arm's tool frame, and the ends of its axes."""
    tool = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))
    return [tool[0], *(geometry.transform(tool, [_AXIS * (i == axis) for i in range(3)]) for axis in range(3))]
