"""Goals of an arm: whether an arm reaches a goal from a place, by the rules of the motion to this goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol, TypeAlias

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import (
    BadArgument,
    Blocked,
    CollisionPair,
    GraspFailed,
    PlaceFailed,
    PlanFailure,
    Unreachable,
)
from pycram.models.robots.description import Arm, RobotDescription
from pycram.reasoning.choosing import UNRECORDED, Choice
from pycram.reasoning.collision.checker import DEPTH, CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping import grasps
from pycram.reasoning.grasping.choice import holding_grasps
from pycram.reasoning.grasping.grasps import GRASPS, candidates, grasp_orientation
from pycram.reasoning.grasping.handles import ANGLES, DeadEnd, Handle, plan_path
from pycram.reasoning.grasping.placing import Refusals, placements
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.queries.query import world_of
from pycram.reasoning.rejections import NoRoom, OutOfReach, Rejection, Touching, Unfit
from pycram.world import attachment
from pycram.world.attachment import held
from pycram.world.object import Object
from recorder import geometry
from recorder.geometry import Pose, Quaternion, Vector

_TURNS: Final = 6  # number of orientations about the vertical for an object without a given orientation
_MAX_SINGLE: Final = 30  # maximum number of places that are checked one by one; more places are checked together
_STEP: Final = 0.1  # largest distance in m or rad between joint positions at which the arm must reach the handle


@dataclass(frozen=True, slots=True)
class PutDown:
    """A goal to put down an object that an arm holds."""

    position: Vector  # position of the object, m
    orientation: Quaternion | None = None  # xyzw of the object; None for upright with a natural yaw
    body: Object | None = None  # the object; None for the object that the arm holds


@dataclass(frozen=True, slots=True)
class Pull:
    """A goal to open or close a drawer or door by its handle."""

    container: Object  # the furniture
    joint: str  # name of the drawer's or door's joint
    handle: str  # name of the handle's link
    to: float  # goal position of the joint, rad or m


#: A target: an object to take, a position xyz for the tool, a position and an orientation for a held object, a PutDown
#: or a Pull.
Target: TypeAlias = Object | PutDown | Pull | Sequence[float] | tuple[Sequence[float], Sequence[float] | None]


class Goal(Protocol):
    """A goal for an arm."""

    @property
    def position(self) -> Vector:
        """The position of the goal in the world, m."""

    def named(self) -> str:
        """Return the name of the goal for messages."""

    def tools(self, arm: Arm, base: Pose) -> Sequence[Sequence[Pose]] | None:
        """Return rough poses of the tool, for each stage of the motion; the tool must reach one pose of each stage.

        ``base`` is the pose of the robot's base. If the result is None, any pose of the tool is allowed.
        """

    def reached(self, arm: Arm, base: Pose) -> str | Rejection:
        """Return the side of the grasp ("" without a grasp), or why the arm can't reach the goal from a base pose."""


def goal_of(robot: Object, target: Target, grasp: str | None = None) -> Goal:
    """Return the goal for a target; an arm takes an object from the side ``grasp``, or from any side if None.

    BadArgument is raised if the target has another type, or is in another world.
    """
    if isinstance(target, Object):
        world_of(robot, target)
        return TakeGoal(robot, target, None if grasp is None else (grasp,))
    if isinstance(target, Pull):
        world_of(robot, target.container)
        target.container.check_link(target.handle)
        return PullGoal(robot, target)
    if isinstance(target, PutDown):
        return PutDownGoal(robot, target)
    try:
        parts = list(target)
    except TypeError:
        raise BadArgument("reach", target, "an object, a position, a PutDown or a Pull") from None
    if len(parts) == 2:
        position, turn = parts
        orientation = None if turn is None else checks.quaternion("orientation", turn)
        return PutDownGoal(robot, PutDown(checks.vector("reach", position), orientation))
    return TouchGoal(robot, checks.vector("reach", parts))


def promising(robot: Object, goal: Goal, arms: Sequence[Arm], bases: Sequence[Pose]) -> list[bool]:
    """Return, for poses of a robot's base, whether any arm roughly reaches a goal; all poses are checked together.

    All answers are True, without a check, if any pose of the tool is allowed, or for few poses and an arm without a
    closed form.
    """
    within = np.zeros(len(bases), dtype=bool)
    for arm in arms:
        solver = Solver(robot, arm.tool_frame)
        tools = [goal.tools(arm, base) for base in bases]
        if any(each is None for each in tools) or not (solver.in_closed_form or len(bases) > _MAX_SINGLE):
            return [True] * len(bases)
        stages = [(number, stage) for number, each in enumerate(tools) for stage in each or ()]
        targets = [(*tool, bases[number]) for number, stage in stages for tool in stage]
        if solver.in_closed_form:
            found = [bool(postures) for postures in solver.closed_form(targets)]
        else:
            found = [postures[0].reaches() for postures in solver.search(targets, quick=True)]
        owners = np.repeat(np.arange(len(stages)), [len(stage) for _, stage in stages])
        passed = np.bincount(owners, weights=found, minlength=len(stages)) > 0
        within |= np.bincount([number for number, _ in stages], weights=~passed, minlength=len(bases)) == 0
    return within.tolist()


