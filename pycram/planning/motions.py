"""Motions of joints and bases: on collision-free paths, along way points, or on straight lines."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from copy import copy
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, InCollision, NoPath, PostureInCollision, Unreachable
from pycram.models.robots.description import Arm
from pycram.planning import path, timing
from pycram.planning.path import PlannedMotion, given, search_record, trajectory_of
from pycram.planning.space import MARGIN, Clearance, Space, nearest_turns
from pycram.planning.timing import base_rates, joint_rates, stacked
from pycram.reasoning.choosing import choosing
from pycram.reasoning.collision.checker import CollisionChecker, PostureCandidate
from pycram.reasoning.kinematics.forward import Chain, rotation_error
from pycram.reasoning.kinematics.inverse import search_postures
from pycram.reasoning.places.search import check_drives, check_ground
from pycram.reasoning.rejections import Touching
from pycram.world.joints import checked_positions, coupled
from pycram.world.object import Object
from pycram.world.trajectory import BaseFrame
from pycram.world.transaction import take_snapshot
from recorder import geometry
from recorder.geometry import Pose, PoseLike
from recorder.records.motion import BASE_COORDINATES

if TYPE_CHECKING:
    from pycram.planning.path import Path
    from pycram.planning.timing import Rates

    Array = NDArray[np.float64]

_JOINT_STEP: Final = 0.05  # distance in rad or m of a joint between checked configurations in a search
_THERE: Final = 1e-3  # accuracy of motors in rad or m; a joint that is nearer to its goal doesn't move
_LINE_STEP: Final = 0.01  # motion in m of the tool between neighbouring postures
_LINE_TURN: Final = 0.05  # turn in rad of the tool between neighbouring postures
_JUMP: Final = 0.35  # distance in rad or m of a joint between neighbours; a larger distance means another posture
_ROOM: Final = 3.0  # margin in m of the searched space around start and goal
_WIDER: Final = 9.0  # the same margin for a second search, for example through the next door
_METRES_A_TURN: Final = 0.5  # distance in m that a robot's outline moves when the robot turns by one radian
_BASE_STEP: Final = 0.06  # distance in m between checked poses in a search

#: Failed searches by robot and situation. Plans often try again after other motions, and the same search would fail
#: again.
_failures: WeakKeyDictionary[Object, dict[bytes, NoPath]] = WeakKeyDictionary()


def joint_motion(
    robot: Object,
    goal: Mapping[str, float],
    *,
    start: Mapping[str, float] | None = None,
    ignored: Iterable[Object] = (),
    ignored_links: Collection[tuple[Object, str]] = (),
    seed: int | None = None,
    patience: float = 1.0,
    earlier: Iterable[PlannedMotion] = (),
) -> PlannedMotion:
    """Return a motion of joints to a goal. The robot and held objects touch only objects that they touch at the start.

    Joints without limits move to the nearest equivalent angle. The choice of the path is recorded.

    Args:
        goal: joint positions in rad or m by name. Other joints don't move; neither does an arm that is already at its
            goal.
        start: joint positions at the start, where they differ from the present positions.
        ignored_links: objects with the links that aren't obstacles.
        patience: budget of the search, as a multiple of :data:`pycram.planning.path.MAX_CHECKS` checks.
        earlier: motions of the robot; the way back along one of them is often free, and needs no search.

    Raises:
        UnknownName: The robot has no such joint.
        BadArgument: A position isn't a number, or joints that mimic each other have contradictory positions.
        JointLimitError: The goal is outside a joint's limits.
        PostureInCollision: The robot would touch something at the goal.
        NoPath: The search found no path within its budget.
    """
    ignored = list(ignored)
    wanted = coupled(robot, checked_positions(robot, goal))
    changed = coupled(robot, checked_positions(robot, start or {}))
    with robot.world.lock, choosing("path", robot.world, joints=dict(goal), seed=seed) as choice:
        now = robot.get_joint_positions() | changed
        moved = _Moved(robot, now, wanted)
        others = {name: value for name, value in changed.items() if name not in wanted}
        names = dict.fromkeys((*wanted, *others))
        with CollisionChecker(
            robot, names, ignored, ignored_links=ignored_links, margin=MARGIN, single_links=True
        ) as checker:

            def predict(rows: Array) -> list[PostureCandidate]:
                return checker.predict([moved.posture(row) for row in rows])

            moved.kept |= others
            clearance = Clearance(checker, predict, moved.start, moved.goal)
            if touched := clearance.touched:
                choice.reject(path.STRAIGHT, Touching(touched))
                raise PostureInCollision(moved.arms, list(dict.fromkeys(pair.body for pair in touched)), touched)
            rates = joint_rates(robot, moved.searched)
            space, ends = moved.space(), (moved.start, moved.goal)
            query = path.Query(moved.name, moved.searched, space, *ends, rates, seed, patience=patience)
            failures = _failures.setdefault(robot, {})
            bodies = [
                (body.name, body.model.path, take_snapshot(body), body.attachments.values())
                for body in robot.world.objects
            ]
            search = query.drawn_seed(1), patience, choice.forced, now, ignored, ignored_links
            situation = hashlib.sha256(f"{search} {bodies}".encode()).digest()
            try:
                found = path.find_path(query, clearance, choice, failures.get(situation), moved.ways(earlier))
            except NoPath as no_path:
                failures[situation] = copy(no_path)
                raise
            return _planned(robot, moved, found, clearance.checks)


def _planned(robot: Object, moved: _Moved, found: Path, checks: int) -> PlannedMotion:
    """Return the motion of all moving joints on a path, including the joints that mimic other joints."""
    way_points = moved.with_followers(found.way_points)
    knots = found.knots
    if len(moved.joints) > len(moved.searched):
        rates = joint_rates(robot, moved.joints)
        velocities = np.hstack([knots.velocities, knots.velocities @ moved.slopes])
        knots = timing.slowed(timing.Knots(knots.times, moved.with_followers(knots.positions), velocities), rates)
    return PlannedMotion(trajectory_of(moved.joints, knots), search_record(found, checks, way_points))


class _Moved:
    """The joints that move from a posture with all joints, ``now``, to wanted positions."""

    def __init__(self, robot: Object, now: Mapping[str, float], wanted: Mapping[str, float]) -> None:
        mimics = robot.urdf.mimics if robot.model.loading.mimic else {}
        wanted = _turned(robot, now, wanted)
        arms = robot.description.arms.values() if robot.description else ()
        groups = [group for arm in arms if (group := [name for name in arm.joints if name in wanted])]
        groups += [[name] for name in wanted if not any(name in group for group in groups)]
        moving = [group for group in groups if any(abs(wanted[name] - now[name]) > _THERE for name in group)]
        names = {name for group in moving or groups for name in group}
        followers = [name for name in wanted if name in mimics and mimics[name].leader in wanted]
        # names of the joints that are searched; other moving joints mimic them
        self.searched = tuple(name for name in wanted if name in names and name not in followers)
        self._followers = [name for name in followers if mimics[name].leader in self.searched]
        self.joints = (*self.searched, *self._followers)  # names of all moving joints
        self._robot = robot
        # goal positions of the joints that don't move, by name
        self.kept = {name: wanted[name] for name in wanted if name not in self.joints}
        # (d, n) factors by which the n followers mimic the d searched joints
        self.slopes = np.zeros((len(self.searched), len(self._followers)))
        for column, name in enumerate(self._followers):
            self.slopes[self.searched.index(mimics[name].leader), column] = mimics[name].multiplier
        self._lower, self._upper = np.array([robot.joint_limits(name) for name in self.searched]).reshape(-1, 2).T
        self._slides = np.array([robot.urdf.joint(name).type == "prismatic" for name in self.searched])
        self.start = np.array([now[name] for name in self.searched])  # (d,) positions of the searched joints
        # (d,) goal positions of the searched joints, as the nearest equivalent angles
        self.goal = np.array([wanted[name] for name in self.searched]) if moving else self.start
        self.arms = [arm.name for arm in arms if any(name in self.joints for name in arm.joints)]

    @property
    def name(self) -> str:
        return f"{' and '.join(self.arms)} arm" if self.arms else ", ".join(self.searched)

    def space(self) -> Space:
        """Return the space within the joints' limits, and within half a turn around start and goal."""
        low, high = np.minimum(self.start, self.goal), np.maximum(self.start, self.goal)
        turn = np.where(self._slides, np.inf, np.pi)
        lower, upper = np.maximum(low - turn, self._lower), np.minimum(high + turn, self._upper)
        return Space(np.minimum(lower, low), np.maximum(upper, high), np.ones(len(low)), _JOINT_STEP)

    def posture(self, row: Array) -> dict[str, float]:
        """Return the positions of all joints of the motion by name, for positions (d,) of the searched joints."""
        searched = dict(zip(self.searched, row.tolist(), strict=True))
        followers = self._robot.urdf.followers(searched) if self._followers else {}
        return self.kept | searched | {name: followers[name] for name in self._followers}

    def ways(self, motions: Iterable[PlannedMotion]) -> Iterator[Array]:
        """Yield the paths (n, d) of motions of the same joints, as positions of the searched joints."""
        for motion in motions:
            if motion.trajectory.joints == self.joints:
                yield np.array(motion.search.way_points).reshape(-1, len(self.joints))[:, : len(self.searched)]

    def with_followers(self, rows: Array) -> Array:
        """Return positions (n, joints) of all moving joints for positions (n, d) of the searched joints."""
        if not self._followers:
            return rows
        postures = [self.posture(row) for row in rows]
        return np.array([[posture[name] for name in self.joints] for posture in postures])


