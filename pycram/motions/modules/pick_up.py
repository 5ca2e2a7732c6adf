"""Taking an object with a gripper."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.foundation.failures import Blocked, GraspFailed, Unreachable
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import choice, closing_width

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm
    from pycram.motions.designator import Designator
    from pycram.world.object import Object


class PickUp(SimulatedModule):
    """Reaches for an object, closes the gripper around it and takes it."""

    def _execute(self, designator: Designator) -> Object:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        body: Object = solution["object"]
        gripper = arm.gripper
        with robot.world.lock:
            self._check_free(robot, arm, body)
            names = (solution["grasp"],) if "grasp" in solution else None
            plan = choice.best(body, robot, arm.tool_frame, names)
            if plan.posture is None:
                raise GraspFailed(arm.name, body.name, "it is too big for the gripper from any side that is allowed")
            if plan.self_collisions:
                raise Blocked(arm.name, center(body), plan.self_collisions)
            if plan.grasp is None:
                raise Unreachable(arm.name, center(body), plan.posture.position_error)
            if plan.obstacles:
                raise Blocked(arm.name, center(body), [touch["pair"] for touch in plan.obstacles.values()])
            posture = plan.posture.positions
            closed = closing_width.closed_around(robot, gripper, posture, body)
            if closed is None:
                raise GraspFailed(arm.name, body.name, "its fingers would close on nothing")
            robot.set_joint_positions(gripper.positions("open"))
            robot.set_joint_positions(posture)
            robot.set_joint_positions(closed)
            robot.attach(body, arm.tool_frame)
        return body

    def _check_free(self, robot: Object, arm: Arm, body: Object) -> None:
        if body.fixed:
            raise GraspFailed(arm.name, body.name, "it is fixed")
        if body.carrier is not None:
            raise GraspFailed(arm.name, body.name, f"{body.carrier.name} holds it already")
        held = self.held(robot, arm)
        if held is not None:
            raise GraspFailed(arm.name, body.name, f"it holds {held.name}")
