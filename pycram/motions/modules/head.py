"""Turning the head so that the camera looks at something."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import LookingFailed, MissingPart, NoPath, PostureInCollision
from pycram.motions.modules.simulated import AS_ASKED, FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.kinematics import pan_tilt
from pycram.reasoning.rejections import OutOfReach
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.models.robots.sensors import CameraDescription
    from pycram.motions.designator import Designator
    from pycram.reasoning.choosing import Choice
    from pycram.world.object import Object
    from recorder.geometry import Vector

_ACCURACY: Final = math.radians(0.5)
_PAN_AND_TILT: Final = 2  # joints that can point the camera anywhere


class MoveHead(SimulatedModule):
    """Points the camera's axis at a point or at the center of an object.

    A head that only pans or only tilts, or a camera that is fixed, brings it into the picture.
    """

    failures = (LookingFailed, MissingPart)
    failures_in_time = (NoPath, PostureInCollision, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        description = self.description(robot)
        camera = description.camera
        if camera is None:
            raise MissingPart(robot.name, "camera")
        joints = description.head.joints if description.head else ()
        looked_at = {key: solution[key] for key in ("target", "object") if key in solution}
        with self.execution.whole(robot.world):
            with robot.world.lock, choosing("gaze", robot.world, **looked_at) as choice:
                positions = _aimed(robot, joints, camera, looked_at, choice)
                move = self.execution.move(robot, positions) if positions else None
            if move is not None:
                move()


def _aimed(
    robot: Object, joints: Sequence[str], camera: CameraDescription, looked_at: Mapping[str, Any], choice: Choice
) -> Mapping[str, float]:
    """Return the values of the head's joints with which its camera sees a target or an object.

    Raises:
        LookingFailed: There are none.
    """
    target = looked_at["target"] if "target" in looked_at else center(looked_at["object"])
    point = geometry.transform(geometry.invert(robot.get_position_and_orientation()), target)
    positions, seen = pan_tilt.look(robot.urdf, joints, camera, point, robot.get_joint_positions())
    x, y, z = seen
    angle = math.atan2(math.hypot(x, y), z)
    if angle > _ACCURACY and (len(joints) == _PAN_AND_TILT or not _in_picture(camera, seen)):
        choice.reject("the nearest posture", OutOfReach(0.0, angle))
        raise LookingFailed(target, angle)
    choice.take(AS_ASKED, off_axis=round(math.degrees(angle), 3))
    return positions


def _in_picture(camera: CameraDescription, point: Vector) -> bool:
    """Whether a camera sees a point of its frame, if nothing hides it."""
    x, y, z = point
    wide, high = (z * math.tan(fov / 2) for fov in (camera.horizontal_fov, camera.vertical_fov))
    return camera.near <= z <= camera.far and abs(x) <= wide and abs(y) <= high
