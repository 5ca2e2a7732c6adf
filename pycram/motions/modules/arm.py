"""Moving arms: to joint values, and to a pose of the tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.foundation.failures import BadArgument, Blocked, NoPath, PostureInCollision, Unreachable
from pycram.motions.modules.simulated import AS_ASKED, FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.collision import checker
from pycram.reasoning.kinematics import inverse
from pycram.reasoning.rejections import OutOfReach, Touching

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.foundation.collision_pair import CollisionPair
    from pycram.models.robots.description import Arm
    from pycram.motions.designator import Designator
    from pycram.reasoning.choosing import Choice
    from pycram.world.object import Object


class MoveJoints(SimulatedModule):
    """Puts one arm or both into a posture: a name such as "park", or joint values."""

    failures = (PostureInCollision,)
    failures_in_time = (NoPath, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        description = self.description(robot)
        positions: dict[str, float] = {}
        moved: dict[str, object] = {}
        for name, arm in description.arms.items():
            wanted = solution.get(f"{name}-arm")
            if wanted is None:
                continue
            moved[f"{name}-arm"] = wanted
            if isinstance(wanted, str):
                positions |= arm.posture(wanted)
            elif len(wanted) != len(arm.joints):
                raise BadArgument(f"{name}-arm", wanted, f"{len(arm.joints)} joint values")
            else:
                positions |= dict(zip(arm.joints, wanted, strict=True))
        with self.execution.whole(robot.world):
            with robot.world.lock, choosing("posture", robot.world, **moved) as choice:
                touched = checker.newly_touched(robot, positions)
                if touched:
                    choice.reject(AS_ASKED, Touching(touched))
                    arms = [name.removesuffix("-arm") for name in moved]
                    bodies = list(dict.fromkeys(pair.body for pair in touched))
                    raise PostureInCollision(arms, bodies, touched, torso=_with_torso(robot, positions))
                choice.take(AS_ASKED)
                move = self.execution.move(robot, positions)
            move()


def _with_torso(robot: Object, positions: Mapping[str, float]) -> tuple[str, float] | None:
    """Return the torso's joint, and the height that it is loaded with, if the arms could take a posture there.

    `accessing` may have left it lower, for a drawer near the floor.
    """
    torso = robot.description.torso if robot.description else None
    if torso is None:
        return None
    touched = checker.newly_touched(robot, {**positions, torso.joint: torso.default})
    return None if touched else (torso.joint, torso.default)


class MoveTCP(SimulatedModule):
    """Brings the tool frame of an arm to a position, with an orientation if one is asked for."""

    failures = (Unreachable, Blocked)
    failures_in_time = (NoPath, PostureInCollision, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        target = solution["target"]
        turn = solution.get("orientation")
        with self.execution.whole(robot.world):
            with (
                robot.world.lock,
                choosing("posture", robot.world, arm=arm.name, target=target, orientation=turn) as choice,
            ):
                move = self.execution.move(robot, _posture(robot, arm, target, turn, choice))
            move()


def _posture(
    robot: Object, arm: Arm, target: Sequence[float], orientation: Sequence[float] | None, choice: Choice
) -> Mapping[str, float]:
    """Return the joint values of the nearest posture that brings the tool to a target and touches nothing new.

    Raises:
        Unreachable: There is none that gets there; Blocked if something is in the way.
    """
    postures = inverse.postures(robot, arm.tool_frame, target, orientation, thorough=True)
    if not postures[0].reaches():
        choice.reject("the nearest posture", OutOfReach(postures[0].position_error, postures[0].turn_error))
        raise Unreachable(arm.name, target, postures[0].position_error)
    touched: list[CollisionPair] = []
    for number, posture in enumerate(postures, 1):
        if posture.reaches():
            touched = checker.newly_touched(robot, posture.positions)
            if not touched:
                choice.take(f"posture {number}")
                return posture.positions
            choice.reject(f"posture {number}", Touching(touched))
    raise Blocked(arm.name, target, touched)
