"""Process modules that move parts of the robot: its base, head, arms and grippers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final

from pycram.foundation.errors import export
from pycram.foundation.failures import (
    BadArgument,
    Blocked,
    CollisionPair,
    GripperBlocked,
    InCollision,
    LookingFailed,
    MissingPart,
    NoPath,
    NotDrivable,
    PlanFailure,
    PostureInCollision,
    Unreachable,
)
from pycram.models.robots.description import Arm, CameraDescription
from pycram.motions.designator import Designator
from pycram.motions.execution import LEAN, Step, level
from pycram.motions.process_module import AS_ASKED, FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import Choice, choosing
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import fingers
from pycram.reasoning.kinematics import inverse, pan_tilt
from pycram.reasoning.places.search import check_drives, check_ground
from pycram.reasoning.rejections import OutOfReach, Touching, Unfit, short
from pycram.world import attachment, simulation
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Vector


class Navigation(SimulatedModule):
    """Moves the robot and the objects that it holds to a pose without collisions."""

    failures = (InCollision, NotDrivable)
    failures_in_time = (NoPath, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
        target, orientation = solution["target"], solution["orientation"]
        check_drives(robot, target, orientation)
        with self.execution.whole(robot.world):
            with robot.world.lock, choosing("base_pose", robot.world, target=target, orientation=orientation) as choice:
                try:
                    check_ground(robot, target, orientation)
                except NotDrivable as refusal:
                    choice.reject(AS_ASKED, Unfit(refusal.reason))
                    raise
                touched = checker.touched(robot, {}, base=(tuple(target), tuple(orientation)), all_links=True)
                if touched:
                    pairs = [collision["pair"] for collision in touched.values()]
                    choice.reject(AS_ASKED, Touching(pairs))
                    raise InCollision(target, orientation, [pair.body for pair in pairs], pairs)
                choice.take(AS_ASKED)
                drive = self.execution.drive(robot, target, orientation)
            drive()


_ACCURACY: Final = math.radians(0.5)
_PAN_AND_TILT: Final = 2  # number of joints with which a head can point the camera in any direction
_TURNS: Final = (0, 30, -30, 60, -60, 90, -90, 135, -135, 180)  # turns about the vertical that are tried, degrees


class MoveHead(SimulatedModule):
    """Points the camera's axis at a point, or at the centre of an object.

    If the camera is fixed, or the head only pans or only tilts, the camera only needs to see the point.
    """

    failures = (LookingFailed, MissingPart)
    failures_in_time = (NoPath, PostureInCollision, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
        description = self.description(robot)
        camera = description.camera
        if camera is None:
            raise MissingPart(robot.name, "camera")
        joints = description.head.joints if description.head else ()
        looked_at = {key: solution[key] for key in ("target", "object") if key in solution}
        with self.execution.whole(robot.world):
            with robot.world.lock, choosing("gaze", robot.world, **looked_at) as choice:
                target = looked_at["target"] if "target" in looked_at else center(looked_at["object"])
                point = geometry.transform(geometry.invert(robot.get_position_and_orientation()), target)
                positions, seen = pan_tilt.aim_camera(robot.urdf, joints, camera, point, robot.get_joint_positions())
                x, y, z = seen
                angle = math.atan2(math.hypot(x, y), z)
                if angle > _ACCURACY and (len(joints) == _PAN_AND_TILT or not _in_picture(camera, seen)):
                    choice.reject("the nearest posture", OutOfReach(0.0, angle))
                    raise LookingFailed(target, angle)
                choice.take(AS_ASKED, off_axis=round(math.degrees(angle), 3))
                move = self.execution.move(robot, positions) if positions else None
            if move is not None:
                move()


def _in_picture(camera: CameraDescription, point: Vector) -> bool:
    """Return whether a point in the frame of a camera is in the camera's picture, if nothing hides the point."""
    x, y, z = point
    wide, high = (z * math.tan(fov / 2) for fov in (camera.horizontal_fov, camera.vertical_fov))
    return camera.near <= z <= camera.far and abs(x) <= wide and abs(y) <= high