def description_of(argument: str, robot: object) -> RobotDescription:
    """Return a robot's description; raise BadArgument if the argument isn't a robot, or has no description."""
    if not isinstance(robot, Object) or robot.description is None:
        raise BadArgument(argument, robot, "a robot with a description")
    return robot.description


class TakeGoal:
    """A goal to pick up an object. ``grasps`` are the allowed sides; None for all sides."""

    def __init__(self, robot: Object, body: Object, grasps: Sequence[str] | None = None) -> None:
        self._robot, self.body, self._grasps = robot, body, grasps

    @property
    def position(self) -> Vector:
        """The center of the object's bounds, m."""
        return center(self.body)

    def named(self) -> str:
        """Return the name of the object."""
        return self.body.name

    def tools(self, arm: Arm, base: Pose) -> Sequence[Sequence[Pose]]:  # noqa: ARG002  the poses are the same for all arms
        """Return poses of the tool in the center of the object, one for each allowed side."""
        return [[(self.position, grasp_orientation(side, self._robot, base)) for side in self._grasps or GRASPS]]

    def reached(self, arm: Arm, base: Pose) -> str | Rejection:
        """Return the side of the first grasp that would hold the object, or why there is no grasp."""
        if self.body.fixed:
            return Unfit(f"{self.body.name} is fixed")
        if (unfit := _no_free_hand(self._robot, arm)) is not None:
            return unfit
        solver = Solver(self._robot, arm.tool_frame)  # a cheap test first, because most places are out of reach
        sides = Choice("grasp", {})  # receives the reasons against sides
        take = partial(candidates, self.body, self._robot, arm, self._grasps, base=base)
        grasps = [*take(choice=sides), *take(off_center=True)]
        if not grasps:
            return min(sides.reasons(), key=lambda reason: reason.miss())
        near = solver.search([(grasp.position, grasp.orientation, base) for grasp in grasps], quick=True)
        if not any(postures[0].reaches() for postures in near):
            return OutOfReach(min((postures[0].position_error for postures in near), default=None))
        failures: list[PlanFailure] = []
        for grasp, *_ in holding_grasps(self._robot, arm, self.body, self._grasps, failures, UNRECORDED, base):
            return grasp.name
        return _rejection(failures[0])


class PutDownGoal:
    """A goal to put down an object that an arm holds."""

    def __init__(self, robot: Object, target: PutDown) -> None:
        self._robot, self._target = robot, target
        self._rests: dict[str, dict[Quaternion, Vector | PlaceFailed]] = {}

    @property
    def position(self) -> Vector:
        """The position of the object after the motion, m."""
        return self._target.position

    def named(self) -> str:
        """Return the position of the object after the motion."""
        return _named(self._target.position)

    def _held(self, arm: Arm) -> Object | None:
        """Return the object in an arm's hand if it is the object to put down."""
        in_hand = held(self._robot, arm)
        return in_hand[0] if in_hand and self._target.body in (None, in_hand[0]) else None

    def tools(self, arm: Arm, base: Pose) -> Sequence[Sequence[Pose]]:  # noqa: ARG002  the poses are the same for all places
        """Return poses of the tool with the object at the goal, for several yaws."""
        body = self._held(arm)
        if body is None:
            return [[]]
        tool = arm.tool_pose(self._robot.get_link_position_and_orientation(arm.tool_frame))
        body_T_tool = geometry.multiply(geometry.invert(body.get_position_and_orientation()), tool)
        turns = [geometry.from_rpy(0.0, 0.0, grasps.yaw(body) + math.pi / 3 * step) for step in range(_TURNS)]
        if self._target.orientation is not None:
            turns = [self._target.orientation]
        return [[geometry.multiply((self._target.position, turn), body_T_tool) for turn in turns]]

    def reached(self, arm: Arm, base: Pose) -> str | Rejection:
        """Return "" if the arm can put the object down at the goal, else the reason."""
        body = self._held(arm)
        if body is None:
            return Unfit(f"the arm doesn't hold {self._target.body.name if self._target.body else 'anything'}")
        refusals, rests = Refusals(), self._rests.setdefault(arm.name, {})
        target, turn = self._target.position, self._target.orientation
        found = placements(self._robot, arm, body, target, turn, refusals, UNRECORDED, base, quickly=True, rests=rests)
        if next(found, None) is not None:
            return ""
        if refusals.pairs:
            return Touching([refusals.pairs[name] for name in sorted(refusals.pairs)])
        return min(refusals.misses, key=OutOfReach.miss) if refusals.misses else NoRoom(refusals.no_room[0].reason)


