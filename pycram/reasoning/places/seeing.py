"""What a robot's camera would see with its base at another pose, and its head turned to look."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pycram.foundation.failures import MissingPart
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.kinematics import pan_tilt
from pycram.reasoning.places.reaching import held
from pycram.reasoning.queries.visibility import view
from pycram.vision.camera import Camera
from recorder import geometry

if TYPE_CHECKING:
    from pycram.reasoning.queries.visibility import View
    from pycram.world.object import Object
    from recorder.geometry import Pose


def seen_share(robot: Object, body: Object, base: Pose) -> View:
    """Return what a robot's camera would see of an object; the robot itself and what it holds hide nothing.

    Args:
        robot: the robot; its world's lock is held.
        body: the object.
        base: pose of the robot's base.
    """
    description = robot.description
    if description is None or description.camera is None:
        raise MissingPart(robot.name, "camera")
    camera, now = description.camera, robot.get_joint_positions()
    joints = description.head.joints if description.head else ()
    point = geometry.transform(geometry.invert(base), center(body))
    turned, _ = pan_tilt.look(robot.urdf, joints, camera, point, now)
    link = robot.urdf.forward_kinematics({**now, **turned}, camera.frame)
    pose = camera.pose(geometry.multiply(base, link))
    eye = Camera(pose, math.tan(camera.horizontal_fov / 2), math.tan(camera.vertical_fov / 2), camera.near, camera.far)
    return view(body, eye, without=(robot, *held(robot)))
