"""The process module that picks up an object with a gripper."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from pycram.foundation.failures import (
    Blocked,
    CollisionPair,
    DoesNotFit,
    GraspFailed,
    GripperBlocked,
    MissingPart,
    NoPath,
    PlanFailure,
    PostureInCollision,
    Unreachable,
)
from pycram.models.robots.description import Arm
from pycram.motions.designator import Designator
from pycram.motions.execution import Step, most_patient, with_patience
from pycram.motions.process_module import FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import Choice, choosing
from pycram.reasoning.collision.checker import DEPTH, CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import fingers
from pycram.reasoning.grasping.choice import holding_grasps
from pycram.reasoning.rejections import Touching, Unreached, short
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.overlaps import DEEP
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import PoseLike

_MOVING: Final = (0.3, 3.0)  # speeds in m/s and rad/s above which an object falls or rolls; a rocking object is slower
_JAMMED: Final = 0.015  # overlap in m above which free objects can't rest
_STILL: Final = (0.005, math.radians(5))  # maximum motion in m and rad of the object while the hand approaches
_FALL: Final = 0.1  # distance in m to its support above which an object hangs in the air
_UPWARD: Final = 0.1  # minimum upward component of the unit direction from a support
_TOUCHING: Final = 2e-3  # maximum distance in m to a body that holds an object by friction
_BEHIND: Final = (-1.0, 0.0, 0.0)  # direction from which the gripper approaches, in the tool frame


class PickUp(SimulatedModule):
    """Moves the gripper to an object, closes the fingers on two sides of the object, and takes the object.

    PyCRAM plans the whole motion before anything moves, and checks it again before and after the gripper closes. The
    motion also takes an object from another hand of the robot; the other hand then releases the object and moves back.
    """

    failures = (GraspFailed, DoesNotFit, Unreachable, Blocked, GripperBlocked, MissingPart)
    failures_in_time = (NoPath, PostureInCollision, *FOLLOWING)

    def _execute(self, designator: Designator) -> Object:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
        arm = self.description(robot).arm(solution["arm"])
        body: Object = solution["object"]
        giver = self.description(robot).arm(solution["from"]) if "from" in solution else None
        world, side, given = robot.world, solution.get("grasp"), giver and giver.name
        with self.execution.whole(world):
            with (
                world.lock,
                choosing("grasp", world, object=body, arm=arm.name, side=side, **{"from": given}) as choice,
            ):
                self._check_free(robot, arm, body, giver)
                along, left = attachment.taken_along(body)
                along += [held.body for held in body.carried if held.loose]  # the other hand also holds these objects
                stood, opened = body.get_position_and_orientation(), arm.gripper.positions("open")

                def approach(posture: Mapping[str, float], patience: float) -> Step:
                    return self.execution.approach(
                        robot, arm, posture, _BEHIND, opened=opened, ignored=[body], patience=patience
                    )

                reach, closed = _plan(robot, arm, body, None if side is None else (side,), approach, choice, giver)
            reach()
            with world.lock:
                self._check_still(robot, arm, body, stood, giver)
                close = self.execution.grip(robot, closed)
            close()
            with world.lock:
                _check_sides(robot, arm, body)
                release = None if giver is None else _release(robot, giver, body)
                if giver is not None:
                    attachment.detach(robot, body)
                along = [load for load in along if load.alive and load.carrier is None]  # no other hand has taken it
                left = [other for other in left if other.alive and other.carrier is None]
                attachment.attach(robot, body, arm.tool_frame, None, along=along, left=left)
                lift = self.execution.lift(robot, arm) if giver is None else None
            if giver is not None and release is not None:
                self.execution.grip(robot, release)()
                with world.lock:
                    lift = self.execution.retreat(robot, giver)
            if lift is not None:
                lift()
            if giver is not None:
                with world.lock:
                    _check_sides(robot, arm, body)
        return body

    def _check_free(self, robot: Object, arm: Arm, body: Object, giver: Arm | None) -> None:
        if body.fixed:
            raise GraspFailed(arm.name, body.name, "the object is fixed")
        if giver is not None and (giver.name == arm.name or self.held(robot, giver) is not body):
            why = "both are the same gripper" if giver is arm else f"the {giver.name} gripper doesn't hold it"
            raise GraspFailed(arm.name, body.name, f"{why}, so it can't be taken from there")
        if giver is None and body.carrier is not None:
            raise GraspFailed(arm.name, body.name, self._holder(robot, arm, body))
        held = self.held(robot, arm)
        if held is not None:
            raise GraspFailed(arm.name, body.name, f"the gripper holds {held.name}")
        velocity = robot.world.engine.velocity(body.handle)
        speed, turning = math.hypot(*velocity[:3]), math.hypot(*velocity[3:])
        if speed > _MOVING[0] or turning > _MOVING[1]:
            moves = f"the object moves at {speed:.2f} m/s and {turning:.1f} rad/s"
            raise GraspFailed(arm.name, body.name, f"{moves}; world.settle() waits until it is at rest")
        if giver is None and any(robot.world.gravity) and not _is_held_up(body):
            hangs = f"the object hangs in the air, with no support within {_FALL * 100:.0f} cm"
            raise GraspFailed(arm.name, body.name, f"{hangs}; world.settle() lets it fall")
        for other in robot.world.objects:
            if other is body or other.fixed or body in other.attachments:  # a shape of furniture may contain objects
                continue
            deepest = robot.world.engine.deepest(body.handle, other.handle)
            if deepest is not None and -deepest.distance > (_JAMMED if other.carrier is None else DEEP):
                inside = f"the object is {-deepest.distance * 1e3:.0f} mm inside {other.name}"
                why = f"which {other.carrier.name} holds" if other.carrier else "world.settle() lifts them apart"
                raise GraspFailed(arm.name, body.name, f"{inside}, {why}" if other.carrier else f"{inside}; {why}")

    def _check_still(self, robot: Object, arm: Arm, body: Object, stood: PoseLike, giver: Arm | None) -> None:
        if giver is not None and self.held(robot, giver) is not body:
            reason = f"the {giver.name} gripper released the object while the hand approached"
            raise GraspFailed(arm.name, body.name, reason)
        if giver is None and body.carrier is not None:
            raise GraspFailed(arm.name, body.name, self._holder(robot, arm, body))
        position, turn = body.get_position_and_orientation()
        moved, turned = math.dist(position, stood[0]), geometry.angle(turn, stood[1])
        if moved > _STILL[0] or turned > _STILL[1]:
            by = f"{moved:.3f} m and {math.degrees(turned):.0f} degrees"
            raise GraspFailed(arm.name, body.name, f"the object moved by {by} while the hand approached; try again")

    def _holder(self, robot: Object, arm: Arm, body: Object) -> str:
        """Return a text: which robot or hand holds an object, and how the plan can hand the object over."""
        holder = body.carrier
        assert holder is not None  # noqa: S101  the callers have checked this
        free = f"{holder.name}.detach({body.name}) releases it"
        for other in self.description(robot).arms.values():
            if self.held(robot, other) is body:
                if other.name == arm.name:
                    return f"this arm already holds {body.name}; place puts it down, {free}"
                attach = f"{holder.name}.attach({body.name}, {arm.tool_frame!r})"
                return (
                    f"the {other.name} arm already holds {body.name}; to hand it over, place it with the {other.name} "
                    f"arm and pick it up with the {arm.name} arm, or pick it up with the slot from={other.name!r}; "
                    f"without a motion, {free}, and {attach} gives it to the {arm.name} arm"
                )
        return f"{holder.name} already holds {body.name}; {free}"


def _plan(
    robot: Object,
    arm: Arm,
    body: Object,
    names: Sequence[str] | None,
    approach: Callable[[Mapping[str, float], float], Step],
    choice: Choice,
    giver: Arm | None,
) -> tuple[Step, Mapping[str, float]]:
    """Return the step to the best grasp of an object that touches no giving hand, and the closed gripper's posture."""
    failures: list[PlanFailure] = []
    grasps = holding_grasps(robot, arm, body, names, failures, choice)
    for (grasp, posture, closing), patience in with_patience(grasps):
        if giver is not None and (pairs := _meeting(robot, arm, giver, posture.positions)):
            failures.append(Blocked(arm.name, center(body), pairs))
            choice.reject(str(grasp), Touching(pairs))
            continue
        try:
            reach = approach(posture.positions, patience)
        except NoPath as no_path:
            failures.append(no_path)
            choice.reject(str(grasp), Unreached(no_path.checks, no_path.distance, no_path.pairs))
        else:
            choice.take(str(grasp), position=short(grasp.position), orientation=short(grasp.orientation))
            return reach, closing.positions
    first, *_ = failures  # the failure of the best grasp
    raise most_patient([each for each in failures if isinstance(each, NoPath)]) if isinstance(first, NoPath) else first


