"""What a robot's camera would see with its base at another pose, and its head turned to look."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation.failures import MissingPart
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.kinematics import pan_tilt
from pycram.reasoning.places.reaching import held
from pycram.reasoning.queries.visibility import view
from pycram.vision.camera import Camera
from pycram.vision.rasterizer import Window
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.reasoning.queries.visibility import View
    from pycram.world.object import Object
    from recorder.geometry import Pose, PoseLike

_RAY: Final = 1e-3  # half the width of a ray, at 1 m
_AT: Final = 0.05  # m before a point that belong to it, as of the board that it lies on


def seen_share(robot: Object, body: Object, base: Pose) -> View:
    """Return what a robot's camera would see of an object; the robot itself and what it holds hide nothing.

    Args:
        robot: the robot; its world's lock is held.
        body: the object.
        base: pose of the robot's base.
    """
    return view(body, _eye(robot, center(body), base), without=(robot, *held(robot)))


def in_sight(robot: Object, point: Sequence[float], base: PoseLike) -> bool:
    """Return whether nothing fixed is between a robot's camera, with its head turned there, and a point.

    Args:
        robot: the robot; its world's lock is held.
        point: xyz in the world, m.
        base: pose of the robot's base.
    """
    eye = _eye(robot, point, base)
    x, y, z = eye.to_frame(np.asarray(point, dtype=np.float64))
    if not eye.near < z < eye.far or abs(x) > eye.right * z or abs(y) > eye.down * z:
        return False
    ray = Window(x / z - _RAY, y / z - _RAY, x / z + _RAY, y / z + _RAY)
    fixed = [body for body in robot.world.objects if body.fixed and not body.is_robot]
    return bool(eye.render(fixed, ray, (1, 1), float(z)).depth[0, 0] > z - _AT)


def _eye(robot: Object, point: Sequence[float], base: PoseLike) -> Camera:
    """Return a robot's camera with its base at a pose and its head turned to a point."""
    description = robot.description
    if description is None or description.camera is None:
        raise MissingPart(robot.name, "camera")
    camera, now = description.camera, robot.get_joint_positions()
    joints = description.head.joints if description.head else ()
    turned, _ = pan_tilt.look(robot.urdf, joints, camera, geometry.transform(geometry.invert(base), point), now)
    link = robot.urdf.forward_kinematics({**now, **turned}, camera.frame)
    pose = camera.pose(geometry.multiply(base, link))
    return Camera(pose, math.tan(camera.horizontal_fov / 2), math.tan(camera.vertical_fov / 2), camera.near, camera.far)
