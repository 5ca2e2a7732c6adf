"""How motions are carried out: at once, as in the thesis, or in simulated time.

Process modules decide what is to get where, and look at what came of it; an execution gets it there. What it is asked
for is planned when it is asked, with the world's lock held, so that a motion fails before anything has moved; it is
done when what was returned is called, without the lock.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

from pycram import planning
from pycram.foundation.failures import Displaced, NoPath, PlanFailure, WorldClosed
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.grasping import fingers
from pycram.world import driving, simulation
from pycram.world.simulation import RestDetector
from recorder import geometry
from recorder.records import STEPS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from contextlib import AbstractContextManager

    from pycram.models.robots.description import Arm
    from pycram.world.object import Object
    from pycram.world.trajectory import Trajectory
    from pycram.world.world import BulletWorld
    from recorder.geometry import Pose, Vector


#: Does what was planned.
Step: TypeAlias = Callable[[], None]

TIMEOUT: Final = 5
"""Seconds of simulated time within which all has to be at rest."""

_STRAIGHT: Final = (0.1, 0.06, 0.03)  # m of straight line that are tried
_BACK: Final = (-1.0, 0.0, 0.0)  # out of what the tool is in, in its frame
_UP: Final = (0.0, 0.0, 1.0)
_LOOKS: Final = 15  # a second, at which it is looked whether two parts of a robot meet
_SAME: Final = 1e-4  # rad or m between positions of a joint that is to stay


class Execution(ABC):
    """How joints and bases get from where they are to where they shall be.

    All but :meth:`whole` and :meth:`settle` return what does it, and raise PlanFailure if there is no way there.

    Attributes:
        takes_time: Whether simulated time passes meanwhile, in which others move too.
    """

    takes_time: bool

    @abstractmethod
    def whole(self, world: BulletWorld) -> AbstractContextManager[None]:
        """Return the context that all of a motion is carried out in."""

    @abstractmethod
    def drive(self, robot: Object, position: Sequence[float], orientation: Sequence[float]) -> Step:
        """Get the base to a pose: xyz in m, xyzw."""

    @abstractmethod
    def move(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Get joints to positions in rad or m by name, past what is in the way."""

    @abstractmethod
    def approach(
        self,
        robot: Object,
        arm: Arm,
        posture: Mapping[str, float],
        direction: Vector,
        *,
        opened: Mapping[str, float] | None = None,
        ignored: Sequence[Object] = (),
        ignored_links: Sequence[tuple[Object, str]] = (),
    ) -> Step:
        """Get an arm to a posture, the last centimetres straight.

        Args:
            robot: The robot.
            arm: The arm.
            posture: Positions in rad or m by joint.
            direction: From which the tool comes: a unit vector in the tool frame of that posture.
            opened: Positions of the gripper's joints, to which it is brought before.
            ignored: What the hand may touch on the last centimetres.
            ignored_links: The same, by objects and links of theirs.
        """

    @abstractmethod
    def grip(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Get a gripper's joints to positions where nothing stops the fingers."""

    @abstractmethod
    def open(self, robot: Object, arm: Arm) -> Step:
        """Open a gripper as far as it gets."""

    @abstractmethod
    def close(self, robot: Object, arm: Arm) -> Step:
        """Close a gripper as far as it gets."""

    @abstractmethod
    def pull(
        self,
        robot: Object,
        container: Object,
        joint: str,
        values: Sequence[float],
        postures: Sequence[Mapping[str, float]],
    ) -> Step:
        """Get an arm that holds a handle through postures, and the handle's joint through their values (rad or m)."""

    @abstractmethod
    def retreat(self, robot: Object, arm: Arm, ignored_links: Sequence[tuple[Object, str]] = ()) -> Step | None:
        """Draw a hand straight back out of what it has let go of; None if it stays where it is.

        Args:
            robot: The robot.
            arm: The arm.
            ignored_links: What the hand may touch on its way, by objects and links of theirs.
        """

    @abstractmethod
    def lift(self, robot: Object, arm: Arm) -> Step | None:
        """Raise what an arm has taken off what it stands on; None if it stays where it is."""

    @abstractmethod
    def settle(self, world: BulletWorld) -> Sequence[Object]:
        """Let simulated time pass until everything is at rest, at most :data:`TIMEOUT`; return what isn't.

        Raises:
            WorldClosed: Another thread has ended the world meanwhile.
        """


class InstantExecution(Execution):
    """Joints and bases are there at once: each change is exact, and no time passes but to settle.

    The world's lock is held over a motion, so nobody sees half of it.
    """

    takes_time = False

    def whole(self, world: BulletWorld) -> AbstractContextManager[None]:
        """Return the world's lock."""
        return world.lock

    def drive(self, robot: Object, position: Sequence[float], orientation: Sequence[float]) -> Step:
        """Put the robot there."""
        return partial(robot.set_position_and_orientation, position, orientation)

    def move(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Put the joints there."""
        return partial(robot.set_joint_positions, positions)

    def approach(
        self,
        robot: Object,
        arm: Arm,  # noqa: ARG002  as below: no way leads there
        posture: Mapping[str, float],
        direction: Vector,  # noqa: ARG002
        *,
        opened: Mapping[str, float] | None = None,
        ignored: Sequence[Object] = (),  # noqa: ARG002
        ignored_links: Sequence[tuple[Object, str]] = (),  # noqa: ARG002
    ) -> Step:
        """Put gripper and arm there."""

        def step() -> None:
            if opened is not None:
                robot.set_joint_positions(opened)
            robot.set_joint_positions(posture)

        return step

    def grip(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Put the fingers there."""
        return partial(robot.set_joint_positions, positions)

    def open(self, robot: Object, arm: Arm) -> Step:
        """Put the fingers as far apart as they get where nothing is."""
        return partial(robot.set_joint_positions, arm.gripper.positions("open"))

    def close(self, robot: Object, arm: Arm) -> Step:
        """Put the fingers together, or through what is between them."""
        return partial(robot.set_joint_positions, arm.gripper.positions("close"))

    def pull(
        self,
        robot: Object,
        container: Object,
        joint: str,
        values: Sequence[float],
        postures: Sequence[Mapping[str, float]],
    ) -> Step:
        """Put the handle's joint, then the arm, to each value."""

        def step() -> None:
            for value, posture in zip(values[1:], postures[1:], strict=True):
                container.set_joint_position(joint, value)
                robot.set_joint_positions(posture)

        return step

    def retreat(
        self,
        robot: Object,  # noqa: ARG002  as above
        arm: Arm,  # noqa: ARG002
        ignored_links: Sequence[tuple[Object, str]] = (),  # noqa: ARG002
    ) -> Step | None:
        """Leave the hand where it is."""
        return None

    def lift(self, robot: Object, arm: Arm) -> Step | None:  # noqa: ARG002  as above
        """Leave it where it is."""
        return None

    def settle(self, world: BulletWorld) -> Sequence[Object]:
        """Simulate, as one change of the world."""
        restless, completed = simulation.settle(world, TIMEOUT * STEPS_PER_SECOND)
        if world.exiting and not completed:
            raise WorldClosed(world.name, "continue its simulation")
        return restless


INSTANT: Final = InstantExecution()


class ContinuousExecution(Execution):
    """Motors follow trajectories on paths without collision, while simulated time passes and others move too.

    The last centimetres to what is grasped, put down or opened are a straight line of the tool: there the hand may
    touch what it is for, and there alone.
    """

    takes_time = True

    def whole(self, world: BulletWorld) -> AbstractContextManager[None]:  # noqa: ARG002  locks none: others go on
        """Return a context of no effect: others go on meanwhile."""
        return nullcontext()

    def drive(self, robot: Object, position: Sequence[float], orientation: Sequence[float]) -> Step:
        """Drive there around what stands there."""
        return _following(robot, partial(planning.base_motion, robot, position, orientation))

    def move(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Move the joints past what is in the way; where no path leads out, each hand is drawn straight back first.

        A hand around an object, as when putting it down was cancelled, has but a narrow way out, which searches miss.
        """
        plan = partial(planning.joint_motion, robot, positions)
        try:
            return _following(robot, plan)
        except NoPath:
            arms = robot.description.arms.values() if robot.description else ()
            lines = (self._line_back(robot, arm) for arm in arms if not positions.keys().isdisjoint(arm.joints))
            back = [line for line in lines if line is not None]
            if not back:
                raise
            start = {joint: at for line in back for joint, at in line[-1].items()}
            following = _following(robot, partial(plan, start=start))
            return _all((*(partial(_along, (robot, line)) for line in back), following))

    def approach(
        self,
        robot: Object,
        arm: Arm,
        posture: Mapping[str, float],
        direction: Vector,
        *,
        opened: Mapping[str, float] | None = None,
        ignored: Sequence[Object] = (),
        ignored_links: Sequence[tuple[Object, str]] = (),
    ) -> Step:
        """Open the gripper, move to some centimetres before the posture, and straight on from there."""
        now = robot.get_joint_positions()
        before = {joint: at for joint, at in (opened or {}).items() if abs(at - now[joint]) > _SAME}
        lifted = {
            joint: at for joint, at in posture.items() if joint not in arm.joints and abs(at - now[joint]) > _SAME
        }
        steps = [self.grip(robot, before)]
        if lifted:
            steps.append(_following(robot, partial(planning.joint_motion, robot, lifted, start=before)))
        start = before | lifted
        end = start | dict(posture)
        ways = (geometry.rotate(_tool_pose(robot, arm, end)[1], direction), _UP)
        line = _line(robot, arm, end, ways, ignored, ignored_links)
        if line is None:  # between the open fingers, what they are for isn't in the way
            goal = {joint: posture[joint] for joint in arm.joints}
            way = partial(planning.joint_motion, robot, goal, start=start, ignored_links=ignored_links)
            return _all((*steps, _following(robot, way)))
        steps.append(_following(robot, partial(planning.joint_motion, robot, line[-1], start=start)))
        return _all((*steps, partial(_along, (robot, line[::-1]))))

    def grip(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Move the fingers there."""
        if not positions:
            return _all(())
        return partial(_along, (robot, [_now(robot, positions), _led(robot, positions)]))

    def open(self, robot: Object, arm: Arm) -> Step:
        """Open the fingers until something stops them."""
        return self.grip(robot, fingers.moved(robot, arm, 1.0).positions)

    def close(self, robot: Object, arm: Arm) -> Step:
        """Close the fingers until something stops them."""
        return self.grip(robot, fingers.moved(robot, arm, 0.0).positions)

    def pull(
        self,
        robot: Object,
        container: Object,
        joint: str,
        values: Sequence[float],
        postures: Sequence[Mapping[str, float]],
    ) -> Step:
        """Move the arm and the handle's joint together, along the joint's own motion."""
        return partial(_along, (robot, postures), (container, [{joint: value} for value in values]))

    def retreat(self, robot: Object, arm: Arm, ignored_links: Sequence[tuple[Object, str]] = ()) -> Step | None:
        """Draw the hand straight back as far as nothing is in the way; None if there is something at once."""
        line = self._line_back(robot, arm, ignored_links)
        return None if line is None else partial(_along, (robot, line))

    @staticmethod
    def _line_back(
        robot: Object, arm: Arm, ignored_links: Sequence[tuple[Object, str]] = ()
    ) -> list[Mapping[str, float]] | None:
        now = _now(robot, arm.joints)
        ways = (geometry.rotate(_tool_pose(robot, arm, now)[1], _BACK), _UP)
        return _line(robot, arm, now, ways, (), ignored_links)

    def lift(self, robot: Object, arm: Arm) -> Step | None:
        """Raise it straight as far as nothing is in the way; None if there is something at once."""
        line = _line(robot, arm, _now(robot, arm.joints), (_UP,))
        return None if line is None else partial(_along, (robot, line))

    def settle(self, world: BulletWorld) -> Sequence[Object]:
        """Wait until everything is at rest, while others move on."""
        with world.lock:
            detector, end = RestDetector(world), world.sim_step + TIMEOUT * STEPS_PER_SECOND
        simulation.wait(world, lambda: detector.sample() or world.sim_step >= end)
        if world.exiting:
            raise WorldClosed(world.name, "continue its simulation")
        return detector.restless


def _led(robot: Object, positions: Mapping[str, float]) -> dict[str, float]:
    """Return positions without those of joints that mimic others of them: motors leave these a little apart."""
    mimics = robot.urdf.mimics if robot.model.loading.mimic else {}
    return {name: at for name, at in positions.items() if name not in mimics or mimics[name].leader not in positions}


def _now(robot: Object, joints: Iterable[str]) -> dict[str, float]:
    """Return where joints are now, within their limits, to which motors keep but nearly; see :func:`_led`."""
    now = robot.get_joint_positions()
    limits = {name: robot.joint_limits(name) for name in _led(robot, {name: now[name] for name in joints})}
    return {name: min(max(lower, now[name]), upper) for name, (lower, upper) in limits.items()}


def _following(robot: Object, plan: Callable[[], planning.PlannedMotion]) -> Step:
    """Return what follows a plan, made now, and anew if what moves stands elsewhere when its turn has come.

    If the robot's other parts would cross its way, it waits until they have passed.
    """
    planned = plan()

    def step() -> None:
        nonlocal planned
        if _displacement(robot, planned) is not None:
            planned = plan()
        active = robot.world.trajectories.active
        while _is_crossed(robot, planned.trajectory):
            simulation.wait(robot.world, lambda: all(each.body is not robot for each in active.values()))
            planned = plan()  # they stand elsewhere now
        _follow(robot.world, [(robot, planned)])

    return step


def _is_crossed(robot: Object, trajectory: Trajectory) -> bool:
    """Return whether parts of a robot that move already would meet those that a trajectory moves, if it began now."""
    with robot.world.lock:
        active = robot.world.trajectories.active.values()
        others = [each for each in active if each.body is robot and each.joints]
        if not others or not trajectory.joints:
            return False
        postures = []
        duration = max(trajectory.duration, *(each.trajectory.duration - each.time for each in others))
        for number in range(math.ceil(duration * _LOOKS) + 1):
            time = number / _LOOKS
            posture = dict(zip(trajectory.joints, trajectory.at(time)[0], strict=True))
            for each in others:
                positions = each.trajectory.at(each.time + time)[0]
                posture |= dict(zip(each.trajectory.joints, positions, strict=True))
            postures.append(posture)
        with CollisionChecker(robot, postures[0]) as checker:
            touching = [checker.self_collisions(candidate) for candidate in checker.predict(postures)]
        first, *rest = ({(pair.mover, pair.link, pair.body_link) for pair in pairs} for pairs in touching)
        return any(pairs - first for pairs in rest)


def _along(*paths: tuple[Object, Sequence[Mapping[str, float]]]) -> None:
    """Move bodies together along way points: joint values in rad or m by name, from where they are on."""
    world = paths[0][0].world
    with world.lock:
        planned = planning.together([(body, _unwound(body, way_points)) for body, way_points in paths])
    _follow(world, [(body, each) for (body, _), each in zip(paths, planned, strict=True)])


def _follow(world: BulletWorld, motions: Sequence[tuple[Object, planning.PlannedMotion]]) -> None:
    """Follow what was planned, together, if all still stand where it begins."""
    for body, planned in motions:
        displaced = _displacement(body, planned)
        if displaced is not None:
            raise Displaced(body.name, *displaced)
    driving.follow(world, motions)


def _displacement(body: Object, planned: planning.PlannedMotion) -> tuple[str, float, float] | None:
    with body.world.lock:
        return driving.displacement(body, planned.trajectory)


def _unwound(body: Object, way_points: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Return way points with joints that turn endlessly at the turn that is nearest to the one before."""
    before: Mapping[str, float] = body.get_joint_positions()
    unwound: list[Mapping[str, float]] = []
    for way_point in way_points:
        before = {
            name: at
            if math.isfinite(body.joint_limits(name)[1])
            else before[name] + math.remainder(at - before[name], math.tau)
            for name, at in way_point.items()
        }
        unwound.append(before)
    return unwound


def _all(steps: Sequence[Step]) -> Step:
    """Return what does one after the other."""

    def step() -> None:
        for each in steps:
            each()

    return step


def _line(
    robot: Object,
    arm: Arm,
    start: Mapping[str, float],
    ways: Sequence[Vector],
    ignored: Sequence[Object] = (),
    ignored_links: Sequence[tuple[Object, str]] = (),
) -> list[Mapping[str, float]] | None:
    """Return the first straight line of those tried on which nothing is touched, from a posture on.

    Args:
        robot: The robot; its world's lock is held.
        arm: The arm whose tool moves.
        start: The posture: positions in rad or m by joint; what isn't named is as it is now.
        ways: Unit vectors in the world, the directions that are tried.
        ignored: Objects that may be touched, but where the line ends. Where it begins, everything may.
        ignored_links: The same, by objects and links of theirs.

    Returns:
        Postures of the arm from the first on; None if there is no such line.
    """
    tool = _tool_pose(robot, arm, start)
    for way, length in itertools.product(ways, _STRAIGHT):
        goal = geometry.transform((tool[0], geometry.IDENTITY[1]), [length * part for part in way]), tool[1]
        try:
            postures = planning.line(robot, arm, start, goal)
        except PlanFailure:
            continue
        if _is_free(robot, start, postures[1:-1], ignored, ignored_links) and _is_free(robot, start, postures[-1:]):
            return [{joint: posture[joint] for joint in arm.joints} for posture in postures]
    return None


def _tool_pose(robot: Object, arm: Arm, positions: Mapping[str, float]) -> Pose:
    """Return the pose in the world that the tool frame of an arm has in a posture."""
    base_T_link = robot.urdf.forward_kinematics(robot.get_joint_positions() | dict(positions), arm.tool_frame)
    return arm.tool_pose(geometry.multiply(robot.get_position_and_orientation(), base_T_link))


def _is_free(
    robot: Object,
    start: Mapping[str, float],
    postures: Sequence[Mapping[str, float]],
    ignored: Sequence[Object] = (),
    ignored_links: Sequence[tuple[Object, str]] = (),
) -> bool:
    """Return whether nothing is touched in postures, but what may be."""
    every = [{**start, **posture} for posture in postures]
    with CollisionChecker(robot, start, ignored, ignored_links=ignored_links) as checker:
        return not any(
            checker.touched(candidate) or checker.self_collisions(candidate) for candidate in checker.predict(every)
        )


IN_SIMULATED_TIME: Final = ContinuousExecution()
