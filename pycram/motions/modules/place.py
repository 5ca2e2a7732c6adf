"""Putting an object down that a gripper holds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import PlaceFailed, Unreachable
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision import checker
from pycram.reasoning.grasping import placing, sides
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
            robot.get_link_position_and_orientation(arm.tool_frame),
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
