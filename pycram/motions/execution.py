"""Executions of motions: instantaneous, as in the thesis, or in simulated time.

A process module decides where joints and bases go, and checks the outcome; an execution moves joints and bases. Methods
of an execution plan immediately, with the world's lock held, so a motion fails before anything moves. The methods
return a step: a function that moves joints or the base, and is called without the lock.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from contextvars import ContextVar
from functools import partial
from typing import Any, Final, Literal, TypeAlias, TypeVar
from weakref import WeakKeyDictionary

from pycram import planning
from pycram.foundation.failures import Blocked, Displaced, NoPath, PlanFailure, WorldClosed
from pycram.models.robots.description import Arm
from pycram.planning.path import STRAIGHT
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.grasping import fingers
from pycram.world import attachment, driving, simulation
from pycram.world.object import Object
from pycram.world.simulation import RestDetector
from pycram.world.trajectory import Trajectory
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Pose, Vector
from recorder.records import STEPS_PER_SECOND

_Candidate = TypeVar("_Candidate")
Step: TypeAlias = Callable[[], None]  # a function that moves parts of the robot by a plan

TIMEOUT: Final = 5  # maximum simulated time in s until all objects are at rest

LEVEL: Final[ContextVar[bool]] = ContextVar("pycram_level", default=False)
"""Whether motions keep held objects upright; see :func:`pycram.motions.process_module.execution_environment`."""

LEAN: Final = math.radians(15)  # maximum angle by which the tool leans more than at the start of a level motion
_STRAIGHT: Final = (0.1, 0.06, 0.03)  # tried lengths of straight lines, m
_BACK: Final = (-1.0, 0.0, 0.0)  # backward direction of the hand, in the tool frame
_UP: Final = (0.0, 0.0, 1.0)  # upward direction, in the world
_DETOURS: Final = tuple(itertools.product((0.0, 0.1, 0.2, 0.3), (0.0, 0.15, 0.3)))  # lengths of detours in m
_SAMPLES: Final = 15  # checks per second for contacts between moving parts of a robot
_THERE: Final = 0.01  # maximum distance in rad or m of joints from their goal in an arm that needn't move
_PATIENCE: Final = 5  # budget of the last search for a path, as a multiple of the usual budget
_LESS_PATIENCE: Final = 0.25  # budget of the first searches for paths to postures of which one is enough
_MAX_QUICK: Final = 12  # maximum number of postures to which paths are first searched
_MAX_PATIENT: Final = 3  # maximum number of postures to which paths are then searched with the usual budget
_REMEMBERED: Final = 16  # number of motions of joints around obstacles whose paths are tried again
_SAME: Final = 1e-4  # maximum difference in rad or m of equal joint positions

#: The latest motions of joints around obstacles, by robot.
_followed: WeakKeyDictionary[Object, deque[planning.PlannedMotion]] = WeakKeyDictionary()


class Execution:
    """Moves joints and bases to their targets in jumps; time passes only in :meth:`settle`.

    Each change is exact. A motion holds the world's lock, so other threads never see an unfinished motion.
    :class:`ContinuousExecution` moves in simulated time; its steps raise PlanFailure if there is no path.
    """

    takes_time = False  # whether simulated time passes during a motion, so that other motions can continue

    def whole(self, world: BulletWorld) -> AbstractContextManager[None]:
        """Return the context in which all steps of a motion run."""
        return world.lock

    def drive(self, robot: Object, position: Sequence[float], orientation: Sequence[float]) -> Step:
        """Move the base to a position xyz in m and an orientation xyzw."""
        return partial(robot.set_position_and_orientation, position, orientation)

    def move(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Move joints to positions in rad or m by name, around obstacles."""
        return partial(robot.set_joint_positions, positions)

    def move_level(self, robot: Object, arm: Arm, posture: Mapping[str, float]) -> Step:  # noqa: ARG002
        """Move the tool on straight lines to its pose in a posture; the tool turns only about the vertical."""
        return partial(robot.set_joint_positions, posture)

    def approach(
        self,
        robot: Object,
        arm: Arm,  # noqa: ARG002
        posture: Mapping[str, float],
        direction: Vector,  # noqa: ARG002
        *,
        opened: Mapping[str, float] | None = None,
        ignored: Sequence[Object] = (),  # noqa: ARG002
        ignored_links: Sequence[tuple[Object, str]] = (),  # noqa: ARG002
        patience: float = 1.0,  # noqa: ARG002
    ) -> Step:
        """Move an arm to a posture, in rad or m by joint; the last centimetres are a straight line.

        The tool comes from ``direction``, a unit vector in the tool frame of that posture. The gripper's joints first
        move to ``opened``. On the line, the hand may touch ``ignored`` objects, and ``ignored_links`` with the objects
        on them. ``patience`` is the budget of the search for a path, as a multiple of the usual budget.
        """
        return _all([partial(robot.set_joint_positions, each) for each in (opened, posture) if each is not None])

    def grip(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Move the joints of a gripper to positions at which nothing stops the fingers."""
        return partial(robot.set_joint_positions, positions)

    def turn_fingers(self, robot: Object, arm: Arm, share: Literal[0, 1]) -> Step:
        """Close a gripper (0) or open it (1) as far as possible; without simulated time, even through an object."""
        return partial(robot.set_joint_positions, arm.gripper.positions("open" if share else "close"))

    def pull(
        self,
        robot: Object,
        container: Object,
        joint: str,
        values: Sequence[float],
        postures: Sequence[Mapping[str, float]],
    ) -> Step:
        """Move an arm that holds a handle through postures, and the handle's joint through ``values`` in rad or m."""

        def step() -> None:
            for value, posture in zip(values[1:], postures[1:], strict=True):
                container.set_joint_position(joint, value)
                robot.set_joint_positions(posture)

        return step

    def retreat(
        self,
        robot: Object,  # noqa: ARG002
        arm: Arm,  # noqa: ARG002
        ignored_links: Sequence[tuple[Object, str]] = (),  # noqa: ARG002
    ) -> Step | None:
        """Draw a hand straight back from a released object; return None if the hand must not move.

        ``ignored_links`` are links that the hand may touch, with the objects on them.
        """
        return None

    def lift(self, robot: Object, arm: Arm) -> Step | None:  # noqa: ARG002
        """Lift a grasped object off its support; return None if the object must not move."""
        return None

    def settle(self, world: BulletWorld) -> Collection[Object]:
        """Let simulated time pass until all objects are at rest, at most :data:`TIMEOUT`; return objects still moving.

        If another thread closes the world during the simulation, WorldClosed is raised.
        """
        restless, completed = simulation.settle(world, TIMEOUT * STEPS_PER_SECOND)
        if world.exiting and not completed:
            raise WorldClosed(world.name, "continue its simulation")
        return restless


INSTANT: Final = Execution()


class ContinuousExecution(Execution):
    """Motors follow collision-free trajectories while simulated time passes and other motions continue.

    On the last centimetres to an object, a place or a handle, the tool moves on a straight line. Only on this line may
    the hand touch the object or handle.
    """

    takes_time = True

    def whole(self, world: BulletWorld) -> AbstractContextManager[None]:  # noqa: ARG002
        """Return a context that does nothing, so that other motions continue."""
        return nullcontext()

    def drive(self, robot: Object, position: Sequence[float], orientation: Sequence[float]) -> Step:
        """Drive to the pose around obstacles."""
        return _following(robot, partial(planning.base_motion, robot, position, orientation))

    def move(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Move the joints around obstacles. Without a path, move arms one by one, or draw each hand back first.

        After a cancelled placement, an object may be between the fingers. Path searches often miss the narrow way out
        of such a place. The last search has a larger budget: between open drawers, no other motion frees an arm.
        """
        now = robot.get_joint_positions()
        away = [joint for joint, at in _unwound(robot, [positions])[0].items() if abs(at - now[joint]) > _THERE]
        arms = robot.description.arms.values() if robot.description else ()
        moving = [arm for arm in arms if not set(arm.joints).isdisjoint(away)]
        failure: NoPath | None = None
        orders = list(itertools.permutations(moving)) if len(moving) > 1 else []
        for back, patience in ((False, 1), (True, 1), (False, _PATIENCE)):
            lines = [line for arm in moving if back and (line := self._line_back(robot, arm)) is not None]
            if back and not lines:
                continue
            start = {joint: at for line in lines for joint, at in line[-1].items()}
            for order in orders if orders and patience > 1 else (None, *orders):
                try:
                    steps = _in_turn(robot, positions, order, start, patience)
                except NoPath as no_path:
                    failure = failure or no_path
                else:
                    return _all((*(partial(_along, (robot, line)) for line in lines), *steps))
        assert failure is not None  # noqa: S101  at least one search has failed
        raise failure

    def move_level(self, robot: Object, arm: Arm, posture: Mapping[str, float]) -> Step:
        """Move the tool straight to its pose, or through points above and behind its start and its goal."""
        return self._level_way(robot, arm, _now(robot, arm.joints), posture)

    @staticmethod
    def _level_way(robot: Object, arm: Arm, start: Mapping[str, float], posture: Mapping[str, float]) -> Step:
        here, goal = (_tool_pose(robot, arm, {**start, **positions}) for positions in ({}, posture))
        x, y, _ = robot.get_position()
        failures: list[PlanFailure] = []
        for rise, back in _DETOURS:
            corners = []
            for (u, v, w), turn in (here, goal):
                away = math.hypot(u - x, v - y)
                corners.append(((u + back * (x - u) / away, v + back * (y - v) / away, w + rise), turn))
            way = [dict(start)]
            try:
                for corner in (*corners, goal) if rise or back else (goal,):
                    way += planning.line(robot, arm, way[-1], corner)[1:]
                _check_new(robot, arm, way, goal)
            except PlanFailure as failure:
                failures.append(failure)
            else:
                return partial(_along, (robot, way))
        raise failures[0]

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
        patience: float = 1.0,
    ) -> Step:
        """Open the gripper, move to a few centimetres before the posture, and continue on a straight line."""
        now = robot.get_joint_positions()
        before = {joint: at for joint, at in (opened or {}).items() if abs(at - now[joint]) > _SAME}
        lifted = {
            joint: at for joint, at in posture.items() if joint not in arm.joints and abs(at - now[joint]) > _SAME
        }
        steps = [self.grip(robot, before)]
        if lifted:
            steps.append(_following(robot, _joint_plan(robot, lifted, start=before)))
        start = before | lifted
        end = start | dict(posture)
        if level(robot, arm):
            with suppress(PlanFailure):
                return _all((*steps, self._level_way(robot, arm, _now(robot, arm.joints) | lifted, posture)))
            raise NoPath(f"{arm.name} arm", posture, 0, {}, 0.0, [], "the arm has no level path there")
        ways = (geometry.rotate(_tool_pose(robot, arm, end)[1], direction), _UP)
        line = _line(robot, arm, end, ways, ignored, ignored_links)
        if line is None:  # the open fingers may have room around the object
            goal = {joint: posture[joint] for joint in arm.joints}
            way = _joint_plan(robot, goal, start=start, ignored_links=ignored_links, patience=patience)
            return _all((*steps, _following(robot, way)))
        steps.append(_following(robot, _joint_plan(robot, line[-1], start=start, patience=patience)))
        return _all((*steps, partial(_along, (robot, line[::-1]))))

    def grip(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Move the fingers to their positions."""
        if not positions:
            return _all(())
        return partial(_along, (robot, [_now(robot, positions), _led(robot, positions)]))

    def turn_fingers(self, robot: Object, arm: Arm, share: Literal[0, 1]) -> Step:
        """Close (0) or open (1) the fingers until something stops them."""
        return self.grip(robot, fingers.finger_motion(robot, arm, share).positions)

    def pull(
        self,
        robot: Object,
        container: Object,
        joint: str,
        values: Sequence[float],
        postures: Sequence[Mapping[str, float]],
    ) -> Step:
        """Move the arm and the handle's joint together."""
        return partial(_along, (robot, postures), (container, [{joint: value} for value in values]))

    def retreat(self, robot: Object, arm: Arm, ignored_links: Sequence[tuple[Object, str]] = ()) -> Step | None:
        """Draw the hand straight back until it would touch something; return None if it can't move at all."""
        line = self._line_back(robot, arm, ignored_links)
        return None if line is None else partial(_along, (robot, line))

    @staticmethod
    def _line_back(
        robot: Object, arm: Arm, ignored_links: Sequence[tuple[Object, str]] = ()
    ) -> list[Mapping[str, float]] | None:
        now = _now(robot, arm.joints)
        return _line(robot, arm, now, (geometry.rotate(_tool_pose(robot, arm, now)[1], _BACK), _UP), (), ignored_links)

    def lift(self, robot: Object, arm: Arm) -> Step | None:
        """Lift the object straight up until it would touch something; return None if it can't move at all."""
        line = _line(robot, arm, _now(robot, arm.joints), (_UP,))
        return None if line is None else partial(_along, (robot, line))

    def settle(self, world: BulletWorld) -> Collection[Object]:
        """Wait until all objects are at rest, while other motions continue."""
        with world.lock:
            detector, end = RestDetector(world), world.sim_step + TIMEOUT * STEPS_PER_SECOND
        simulation.wait(world, lambda: detector.sample() or world.sim_step >= end)
        if world.exiting:
            raise WorldClosed(world.name, "continue its simulation")
        return detector.restless


def with_patience(candidates: Iterable[_Candidate]) -> Iterator[tuple[_Candidate, float]]:
    """Yield candidates, the best first, each with the patience of the search for a path to it.

    A search mostly finds a path soon or never, so many candidates are first tried with little patience.
    """
    tried = []
    for candidate in itertools.islice(candidates, _MAX_QUICK):
        tried.append(candidate)
        yield candidate, _LESS_PATIENCE
    yield from ((candidate, 1.0) for candidate in tried[:_MAX_PATIENT])


def most_patient(failures: Iterable[NoPath]) -> NoPath:
    """Return the failure of the search with the most checks: the one that says most about what is in the way."""
    return max(failures, key=lambda failure: failure.checks)


def level(robot: Object, arm: Arm) -> bool:
    """Return whether an arm holds an object that has to stay upright."""
    return LEVEL.get() and attachment.attached_to(robot, arm.tool_frame) is not None


def _in_turn(
    robot: Object,
    positions: Mapping[str, float],
    order: Sequence[Arm] | None,
    start: Mapping[str, float],
    patience: int,
) -> list[Step]:
    """Return steps that move joints to positions, together or arm by arm; raise NoPath if a step has no path."""
    parts = [dict(positions)]
    if order is not None:
        of_arms = [{name: at for name, at in positions.items() if name in arm.joints} for arm in order]
        others = {name: at for name, at in positions.items() if not any(name in part for part in of_arms)}
        parts = [of_arms[0] | others, *of_arms[1:]]
    steps = []
    for part in parts:
        plan = partial(_upright, robot, _joint_plan(robot, part, patience=patience), start=start)
        steps.append(_following(robot, plan))
        start = {**start, **part}
    return steps


def _upright(
    robot: Object, plan: Callable[..., planning.PlannedMotion], start: Mapping[str, float] | None = None
) -> planning.PlannedMotion:
    """Return a plan for joints; raise NoPath if an object that must stay upright would lean on the way."""
    planned = plan(start=start)
    for arm in robot.description.arms.values() if robot.description else ():
        if not level(robot, arm) or set(arm.joints).isdisjoint(planned.trajectory.joints):
            continue
        rows = planned.trajectory.positions
        poses = [_tool_pose(robot, arm, dict(zip(planned.trajectory.joints, row, strict=True))) for row in rows]
        first = geometry.conjugate(poses[0][1])
        worst = max(geometry.lean(geometry.product(turn, first), geometry.IDENTITY[1]) for _, turn in poses)
        if worst > LEAN:
            leans = f"the {arm.name} hand would lean by {math.degrees(worst):.0f} degrees on its way"
            raise NoPath(f"{arm.name} arm", planned.end, planned.search.checks, {}, 0.0, [], leans)
    return planned


def _check_new(robot: Object, arm: Arm, way: Sequence[Mapping[str, float]], goal: Pose) -> None:
    """Raise Blocked if the arm would touch an object on its way that it doesn't touch at the start."""
    with CollisionChecker(robot, way[0], single_links=True) as checker:
        first, *others = checker.predict(way)
        known = checker.touched(first)
        for candidate in others:
            new = [each["pair"] for body, each in checker.touched(candidate).items() if body not in known]
            if new := new + checker.self_collisions(candidate):
                raise Blocked(arm.name, goal[0], new, "on the level path to the goal")


def _led(robot: Object, positions: Mapping[str, float]) -> dict[str, float]:
    """Leave out the positions of joints that mimic another given joint, because motors follow a mimic only roughly."""
    mimics = robot.urdf.mimics if robot.model.loading.mimic else {}
    return {name: at for name, at in positions.items() if name not in mimics or mimics[name].leader not in positions}


def _now(robot: Object, joints: Iterable[str]) -> dict[str, float]:
    """Return the present positions of joints without mimics, clipped to the limits, which motors may exceed."""
    now = robot.get_joint_positions()
    limits = {name: robot.joint_limits(name) for name in _led(robot, {name: now[name] for name in joints})}
    return {name: min(max(lower, now[name]), upper) for name, (lower, upper) in limits.items()}


def _joint_plan(robot: Object, goal: Mapping[str, float], **options: Any) -> Callable[..., planning.PlannedMotion]:
    """Return a plan for joints that first tries the ways back along the robot's latest motions."""
    return partial(planning.joint_motion, robot, goal, earlier=_latest(robot), **options)


def _latest(robot: Object) -> deque[planning.PlannedMotion]:
    return _followed.setdefault(robot, deque(maxlen=_REMEMBERED))


def _following(robot: Object, plan: Callable[[], planning.PlannedMotion]) -> Step:
    """Return a step that follows a plan; plan now, and again if the robot has moved when the step begins.

    If other moving parts of the robot would cross the path, the step waits until they have stopped.
    """
    planned = plan()

    def step() -> None:
        nonlocal planned
        if _displacement(robot, planned) is not None:
            planned = plan()
        active = robot.world.trajectories.active
        while _is_crossed(robot, planned.trajectory):
            simulation.wait(robot.world, lambda: all(each.body is not robot for each in active.values()))
            planned = plan()  # the path begins at the new posture
        if planned.trajectory.joints and planned.search.planner != STRAIGHT:
            _latest(robot).append(planned)
        _follow(robot.world, [(robot, planned)])

    return step


def _is_crossed(robot: Object, trajectory: Trajectory) -> bool:
    """Return whether other moving parts of a robot would touch the parts that a new trajectory will move."""
    with robot.world.lock:
        others = [each for each in robot.world.trajectories.active.values() if each.body is robot and each.joints]
        if not others or not trajectory.joints:
            return False
        postures = []
        duration = max(trajectory.duration, *(each.trajectory.duration - each.time for each in others))
        for number in range(math.ceil(duration * _SAMPLES) + 1):
            time = number / _SAMPLES
            posture = dict(zip(trajectory.joints, trajectory.at(time)[0], strict=True))
            for each in others:
                posture |= dict(zip(each.trajectory.joints, each.trajectory.at(each.time + time)[0], strict=True))
            postures.append(posture)
        with CollisionChecker(robot, postures[0], single_links=True) as checker:
            touching = [checker.self_collisions(candidate) for candidate in checker.predict(postures)]
        first, *rest = ({(pair.mover, pair.link, pair.body_link) for pair in pairs} for pairs in touching)
        return any(pairs - first for pairs in rest)


def _along(*paths: tuple[Object, Sequence[Mapping[str, float]]]) -> None:
    """Move bodies together from their present states through way points: joint values in rad or m by name."""
    world = paths[0][0].world
    with world.lock:
        planned = planning.together([(body, _unwound(body, way_points)) for body, way_points in paths])
    _follow(world, [(body, each) for (body, _), each in zip(paths, planned, strict=True)])


def _follow(world: BulletWorld, motions: Sequence[tuple[Object, planning.PlannedMotion]]) -> None:
    """Follow plans together; raise Displaced if a body isn't where its plan begins."""
    for body, planned in motions:
        displaced = _displacement(body, planned)
        if displaced is not None:
            raise Displaced(body.name, *displaced)
    driving.follow(world, motions)


def _displacement(body: Object, planned: planning.PlannedMotion) -> tuple[str, float, float] | None:
    with body.world.lock:
        return driving.displacement(body, planned.trajectory)


def _unwound(body: Object, way_points: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Return way points with equivalent angles of joints without limits: the angles nearest to the angles before."""
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
    """Return the postures of the arm on the first collision-free straight line of the tool; None without such a line.

    The line begins at the posture ``start``. ``ways`` are the tried directions, as unit vectors in the world. Before
    the end of the line, the arm may touch ignored objects and links.
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
    """Return the pose in the world of an arm's tool frame in a posture."""
    base_T_link = robot.urdf.forward_kinematics(robot.get_joint_positions() | dict(positions), arm.tool_frame)
    return arm.tool_pose(geometry.multiply(robot.get_position_and_orientation(), base_T_link))


def _is_free(
    robot: Object,
    start: Mapping[str, float],
    postures: Sequence[Mapping[str, float]],
    ignored: Sequence[Object] = (),
    ignored_links: Sequence[tuple[Object, str]] = (),
) -> bool:
    every = [{**start, **posture} for posture in postures]
    with CollisionChecker(robot, start, ignored, ignored_links=ignored_links, single_links=True) as checker:
        return not any(
            checker.touched(candidate) or checker.self_collisions(candidate) for candidate in checker.predict(every)
        )


IN_SIMULATED_TIME: Final = ContinuousExecution()
