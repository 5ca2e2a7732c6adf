"""Turning the head so that the camera looks at something."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import LookingFailed, MissingPart
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.kinematics import pan_tilt
from recorder import geometry

if TYPE_CHECKING:
    from pycram.models.robots.sensors import CameraDescription
    from pycram.motions.designator import Designator
    from recorder.geometry import Vector

_ACCURACY: Final = math.radians(0.5)
_PAN_AND_TILT: Final = 2  # joints that can point the camera anywhere


class MoveHead(SimulatedModule):
    """Points the camera's axis at a point or at the center of an object.

    A head that only pans or only tilts, or a camera that is fixed, brings it into the picture.
    """

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        description = self.description(robot)
        camera = description.camera
        if camera is None:
            raise MissingPart(robot.name, "camera")
        joints = description.head.joints if description.head else ()
        with robot.world.lock:
            target = solution["target"] if "target" in solution else center(solution["object"])
            point = geometry.transform(geometry.invert(robot.get_position_and_orientation()), target)
            positions, seen = pan_tilt.look(robot.urdf, joints, camera, point, robot.get_joint_positions())
            x, y, z = seen
            angle = math.atan2(math.hypot(x, y), z)
            if angle > _ACCURACY and (len(joints) == _PAN_AND_TILT or not _in_picture(camera, seen)):
                raise LookingFailed(target, angle)
            if positions:
                robot.set_joint_positions(positions)


def _in_picture(camera: CameraDescription, point: Vector) -> bool:
    """Whether a camera sees a point of its frame, if nothing hides it."""
    x, y, z = point
    wide, high = (z * math.tan(fov / 2) for fov in (camera.horizontal_fov, camera.vertical_fov))
    return camera.near <= z <= camera.far and abs(x) <= wide and abs(y) <= high
