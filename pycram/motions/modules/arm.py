"""Moving arms: to joint values, and to a pose of the tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.foundation.failures import BadArgument, Blocked, PostureInCollision, Unreachable
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision import checker
from pycram.reasoning.kinematics import solver

if TYPE_CHECKING:
    from pycram.foundation.collision_pair import CollisionPair
    from pycram.motions.designator import Designator


class MoveJoints(SimulatedModule):
    """Puts one arm or both into a posture: a name such as "park", or joint values."""

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        description = self.description(robot)
        positions: dict[str, float] = {}
        moved: list[str] = []
        for name, arm in description.arms.items():
            wanted = solution.get(f"{name}-arm")
            if wanted is None:
                continue
            moved.append(name)
            if isinstance(wanted, str):
                positions |= arm.posture(wanted)
            elif len(wanted) != len(arm.joints):
                raise BadArgument(f"{name}-arm", wanted, f"{len(arm.joints)} joint values")
            else:
                positions |= dict(zip(arm.joints, wanted, strict=True))
        with robot.world.lock:
            touched = checker.newly_touched(robot, positions)
            if touched:
                raise PostureInCollision(moved, list(dict.fromkeys(pair.body for pair in touched)), touched)
            robot.set_joint_positions(positions)


class MoveTCP(SimulatedModule):
    """Brings the tool frame of an arm to a position, with an orientation if one is asked for."""

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        target = solution["target"]
        with robot.world.lock:
            postures = solver.postures(robot, arm.tool_frame, target, solution.get("orientation"), thorough=True)
            if not postures[0].reaches():
                raise Unreachable(arm.name, target, postures[0].position_error)
            touched: list[CollisionPair] = []
            for posture in postures:
                if posture.reaches():
                    touched = checker.newly_touched(robot, posture.positions)
                    if not touched:
                        robot.set_joint_positions(posture.positions)
                        return
            raise Blocked(arm.name, target, touched)
