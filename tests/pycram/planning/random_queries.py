"""Random queries for motions of the four robots: an arm among furniture and clutter, with or without a thing, and a base."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pycram.bullet_world import Object
from pycram.planning import PlannedMotion, base_motion, joint_motion, timing
from pycram.planning.path import given
from pycram.planning.timing import base_rates, joint_rates
from pycram.reasoning.collision import checker
from pycram.reasoning.kinematics import inverse
from recorder import geometry
from tests.pycram.motions import household
from tests.pycram.motions.household import HOUSEHOLD, PLACES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from pycram.bullet_world import BulletWorld
    from recorder.geometry import Pose

KINDS = ("arm", "arm with a thing", "base")
_CLUTTER = ("milk", "bowl", "breakfast_cereal", "cup", "bottle", "pot", "glass", "apple")


@dataclass(frozen=True)
class Query:
    """A query: joint values of the arm at the start and the goal, or poses of the base."""

    kind: str
    start: Mapping[str, float]
    goal: Mapping[str, float]
    start_pose: Pose | None = None
    goal_pose: Pose | None = None

    @property
    def ends(self) -> tuple[list[float], list[float]]:
        """Coordinates of start and goal: joint values, or x, y and yaw of the base."""
        if self.start_pose is None or self.goal_pose is None:
            return list(self.start.values()), list(self.goal.values())
        start, goal = ([*at[:2], geometry.to_rpy(turn)[2]] for at, turn in (self.start_pose, self.goal_pose))
        return start, goal

    def plan(self, robot: Object, seed: int | None = None) -> PlannedMotion:
        if self.goal_pose is not None:
            return base_motion(robot, *self.goal_pose, seed=seed)
        return joint_motion(robot, self.goal, seed=seed)


def scenes(robot: str) -> Iterator[BulletWorld]:
    """Yields a world with a robot, furniture, and eight things in front of it."""
    for world in household.build(robot):
        place = PLACES[robot]
        dice = random.Random(robot)
        household.park(world)
        for number, kind in enumerate(_CLUTTER):
            x = place.start[0] + dice.uniform(-0.15, 0.1)
            y = (0.2 if place.top == household.KITCHEN else -0.5) + 0.14 * number
            turn = geometry.from_rpy(0, 0, dice.uniform(-3, 3))
            Object(kind, kind, f"{kind}.stl", [x, y, place.top + HOUSEHOLD[kind]], turn)
        world.simulate(1.0)
        yield world


def query(world: BulletWorld, place: household.Place, seed: int) -> Query:
    """Puts the robot where a query begins, with a thing in its hand if it is to have one, and returns the query."""
    dice = random.Random(seed)
    robot = world.robot
    kind = KINDS[seed % 3] if robot.description.drives else KINDS[seed % 2]
    arm = robot.description.arm(place.arm)
    household.park(world)
    robot.set_position_and_orientation(*robot.original_pose)
    if kind == "base":
        start, goal = (_free_pose(robot, dice) for _ in range(2))
        robot.set_position_and_orientation(*start)
        return Query(kind, {}, {}, start, goal)
    if kind == "arm with a thing":
        thing = dice.choice(("spoon", "knife", "fork"))
        pose = geometry.multiply(
            robot.get_link_position_and_orientation(arm.tool_frame),
            arm.tool_pose(((0.03, 0.0, 0.0), geometry.from_rpy(0, 0, math.pi / 2))),
        )
        robot.attach(Object("held", thing, f"{thing}.stl", *pose), arm.tool_frame)
    start, goal = (_free_posture(robot, arm, place, dice) for _ in range(2))
    robot.set_joint_positions(start)
    return Query(kind, start, goal)


def along(robot: Object, query: Query, way_points: Sequence[Sequence[float]]) -> PlannedMotion:
    """Returns a motion along way points, at each of which it rests."""
    path, joints = np.array(way_points), tuple(query.goal)
    rates = joint_rates(robot, joints) if joints else base_rates(robot)
    return given(joints, timing.stopping(path, rates), path)


def end(world: BulletWorld) -> None:
    """Takes the thing out of the hand."""
    for held in world.get_objects_by_name("held"):
        held.remove()


def _free_pose(robot: Object, dice: random.Random) -> Pose:
    while True:
        turn = geometry.from_rpy(0, 0, dice.uniform(-math.pi, math.pi))
        pose = (dice.uniform(-2.0, 2.5), dice.uniform(-2.0, 3.0), 0.0), turn
        with robot.world.lock:
            if not checker.touched(robot, {}, pose, all_links=True):
                return pose


def _free_posture(robot: Object, arm, place: household.Place, dice: random.Random) -> Mapping[str, float]:
    """Returns a posture in which nothing is touched: with the tool at a random place in reach, or any."""
    while True:
        if dice.random() < 0.5:
            posture = {}
            for name in arm.joints:
                low, high = robot.joint_limits(name)
                posture[name] = dice.uniform(max(low, -math.pi), min(high, math.pi))
        else:
            x, y = place.start
            target = [x + dice.uniform(-0.3, 0.15), y + dice.uniform(-0.6, 0.5), place.top + dice.uniform(-0.4, 0.5)]
            turn = geometry.from_rpy(dice.uniform(-0.5, 0.5), dice.uniform(0.0, 1.6), dice.uniform(-1.5, 1.5))
            found = [
                each for each in inverse.postures(robot, arm.tool_frame, target, turn, thorough=True) if each.reaches()
            ]
            if not found:
                continue
            posture = dice.choice(found).positions
        with robot.world.lock:
            if not checker.in_the_way(robot, posture):
                return posture


def deepest(robot: Object, planned: PlannedMotion, rate: float) -> float:
    """Moves a robot along a trajectory, and returns how much deeper than at the start it gets into anything, m."""
    trajectory, world = planned.trajectory, robot.world
    engine = world.engine
    start = robot.get_position_and_orientation()
    known: dict[tuple[str, str, str], float] = {}
    movers = [robot, *(held.body for held in robot.carried)]
    most = 0.0
    times = [number / rate for number in range(int(trajectory.duration * rate) + 1)] + [trajectory.duration]
    for time in times:
        row, _ = trajectory.at(time)
        if trajectory.joints:
            limits = map(robot.joint_limits, trajectory.joints)  # between its rows it may leave them by 1e-3
            values = [min(max(value, low), high) for value, (low, high) in zip(row, limits, strict=True)]
            robot.set_joint_positions(dict(zip(trajectory.joints, values, strict=True)))
        else:
            turn = geometry.product(geometry.from_rpy(0, 0, row[2] - geometry.to_rpy(start[1])[2]), start[1])
            robot.set_position_and_orientation([row[0], row[1], start[0][2]], turn)
        for mover in movers:
            for body in world.objects:
                if body in movers or body.name == "floor":
                    continue
                for point in engine.closest_points(mover.handle, body.handle):
                    key = point.link_a, body.name, point.link_b
                    if time == 0:
                        known[key] = max(known.get(key, 0.0), -point.distance)
                    most = max(most, -point.distance - known.get(key, 0.0))
    return most
