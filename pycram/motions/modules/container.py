"""Opening drawers and doors by their handle."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import AccessFailed, BadArgument, Unreachable
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.collision.checker import DEPTH, CollisionChecker
from pycram.reasoning.collision.ray_cast import half_extent
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping.sides import grasp_orientation
from pycram.reasoning.kinematics import solver
from pycram.world import carried
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.models.robots.description import Arm, Gripper
    from pycram.motions.designator import Designator
    from pycram.world.object import Object
    from recorder.geometry import Pose

_STEP: Final = 0.1  # m or rad of the opened joint from one posture to the next


class Accessing(SimulatedModule):
    """Grips a handle and moves it along the joint's own motion, as wide as asked, with what lies inside.

    Everything is planned before anything moves: a failure leaves the world as it was.
    """

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        container, joint, handle = solution["part-of"], solution["drawer-joint"], solution["drawer-handle"]
        with robot.world.lock:
            held = self.held(robot, arm)
            if held is not None:
                raise AccessFailed(joint, f"the {arm.name} gripper holds {held.name}")
            start = container.get_joint_position(joint)
            container.check_link(handle)
            if handle not in carried.moved_links(container.urdf, [joint]):
                raise BadArgument("drawer-handle", handle, f"a link that {joint} moves")
            lower, upper = container.joint_limits(joint)
            end = max(lower, 0.0) + solution["distance"]
            if end > upper + 1e-9:
                raise AccessFailed(joint, f"it opens up to {upper:g}, not {end:g}")
            steps = max(1, math.ceil(abs(end - start) / _STEP))
            values = [start + (end - start) * i / steps for i in range(steps + 1)]
            postures = self._plan(robot, arm, container, joint, handle, values)
            blockers = {*_touched(robot, arm, container, joint, postures), *_swept(container, joint, values)}
            if blockers:
                names = ", ".join(sorted(body.name for body in blockers))
                raise AccessFailed(joint, f"{names} would be in the way")
            robot.set_joint_positions(arm.gripper.positions("open"))
            robot.set_joint_positions(postures[0])
            robot.set_joint_positions(arm.gripper.positions("close"))
            for value, posture in zip(values[1:], postures[1:], strict=True):
                container.set_joint_position(joint, value)
                robot.set_joint_positions(posture)
            robot.set_joint_positions(arm.gripper.positions("open"))

    @staticmethod
    def _plan(
        robot: Object, arm: Arm, container: Object, joint: str, handle: str, values: list[float]
    ) -> list[Mapping[str, float]]:
        tool = _tool_at(robot, arm.gripper, container, handle)
        link_T_tool = geometry.multiply(geometry.invert(container.get_link_position_and_orientation(handle)), tool)
        postures: list[Mapping[str, float]] = []
        now = container.get_joint_positions()
        seed: Mapping[str, float] | None = None
        for value in values:
            root_T_link = container.urdf.forward_kinematics({**now, joint: value}, handle)
            link = geometry.multiply(container.get_position_and_orientation(), root_T_link)
            position, orientation = geometry.multiply(link, link_T_tool)
            posture = solver.postures(robot, arm.tool_frame, position, orientation, seed=seed)[0]
            if not posture.reaches():
                raise Unreachable(arm.name, position, posture.position_error, f"{handle} at {joint} = {value:.3f}")
            seed = posture.positions
            postures.append(seed)
        return postures


def _touched(
    robot: Object, arm: Arm, container: Object, joint: str, postures: Sequence[Mapping[str, float]]
) -> Iterator[Object]:
    """Yield what the arm would touch while it opens something, but for that."""
    moved = set(carried.moved_links(container.urdf, [joint]))
    opened = arm.gripper.positions("open")
    with CollisionChecker(robot, [*arm.joints, *opened]) as checker:
        for candidate in checker.predict([{**posture, **opened} for posture in postures]):
            for body, collision in checker.touched(candidate).items():
                if body is not container or not moved.issuperset(collision["by"]):
                    yield body


def _swept(container: Object, joint: str, values: Sequence[float]) -> Iterator[Object]:
    """Yield what a drawer or door would push away when it opens; what lies in it moves along."""
    moved = carried.moved_links(container.urdf, [joint])
    supported = carried.supported_bodies(container, moved)
    clone = clone_of(container.world, "reach")
    bodies = clone.sync()
    engine, opening = clone.engine, bodies[container.name]
    others = [
        body for body in container.world.objects if not body.fixed and body not in supported and body.carrier is None
    ]
    try:
        for value in values[1:]:
            engine.pose_joints(opening, {joint: value})
            for body in others:
                copy = bodies[body.name]
                points = (point for link in moved for point in engine.link_closest_points(opening, link, copy))
                if any(point.distance < -DEPTH for point in points):
                    yield body
    finally:
        clone.invalidate(container.name)


def _tool_at(robot: Object, gripper: Gripper, container: Object, handle: str) -> Pose:
    """Return the pose of the tool at a handle: from the front, the fingers across the bar, the palm before it."""
    low, high = container.get_AABB(handle)
    tool = grasp_orientation("front", robot)
    forward = geometry.rotate(tool, (1.0, 0.0, 0.0))
    _, y, _ = geometry.rotate(tool, (0.0, 1.0, 0.0))
    across = abs(y) * (high[1] - low[1]) + math.sqrt(max(0.0, 1 - y * y)) * (high[0] - low[0])
    if across > high[2] - low[2]:  # a bar that lies
        tool = geometry.product(tool, geometry.from_rpy(math.pi / 2, 0.0, 0.0))
    back = max(half_extent(low, high, forward) - gripper.depth, 0.0)
    x, y, z = ((a + b) / 2 - back * f for a, b, f in zip(low, high, forward, strict=True))
    return (x, y, z), tool