def _is_held_up(body: Object) -> bool:
    """Return whether a fixed body or a robot supports an object, directly or through other objects."""
    engine = body.world.engine
    others = sorted(body.world.objects, key=lambda other: not other.fixed)
    reached = [body]
    for each in reached:  # the loop appends to the list that it iterates over
        for other in others:
            if other in reached:
                continue
            points = engine.closest_points(each.handle, other.handle, _FALL)
            if any(point.normal[2] > _UPWARD or point.distance <= _TOUCHING for point in points):
                if other.fixed:
                    return True
                reached.append(other)
    return False


def _check_sides(robot: Object, arm: Arm, body: Object) -> None:
    sides = fingers.sides_held(robot, arm, body)
    if sides < 2:
        where = "only one side of" if sides else "no side of"
        raise GraspFailed(arm.name, body.name, f"the closed fingers touch {where} the object")


def _meeting(robot: Object, arm: Arm, giver: Arm, posture: Mapping[str, float]) -> list[CollisionPair]:
    """Return the contacts between the links of two hands while one takes an object from the other."""
    hands = [{each.gripper.palm, *each.gripper.fingers} for each in (arm, giver)]
    opened = arm.gripper.positions("open")
    with CollisionChecker(robot, [*posture, *opened]) as checker:
        (candidate,) = checker.predict([{**posture, **opened}])
        met = [
            (pair, checker.depth(candidate, pair))
            for pair in checker.self_pairs([candidate])[0]
            if any(pair[1] in one and pair[3] in other for one, other in (hands, hands[::-1]))
        ]
        return [checker.named(pair, depth) for pair, depth in met if depth >= DEPTH]


def _release(robot: Object, giver: Arm, body: Object) -> Mapping[str, float]:
    """Return the posture in which a gripper has released an object; raise GripperBlocked if the fingers can't open."""
    motion = fingers.finger_motion(robot, giver, 1.0, release=body)
    if motion.stopped_by and motion.gap < fingers.CLEAR:
        raise GripperBlocked(giver.name, body.name, motion.stopped_by)
    return motion.positions
