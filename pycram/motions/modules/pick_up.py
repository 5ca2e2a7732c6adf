"""Taking an object with a gripper."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import GraspFailed, NoPath, PlanFailure
from pycram.motions.modules.simulated import SimulatedModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.grasping import fingers
from pycram.reasoning.grasping.taking import ways_to_hold
from pycram.reasoning.rejections import Unreached, short
from pycram.world import overlaps
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pycram.models.robots.description import Arm
    from pycram.motions.designator import Designator
    from pycram.motions.execution import Step
    from pycram.reasoning.choosing import Choice
    from pycram.world.object import Object
    from recorder.geometry import PoseLike

_MAX_SEARCHED: Final = 3  # to which a path is searched in vain
_MOVING: Final = (0.3, 3.0)  # m/s, rad/s from which on it falls or rolls; what rocks after it was set down can be taken
_STILL: Final = (0.005, math.radians(5))  # m and rad by which it may move while the hand comes
_BEHIND: Final = (-1.0, 0.0, 0.0)  # where the gripper comes from, in the tool frame


class PickUp(SimulatedModule):
    """Reaches for an object, closes the gripper around it and takes it: with a finger on both sides, touching no more.

    Everything is planned before anything moves, and looked at again when the hand is there and when it has closed.
    """

    def _execute(self, designator: Designator) -> Object:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["arm"])
        body: Object = solution["object"]
        world, side = robot.world, solution.get("grasp")
        with self.execution.whole(world):
            with world.lock, choosing("grasp", world, object=body, arm=arm.name, side=side) as choice:
                self._check_free(robot, arm, body)
                stood, opened = body.get_position_and_orientation(), arm.gripper.positions("open")

                def approach(posture: Mapping[str, float]) -> Step:
                    return self.execution.approach(robot, arm, posture, _BEHIND, opened=opened, ignored=[body])

                reach, closed = _plan(robot, arm, body, None if side is None else (side,), approach, choice)
            reach()
            with world.lock:
                self._check_still(robot, arm, body, stood)
                close = self.execution.grip(robot, closed)
            close()
            with world.lock:
                sides = fingers.sides_held(robot, arm, body)
                if sides < 2:
                    where = "on one side only" if sides else "nowhere"
                    raise GraspFailed(arm.name, body.name, f"its fingers have closed, and touch it {where}")
                robot.attach(body, arm.tool_frame)
                lift = self.execution.lift(robot, arm)
            if lift is not None:
                lift()
        return body

    def _check_free(self, robot: Object, arm: Arm, body: Object) -> None:
        if body.fixed:
            raise GraspFailed(arm.name, body.name, "it is fixed")
        if body.carrier is not None:
            raise GraspFailed(arm.name, body.name, self._holder(robot, arm, body))
        held = self.held(robot, arm)
        if held is not None:
            raise GraspFailed(arm.name, body.name, f"it holds {held.name}")
        velocity = robot.world.engine.velocity(body.handle)
        speed, turning = math.hypot(*velocity[:3]), math.hypot(*velocity[3:])
        if speed > _MOVING[0] or turning > _MOVING[1]:
            moves = f"it moves, with {speed:.2f} m/s and {turning:.1f} rad/s"
            raise GraspFailed(arm.name, body.name, f"{moves}; world.settle() waits until it is at rest")
        for other in robot.world.objects:
            if other is not body and not other.fixed:  # hulls of furniture may hold what lies in it
                depth = overlaps.depth(body, other)
                if depth > overlaps.DEEP:
                    inside = f"it is {depth * 1e3:.0f} mm inside of {other.name}"
                    raise GraspFailed(arm.name, body.name, inside)

    def _check_still(self, robot: Object, arm: Arm, body: Object, stood: PoseLike) -> None:
        """Check that an object is where it was when the hand set out for it, and free."""
        if body.carrier is not None:
            raise GraspFailed(arm.name, body.name, self._holder(robot, arm, body))
        position, turn = body.get_position_and_orientation()
        moved, turned = math.dist(position, stood[0]), geometry.angle(turn, stood[1])
        if moved > _STILL[0] or turned > _STILL[1]:
            by = f"{moved:.3f} m and {math.degrees(turned):.0f} degrees"
            raise GraspFailed(arm.name, body.name, f"it was moved by {by} while the hand came; pick it up again")

    def _holder(self, robot: Object, arm: Arm, body: Object) -> str:
        """Return what holds an object already, and how to hand it over."""
        holder = body.carrier
        assert holder is not None  # noqa: S101  as was asked before
        free = f"{holder.name}.detach({body.name}) lets go of it"
        for other in self.description(robot).arms.values():
            if self.held(robot, other) is body:
                if other.name == arm.name:
                    return f"{holder.name} holds it already, with this arm; place puts it down, {free}"
                over = (
                    f"{free}, and {holder.name}.attach({body.name}, {arm.tool_frame!r}) gives it to the {arm.name} arm"
                )
                return (
                    f"{holder.name} holds it already, with the {other.name} arm; to hand it over, place it with that "
                    f"one and pick it up with the {arm.name} one; without moving, {over}"
                )
        return f"{holder.name} holds it already; {free}"


def _plan(
    robot: Object,
    arm: Arm,
    body: Object,
    names: Sequence[str] | None,
    approach: Callable[[Mapping[str, float]], Step],
    choice: Choice,
) -> tuple[Step, Mapping[str, float]]:
    """Return what brings the arm to an object, and the posture of its closed gripper, for the grasp that touches least.

    Raises:
        GraspFailed: No side fits, or the fingers wouldn't hold it from any.
        Unreachable: No posture brings the gripper there; Blocked if something is in the way.
        NoPath: No path was found to where it would be taken.
    """
    failures: list[PlanFailure] = []
    searched = 0
    for grasp, posture, closing in ways_to_hold(robot, arm, body, names, failures, choice):
        try:
            reach = approach(posture.positions)
        except NoPath as no_path:
            failures.append(no_path)
            choice.reject(str(grasp), Unreached(no_path.checks, no_path.distance, no_path.pairs))
            searched += 1
            if searched == _MAX_SEARCHED:
                break
        else:
            choice.take(str(grasp), position=short(grasp.position), orientation=short(grasp.orientation))
            return reach, closing.positions
    raise failures[0]  # of the grasp that touches least
