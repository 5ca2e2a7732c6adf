"""Opening and closing grippers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.motions.modules.simulated import SimulatedModule

if TYPE_CHECKING:
    from pycram.motions.designator import Designator


class MoveGripper(SimulatedModule):
    """Opens or closes the gripper of an arm."""

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        gripper = self.description(robot).arm(solution["gripper"]).gripper
        robot.set_joint_positions(gripper.positions(solution["motion"]))
