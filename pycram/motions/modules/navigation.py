"""Moving the base (thesis, Listing 4.3): on the ground, and nowhere where the robot would touch something."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import InCollision, NotDrivable
from pycram.motions.modules.simulated import AS_ASKED, SimulatedModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.collision import checker
from pycram.reasoning.rejections import Touching, Unfit
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.motions.designator import Designator
    from pycram.world.object import Object
    from recorder.geometry import Quaternion

_UNEVEN: Final = 0.05  # m between the ground here and there
_TILT: Final = math.radians(2)


class Navigation(SimulatedModule):
    """Puts the robot to a pose, with what it holds; refuses a pose in collision and leaves the world as it was."""

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        target, orientation = solution["target"], solution["orientation"]
        if robot.description is not None and not robot.description.drives:
            raise NotDrivable(target, orientation, "its base is fixed")
        with self.execution.whole(robot.world):
            with robot.world.lock, choosing("base_pose", robot.world, target=target, orientation=orientation) as choice:
                try:
                    _check_ground(robot, target, orientation)
                except NotDrivable as refusal:
                    choice.reject(AS_ASKED, Unfit(refusal.reason))
                    raise
                touched = checker.touched(robot, {}, base=(tuple(target), tuple(orientation)), all_links=True)
                if touched:
                    pairs = [collision["pair"] for collision in touched.values()]
                    choice.reject(AS_ASKED, Touching(pairs))
                    raise InCollision(target, orientation, [pair.body for pair in pairs], pairs)
                choice.take(AS_ASKED)
                drive = self.execution.drive(robot, target, orientation)
            drive()


def _check_ground(robot: Object, target: Sequence[float], orientation: Quaternion) -> None:
    position, heading = robot.get_position_and_orientation()
    if abs(target[2] - position[2]) > _UNEVEN:
        reason = f"its wheels would leave the ground, which is {target[2] - position[2]:+.2f} m away there"
        raise NotDrivable(target, orientation, reason)
    lean = geometry.lean(orientation, heading)
    if lean > _TILT:
        raise NotDrivable(target, orientation, f"it would lean over by {math.degrees(lean):.0f} degrees")
