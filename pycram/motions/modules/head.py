"""Turning the head so that the camera looks at something."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import LookingFailed
from pycram.motions.modules.simulated import NoDescription, SimulatedModule
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.kinematics import pan_tilt
from recorder import geometry

if TYPE_CHECKING:
    from pycram.motions.designator import Designator

_ACCURACY: Final = math.radians(0.5)


class MoveHead(SimulatedModule):
    """Points the camera's axis at a point or at the center of an object."""

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        description = self.description(robot)
        if description.head is None or description.camera is None:
            raise NoDescription(robot.name)
        with robot.world.lock:
            target = solution["target"] if "target" in solution else center(solution["object"])
            point = geometry.transform(geometry.invert(robot.get_position_and_orientation()), target)
            joints = (description.head.pan, description.head.tilt)
            now = robot.get_joint_positions()
            positions, angle = pan_tilt.look(robot.urdf, joints, description.camera.frame, point, now)
            if angle > _ACCURACY:
                raise LookingFailed(target, angle)
            robot.set_joint_positions(positions)
