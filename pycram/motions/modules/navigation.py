"""Moving the base (thesis, Listing 4.3): on the ground, and nowhere where the robot would touch something."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.foundation.failures import InCollision, NoPath, NotDrivable
from pycram.motions.modules.simulated import AS_ASKED, FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.collision import checker
from pycram.reasoning.driving import check_drives, check_ground
from pycram.reasoning.rejections import Touching, Unfit

if TYPE_CHECKING:
    from pycram.motions.designator import Designator


class Navigation(SimulatedModule):
    """Puts the robot to a pose, with what it holds; refuses a pose in collision and leaves the world as it was."""

    failures = (InCollision, NotDrivable)
    failures_in_time = (NoPath, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        target, orientation = solution["target"], solution["orientation"]
        check_drives(robot, target, orientation)
        with self.execution.whole(robot.world):
            with robot.world.lock, choosing("base_pose", robot.world, target=target, orientation=orientation) as choice:
                try:
                    check_ground(robot, target, orientation)
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