class MoveJoints(SimulatedModule):
    """Moves arms to postures, given by names such as "park" or by joint values."""

    failures = (PostureInCollision,)
    failures_in_time = (NoPath, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
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
    """Return the torso's joint and its default height, if the posture is free at this height.

    An earlier opening of a drawer near the floor may have left the torso lower.
    """
    torso = robot.description.torso if robot.description else None
    if torso is None:
        return None
    touched = checker.newly_touched(robot, {**positions, torso.joint: torso.default})
    return None if touched else (torso.joint, torso.default)


class MoveTCP(SimulatedModule):
    """Moves the tool frame of an arm to a position, and to the orientation if the plan gives one.

    With ``level``, the tool leans by at most 15 degrees more than at the start.
    """

    failures = (Unreachable, Blocked)
    failures_in_time = (NoPath, PostureInCollision, *FOLLOWING)

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
        arm = self.description(robot).arm(solution["arm"])
        target = solution["target"]
        turn = solution.get("orientation")
        with self.execution.whole(robot.world):
            with (
                robot.world.lock,
                choosing("posture", robot.world, arm=arm.name, target=target, orientation=turn) as choice,
            ):
                if solution.get("level") or level(robot, arm):
                    move = self._level(robot, arm, target, turn, choice)
                else:
                    move = self.execution.move(robot, _posture(robot, arm, target, turn, choice))
            move()

    def _level(
        self, robot: Object, arm: Arm, target: Sequence[float], orientation: Sequence[float] | None, choice: Choice
    ) -> Step:
        """Return the step to the first posture that a level way reaches; raise the first failure without a posture."""
        failures: list[PlanFailure] = []
        for turn in _level_turns(robot, arm, target, orientation):
            try:
                return self.execution.move_level(robot, arm, _posture(robot, arm, target, turn, choice))
            except PlanFailure as failure:
                failures.append(failure)
        raise failures[0]


def _level_turns(
    robot: Object, arm: Arm, target: Sequence[float], orientation: Sequence[float] | None
) -> list[Sequence[float]]:
    """Return the tool's orientations to try, small turns first; raise Unreachable if the tool would lean."""
    now = arm.tool_pose(robot.get_link_position_and_orientation(arm.tool_frame))[1]
    if orientation is None:
        return [geometry.product(geometry.from_rpy(0.0, 0.0, math.radians(degrees)), now) for degrees in _TURNS]
    lean = geometry.lean(geometry.product(orientation, geometry.conjugate(now)), geometry.IDENTITY[1])
    if lean > LEAN:
        more = f"at the target the tool would lean by {math.degrees(lean):.0f} degrees more than now"
        raise Unreachable(arm.name, target, None, f"{more}; the maximum is {math.degrees(LEAN):.0f} degrees")
    return [orientation]


def _posture(
    robot: Object, arm: Arm, target: Sequence[float], orientation: Sequence[float] | None, choice: Choice
) -> Mapping[str, float]:
    """Return the nearest posture with the tool at a target without new contacts; raise Unreachable or Blocked."""
    postures = inverse.postures(robot, arm.tool_frame, target, orientation, thorough=True)
    if not postures[0].reaches():
        choice.reject("the nearest posture", OutOfReach(postures[0].position_error, postures[0].turn_error))
        raise Unreachable(arm.name, target, postures[0].position_error)
    touched: list[CollisionPair] = []
    for number, posture in enumerate(postures, 1):
        if posture.reaches() and choice.admits(f"posture {number}"):
            touched = checker.newly_touched(robot, posture.positions)
            if not touched:
                choice.take(f"posture {number}")
                return posture.positions
            choice.reject(f"posture {number}", Touching(touched))
    raise Blocked(arm.name, target, touched)


@dataclass(frozen=True, slots=True)
class GripperMoved:
    """Result of opening or closing a gripper."""

    arm: str  # name of the arm
    share: float  # opening of the gripper, from 0 (closed) to 1 (open)
    stopped_by: Sequence[CollisionPair] = ()  # contacts that stopped the fingers, deepest first
    released: Object | None = None  # the released object
    settled: bool = True  # whether all objects are at rest

    def __record__(self) -> object:
        """Return the names and values of the fields, for records."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class MoveGripper(SimulatedModule):
    """Opens or closes the gripper of an arm until something stops the fingers; opening releases a held object.

    After a release, simulated time passes until all objects are at rest, at most 5 s. A held object stops the fingers
    when they close.
    """

    failures = (GripperBlocked, MissingPart)
    failures_in_time = FOLLOWING

    def _execute(self, designator: Designator) -> GripperMoved:
        solution = designator.reference()
        robot = BulletWorld.current_robot()
        arm = self.description(robot).arm(solution["gripper"])
        opening = solution["motion"] == "open"
        with self.execution.whole(robot.world):
            held = self.held(robot, arm) if opening else None
            with (
                robot.world.lock,
                choosing("finger_motion", robot.world, arm=arm.name, motion=solution["motion"], release=held) as choice,
            ):
                motion = fingers.finger_motion(robot, arm, 1.0 if opening else 0.0, release=held)
                if motion.stopped_by:
                    choice.reject("all the way", Touching(motion.stopped_by))
                if held is not None and motion.stopped_by and motion.gap < fingers.CLEAR:
                    raise GripperBlocked(arm.name, held.name, motion.stopped_by)
                as_far = "as far as they get" if motion.stopped_by else "all the way"
                choice.take(as_far, share_open=short(motion.share))
                grip = self.execution.grip(robot, motion.positions)
            grip()
            settled = True
            if held is not None:
                with robot.world.lock:
                    attachment.detach(robot, held)
                    simulation.separate(robot.world)
                settled = not self.execution.settle(robot.world)
        return GripperMoved(arm.name, motion.share, motion.stopped_by, held, settled)


# Recordings name each module by the file that first contained it.
export("pycram.motions.modules.navigation", Navigation)
export("pycram.motions.modules.head", MoveHead)
export("pycram.motions.modules.arm", MoveJoints, MoveTCP)
export("pycram.motions.modules.gripper", MoveGripper)
