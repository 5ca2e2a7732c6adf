"""Moving arms: to joint values, to a pose of the tool, to take an object and to put it down."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import BadArgument, GraspFailed, PlaceFailed, PostureInCollision, Unreachable
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision import checker, ray_cast
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.grasping import choice, closing_width, placing
from pycram.reasoning.kinematics import reach
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.models.robots.description import Arm
    from pycram.motions.designator import Designator
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion

_SETTLING: Final = 0.05  # s of simulated time between looks whether an object that was put down has come to rest
_LONGEST_SETTLING: Final = 10  # looks
_AT_REST: Final = (5e-3, 5e-2)  # m/s, rad/s
_YAWS: Final = 12  # directions in which an object is tried to be put down


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
            touched = _newly_touched(robot, positions)
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
            ways = reach.postures(robot, arm.tool_frame, target, solution.get("orientation"), thorough=True)
            if not ways[0].reached(reach.THRESHOLD):
                raise Unreachable(arm.name, target, ways[0].posture.position_error)
            touched: list[str] = []
            for way in ways:
                if way.reached(reach.THRESHOLD):
                    touched = _newly_touched(robot, way.posture.positions)
                    if not touched:
                        robot.set_joint_positions(way.posture.positions)
                        return
            raise Unreachable(arm.name, target, None, f"{', '.join(touched)} would be in the way")


def _newly_touched(robot: Object, positions: Mapping[str, float]) -> list[str]:
    """Names of what a robot would touch in a posture, but for what it touches already, as on purpose."""
    now = robot.get_joint_positions()
    with CollisionChecker(robot, positions) as rehearsal:
        rehearsal.take(positions)
        touched = rehearsal.touched()
        if not touched:
            return []
        rehearsal.take({name: now[name] for name in positions})
        return sorted(other.name for other in touched.keys() - rehearsal.touched().keys())


class PickUp(SimulatedModule):
    """Reaches for an object, closes the gripper around it and takes it."""

    def _execute(self, designator: Designator) -> Object:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        body: Object = solution["object"]
        with robot.world.lock:
            self._check_free(robot, arm, body)
            names = (solution["grasp"],) if "grasp" in solution else None
            plan = choice.best(body, robot, arm.tool_frame, names)
            if plan.grasp is None or plan.reach is None:
                if plan.reach is None:
                    raise GraspFailed(
                        arm.name, body.name, "it is too big for the gripper from any side that is allowed"
                    )
                if plan.own:
                    clash = " would hit ".join(plan.own[0])
                    raise Unreachable(arm.name, ray_cast.middle(body), None, f"its own {clash}")
                raise Unreachable(arm.name, ray_cast.middle(body), plan.reach.posture.position_error)
            if plan.obstacles:
                blockers = ", ".join(other.name for other in plan.obstacles)
                raise Unreachable(arm.name, ray_cast.middle(body), None, f"{blockers} would be in the way")
            closed = closing_width.closed_around(robot, arm.gripper, plan.reach.posture.positions, body)
            if closed is None:
                raise GraspFailed(arm.name, body.name, "its fingers would close on nothing")
            robot.set_joint_positions(arm.gripper.positions("open"))
            robot.set_joint_positions(plan.reach.posture.positions)
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
    ) -> dict[str, float]:
        body_T_tool = geometry.multiply(
            geometry.invert(body.get_position_and_orientation()),
            robot.get_link_position_and_orientation(arm.tool_frame),
        )
        nearest: float | None = None
        blockers: set[str] = set()

        def tries() -> Iterator[tuple[Pose, bool]]:  # a quick look at all, then a long one
            poses: list[Pose] = []
            for turn in _turns(robot, body, body_T_tool, orientation):
                poses.append(geometry.multiply((placing.set_down(body, target, turn), turn), body_T_tool))
                yield poses[-1], True
            yield from ((pose, False) for pose in poses)

        for (position, tool), quick in tries():
            for way in reach.postures(robot, arm.tool_frame, position, tool, quick=quick):
                if not way.reached(reach.THRESHOLD):
                    near = way.posture.position_error
                    nearest = near if nearest is None else min(near, nearest)
                    continue
                hits = checker.in_the_way(robot, way.posture.positions)
                if not hits:
                    return dict(way.posture.positions)
                blockers |= {other.name for other in hits}
        if blockers:
            raise PlaceFailed(body.name, target, f"{', '.join(sorted(blockers))} would be in the way")
        raise Unreachable(arm.name, target, nearest)


def _settle(body: Object) -> None:
    for _ in range(_LONGEST_SETTLING):
        body.world.simulate(_SETTLING)
        velocity = body.world.engine.velocity(body.handle)
        if math.hypot(*velocity[:3]) < _AT_REST[0] and math.hypot(*velocity[3:]) < _AT_REST[1]:
            return


def _turns(
    robot: Object,
    body: Object,
    body_T_tool: Pose,
    orientation: Sequence[float] | None,
) -> Iterator[Quaternion]:
    """Orientations in which an object may be put down, the most natural for the arm first."""
    if orientation is not None:
        x, y, z, w = orientation
        yield (x, y, z, w)
        return
    natural = [reach.approach(grasp, robot) for grasp in reach.GRASPS]
    _, _, start = 0.0, 0.0, _yaw(body)
    upright = [geometry.from_rpy(0.0, 0.0, start + 2 * math.pi * i / _YAWS) for i in range(_YAWS)]

    def strain(turn: Quaternion) -> float:
        tool = geometry.product(turn, body_T_tool[1])
        return min(geometry.angle(tool, side) for side in natural)

    yield from sorted(upright, key=strain)


def _yaw(body: Object) -> float:
    x, y, _ = geometry.rotate(body.get_orientation(), (1.0, 0.0, 0.0))
    return math.atan2(y, x)
