"""Moving arms: to joint values, to a pose of the tool, to take an object and to put it down."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import BadArgument, GraspFailed, PlaceFailed, PostureInCollision, Unreachable
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import choice, closing_width, placing, sides
from pycram.reasoning.kinematics import solver
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.models.robots.description import Arm
    from pycram.motions.designator import Designator
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion

_SETTLING_PERIOD: Final = 0.05  # s of simulated time between checks whether an object that was put down is at rest
_MAX_SETTLING: Final = 10  # checks
_AT_REST: Final = (5e-3, 5e-2)  # m/s, rad/s
_YAWS: Final = 12  # orientations about the vertical in which putting down is tried


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
                raise PostureInCollision(moved, touched)
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
            touched: list[str] = []
            for posture in postures:
                if posture.reaches():
                    touched = checker.newly_touched(robot, posture.positions)
                    if not touched:
                        robot.set_joint_positions(posture.positions)
                        return
            raise Unreachable(arm.name, target, None, f"{', '.join(touched)} would be in the way")


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
                links = " would hit ".join(plan.self_collisions[0])
                raise Unreachable(arm.name, center(body), None, f"its own {links}")
            if plan.grasp is None:
                raise Unreachable(arm.name, center(body), plan.posture.position_error)
            if plan.obstacles:
                blockers = ", ".join(other.name for other in plan.obstacles)
                raise Unreachable(arm.name, center(body), None, f"{blockers} would be in the way")
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


class Place(SimulatedModule):
    """Puts a held object down on what is there: upright if no orientation is given; and lets it settle."""

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        body: Object = solution["object"]
        target = solution["target"]
        with robot.world.lock:
            held = robot.attachments.get(body)
            if held is None or held.carrier_link != arm.tool_frame:
                raise PlaceFailed(body.name, target, f"the {arm.name} gripper doesn't hold it")
            posture = self._plan(robot, arm, body, target, solution.get("orientation"))
            robot.set_joint_positions(posture)
            robot.set_joint_positions(arm.gripper.positions("open"))
            robot.detach(body)
            _settle(body)

    @staticmethod
    def _plan(
        robot: Object, arm: Arm, body: Object, target: Sequence[float], orientation: Sequence[float] | None
    ) -> Mapping[str, float]:
        body_T_tool = geometry.multiply(
            geometry.invert(body.get_position_and_orientation()),
            arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame)),
        )
        misses: list[float] = []
        blockers: set[str] = set()

        def tool_poses() -> Iterator[tuple[Pose, bool]]:  # all of them searched for quickly, then again thoroughly
            poses: list[Pose] = []
            for turn in _orientations(robot, body, body_T_tool, orientation):
                poses.append(geometry.multiply((placing.set_down(body, target, turn), turn), body_T_tool))
                yield poses[-1], True
            yield from ((pose, False) for pose in poses)

        for (position, turn), quick in tool_poses():
            for posture in solver.postures(robot, arm.tool_frame, position, turn, quick=quick):
                if not posture.reaches():
                    misses.append(posture.position_error)
                    continue
                touched = checker.touched(robot, posture.positions)
                if not touched:
                    return posture.positions
                blockers |= {other.name for other in touched}
        if blockers:
            raise PlaceFailed(body.name, target, f"{', '.join(sorted(blockers))} would be in the way")
        raise Unreachable(arm.name, target, min(misses, default=None))


def _settle(body: Object) -> None:
    for _ in range(_MAX_SETTLING):
        body.world.simulate(_SETTLING_PERIOD)
        velocity = body.world.engine.velocity(body.handle)
        if math.hypot(*velocity[:3]) < _AT_REST[0] and math.hypot(*velocity[3:]) < _AT_REST[1]:
            return


def _orientations(
    robot: Object, body: Object, body_T_tool: Pose, orientation: Sequence[float] | None
) -> Iterator[Quaternion]:
    """Yield orientations in which an object may be put down, the most natural for the arm first."""
    if orientation is not None:
        x, y, z, w = orientation
        yield (x, y, z, w)
        return
    natural = [sides.grasp_orientation(grasp, robot) for grasp in sides.GRASPS]
    start = sides.yaw(body)
    upright = [geometry.from_rpy(0.0, 0.0, start + 2 * math.pi * i / _YAWS) for i in range(_YAWS)]

    def strain(turn: Quaternion) -> float:
        tool = geometry.product(turn, body_T_tool[1])
        return min(geometry.angle(tool, side) for side in natural)

    yield from sorted(upright, key=strain)