def _turned(robot: Object, now: Mapping[str, float], wanted: Mapping[str, float]) -> dict[str, float]:
    """Return the equivalent joint positions that are nearest to the present positions."""
    slides = [robot.urdf.joint(name).type == "prismatic" for name in wanted]
    lower, upper = np.array([robot.joint_limits(name) for name in wanted]).reshape(-1, 2).T
    lower = np.where(slides, np.inf, lower)  # a prismatic joint has no equivalent position
    start, goal = np.array([now[name] for name in wanted]), np.array([*wanted.values()])
    return dict(zip(wanted, nearest_turns(start, goal, lower, upper).tolist(), strict=True))


def through(body: Object, way_points: Sequence[Mapping[str, float]]) -> PlannedMotion:
    """Return the fastest motion of a body's joints along a given path; see :func:`together` for errors."""
    return together([(body, way_points)])[0]


def together(paths: Sequence[tuple[Object, Sequence[Mapping[str, float]]]]) -> list[PlannedMotion]:
    """Return the fastest motions of several bodies, such as an arm and a drawer; they reach their way points together.

    Collisions aren't checked. Corners between distant way points are rounded by up to 0.04 rad.

    Args:
        paths: for each body, way points from its present state to its goal: positions in rad or m by joint name. All
            bodies have the same number of way points; all way points of a body have the same joints.

    Raises:
        UnknownName: A body has no such joint.
        BadArgument: There are no way points, or the numbers of way points or the joints differ.
        JointLimitError: A way point is outside a joint's limits.
    """
    tables: list[Array] = []
    names: list[tuple[str, ...]] = []
    rates: list[Rates] = []
    for body, way_points in paths:
        postures = [coupled(body, checked_positions(body, way_point)) for way_point in way_points]
        if not postures or not postures[0] or any(posture.keys() != postures[0].keys() for posture in postures):
            raise BadArgument("way_points", way_points, f"one or more way points of {body.name} with the same joints")
        if tables and len(postures) != len(tables[0]):
            raise BadArgument("way_points", way_points, f"{len(tables[0])} way points for each body")
        joints = tuple(postures[0])
        tables.append(np.array([[posture[name] for name in joints] for posture in postures]))
        names.append(joints)
        rates.append(joint_rates(body, joints))
    knots = timing.timed(np.hstack(tables), stacked(rates), timing.SPACINGS[0])
    ends = np.cumsum([len(joints) for joints in names])[:-1]
    parts = zip(*(np.split(rows, ends, axis=1) for rows in (knots.positions, knots.velocities)), strict=True)
    every = zip(names, parts, tables, strict=True)
    return [given(joints, timing.Knots(knots.times, *part), table) for joints, part, table in every]