class PullGoal:
    """A goal to move a handle."""

    def __init__(self, robot: Object, target: Pull) -> None:
        self._robot, self._target = robot, target

    @property
    def position(self) -> Vector:
        """The present position of the handle, m."""
        x, y, z = self._target.container.get_link_position(self._target.handle)
        return x, y, z

    def named(self) -> str:
        """Return the handle's name."""
        return self._target.handle

    def tools(self, arm: Arm, base: Pose) -> Sequence[Sequence[Pose]]:
        """Return poses of the tool at the handle before and after the motion, at several angles about its bar."""
        target = self._target
        handle = self._handle()
        grip = handle.grips(self._robot, arm.gripper, base)[0]
        values = target.container.get_joint_position(target.joint), target.to
        return [[geometry.multiply(handle.pose(value), grip.tool(angle)) for angle in ANGLES[::2]] for value in values]

    def struck(self, arms: Sequence[Arm], bases: Sequence[Pose]) -> list[Touching | None]:
        """Return, for poses of the base, the robot's links that the moved part would hit, except links of the arms."""
        robot, container, handle = self._robot, self._target.container, self._handle()
        clone = clone_of(robot.world, "reach")
        moving = set(attachment.moved_links(robot.urdf, [joint for arm in arms for joint in arm.joints]))
        found: list[Touching | None] = []
        with CollisionChecker(robot, (), all_links=True) as tried:
            parts = [(link, clone.link(container, link)) for link in handle.moved]
            for link, part in parts:
                clone.engine.set_pose(part, handle.pose(self._target.to, link))
            for candidate in tried.predict_at(bases):
                pairs = [
                    CollisionPair(robot.name, touch.link_a, container.name, link, -touch.distance)
                    for link, part in parts
                    for touch in tried.closest_points(candidate, part)
                    if touch.distance <= -DEPTH and touch.link_a not in moving
                ]
                found.append(Touching(pairs) if pairs else None)
        clone.invalidate(container.name)
        return found

    def _handle(self) -> Handle:
        container, joint, link = self._target.container, self._target.joint, self._target.handle
        clone = clone_of(self._robot.world, "reach")
        return clone.cached(container, (Handle, joint, link), lambda: Handle(container, joint, link))

    def reached(self, arm: Arm, base: Pose) -> str | Rejection:
        """Return "" if the arm can hold the handle during the whole motion, else the reason."""
        unfit = _no_free_hand(self._robot, arm)
        if unfit is not None:
            return unfit
        target = self._target
        start = target.container.get_joint_position(target.joint)
        steps = max(1, math.ceil(abs(target.to - start) / _STEP))
        values = [start + (target.to - start) * step / steps for step in range(steps + 1)]
        handle = Handle(target.container, target.joint, target.handle)
        path = plan_path(self._robot, arm, handle, values, base, quick=True)
        return path.rejection() if isinstance(path, DeadEnd) else ""


class TouchGoal:
    """A goal to move the tool to a position, in any orientation."""

    def __init__(self, robot: Object, position: Vector) -> None:
        self._robot, self.position = robot, position

    def named(self) -> str:
        """Return the position."""
        return _named(self.position)

    def tools(self, arm: Arm, base: Pose) -> None:
        """Return None, because any orientation is allowed."""

    def reached(self, arm: Arm, base: Pose) -> str | Rejection:
        """Return "" if the tool reaches the position without a collision, else the reason."""
        solver = Solver(self._robot, arm.tool_frame)
        (postures,) = solver.search([(self.position, None, base)], thorough=True)
        if not postures[0].reaches():
            return OutOfReach(postures[0].position_error)
        nearest: list[Rejection] = []
        with CollisionChecker(self._robot, solver.joints) as tried:
            for candidate in tried.predict([posture.positions for posture in postures], base):
                pairs = tried.in_the_way(candidate)
                if not pairs:
                    return ""
                nearest.append(Touching(pairs))
        return min(nearest, key=lambda reason: reason.miss())


def _no_free_hand(robot: Object, arm: Arm) -> Unfit | None:
    if arm.hand is None:
        return Unfit("the arm has no gripper")
    in_hand = held(robot, arm)
    return Unfit(f"the arm holds {in_hand[0].name}") if in_hand else None


def _rejection(failure: PlanFailure) -> Rejection:
    if isinstance(failure, Blocked):
        return Touching(failure.pairs)
    if isinstance(failure, Unreachable):
        return OutOfReach(failure.distance)
    return Unfit(failure.reason if isinstance(failure, GraspFailed) else str(failure))


def _named(position: Sequence[float]) -> str:
    return f"[{', '.join(f'{part:.2f}' for part in position)}]"