def line(robot: Object, arm: Arm, start: Mapping[str, float], goal: PoseLike) -> list[dict[str, float]]:
    """Return postures, in order, in which an arm's tool moves on a straight line to a pose, and turns uniformly.

    Collisions aren't checked.

    Args:
        start: joint positions in rad or m by name at the start of the line; each returned posture has the same joints.
            Other joints keep their present positions.
        goal: position and orientation of the tool in the world.

    Raises:
        Unreachable: The arm doesn't reach the pose, or would have to change its posture during the motion.
    """
    position, orientation = checks.vector("goal", goal[0]), checks.quaternion("goal", goal[1])
    begin = checked_positions(robot, start)
    values = robot.get_joint_positions() | begin
    chain = Chain(robot.urdf, arm.base_link, arm.tool_frame, arm.joints, values, arm.tool_offset)
    base = robot.get_position_and_orientation()
    root = geometry.multiply(base, robot.urdf.forward_kinematics(values, arm.base_link))
    target = geometry.pose_matrix(geometry.multiply(geometry.invert(root), (position, orientation)))
    posture = np.array([values[name] for name in arm.joints])
    tool = chain.poses(posture[None])[0]
    way = target[:3, 3] - tool[:3, 3]
    turn = rotation_error(tool[None, :3, :3], target[:3, :3])[0]
    count = max(
        1, math.ceil(float(np.linalg.norm(way)) / _LINE_STEP), math.ceil(float(np.linalg.norm(turn)) / _LINE_TURN)
    )
    postures = [begin | dict(zip(arm.joints, posture.tolist(), strict=True))]
    for number in range(1, count + 1):
        share = number / count
        goals, turns = (tool[:3, 3] + share * way)[None], (_rotation(share * turn) @ tool[:3, :3])[None]
        found, reached = search_postures(
            chain, posture[None], goals, turns, np.zeros(1, dtype=np.intp), stop_early=True
        )
        change = found[0] - posture
        moved = np.where(chain.bounded, change, (change + np.pi) % (2 * np.pi) - np.pi)  # no joint moves by half a turn
        left = float(np.linalg.norm(way)) * (1 - (number - 1) / count)
        if not reached[0]:
            raise Unreachable(arm.name, position, left, "the straight line ends there")
        if np.abs(moved).max() > _JUMP:
            raise Unreachable(arm.name, position, left, "from there the arm would have to change its posture")
        posture = posture + moved
        postures.append(begin | dict(zip(arm.joints, posture.tolist(), strict=True)))
    return postures


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) of a rotation vector (3,), whose length is the angle in rad."""
    angle = float(np.linalg.norm(vector))
    x, y, z = (vector / angle if angle else vector).tolist()
    sine = math.sin(angle / 2)
    return geometry.to_matrix((x * sine, y * sine, z * sine, math.cos(angle / 2)))


def base_motion(
    robot: Object,
    position: Sequence[float],
    orientation: Sequence[float],
    *,
    start: tuple[Sequence[float], Sequence[float]] | None = None,
    seed: int | None = None,
) -> PlannedMotion:
    """Return a motion of a robot's base to a pose. The robot touches only objects that it touches at the start.

    All links of the robot in its present posture are checked, and also held objects. Height and lean are constant,
    while x, y and yaw change together. The choice of the path is recorded.

    Args:
        position: xyz of the goal, m.
        orientation: xyzw of the goal.
        start: position and orientation at the start; None for the present pose.

    Raises:
        BadArgument: The goal isn't a pose.
        NotDrivable: The base is fixed, or the goal isn't on its ground.
        InCollision: The robot would touch something at the goal.
        NoPath: The search found no path within :data:`pycram.planning.path.MAX_CHECKS` checks.
    """
    target, turn = checks.vector("position", position), checks.quaternion("orientation", orientation)
    check_drives(robot, target, turn)
    with robot.world.lock, choosing("path", robot.world, position=target, orientation=turn, seed=seed) as choice:
        check_ground(robot, target, turn)
        position, orientation = start or robot.get_position_and_orientation()
        here = (checks.vector("start", position), checks.quaternion("start", orientation))
        begin, end = np.array(_row(here)), np.array(_row((target, turn)))
        frame = BaseFrame.of(here)
        end = nearest_turns(begin, end, np.array([np.inf, np.inf, -np.inf]), np.full(3, np.inf))
        with CollisionChecker(robot, (), all_links=True, margin=MARGIN, single_links=True) as checker:

            def predict(rows: Array) -> list[PostureCandidate]:
                return checker.predict_at([frame.pose(row) for row in rows.tolist()])

            clearance = Clearance(checker, predict, begin, end)
            if touched := clearance.touched:
                choice.reject(path.STRAIGHT, Touching(touched))
                raise InCollision(target, turn, list(dict.fromkeys(pair.body for pair in touched)), touched)
            low, high = np.minimum(begin, end), np.maximum(begin, end)
            rooms = (np.array([room, room, np.pi]) for room in (_ROOM, _WIDER))
            weights = np.array([1.0, 1.0, _METRES_A_TURN])
            space, wider = (Space(low - room, high + room, weights, _BASE_STEP) for room in rooms)
            query = path.Query("base", BASE_COORDINATES, space, begin, end, base_rates(robot), seed, wider)
            found = path.find_path(query, clearance, choice)
    return PlannedMotion(trajectory_of((), found.knots), search_record(found, clearance.checks, found.way_points))


def _row(pose: Pose) -> tuple[float, float, float]:
    return pose[0][0], pose[0][1], geometry.to_rpy(pose[1])[2]
