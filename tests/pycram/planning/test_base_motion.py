"""Motions of a base: around furniture, with the outline that the robot has, on the ground."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import InCollision, NoPath, NotDrivable
from pycram.planning import base_motion, path
from pycram.world.transaction import take_snapshot
from recorder import geometry, records
from recorder.records.text import rejections
from tests.pycram.motions.placing_scenes import box
from tests.pycram.planning.random_queries import deepest

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.planning import PlannedMotion
    from tests.conftest import MemorySink

AHEAD = [3.0, 0.0, 0.0]
UPRIGHT = [0, 0, 0, 1]


@pytest.fixture
def robot(world: BulletWorld) -> Object:
    """A PR2 with parked arms on a floor."""
    Object("floor", "environment", "plane.urdf")
    world.robot = made = Object("pr2", "robot", "pr2.urdf")
    for arm in made.description.arms.values():
        made.set_joint_positions(arm.posture("park"))
    return made


def sideways(planned: PlannedMotion) -> float:
    return max(abs(y) for _, y, _ in planned.trajectory.positions)


def test_the_base_drives_straight_and_turns_on_the_way_if_it_can(robot: Object) -> None:
    turn = geometry.from_rpy(0, 0, 3.0)
    planned = base_motion(robot, AHEAD, turn)
    assert (planned.search.planner, planned.trajectory.joints) == ("straight line", ())
    assert planned.end == pytest.approx({"x": 3.0, "y": 0.0, "yaw": 3.0})
    assert sideways(planned) < 1e-9
    robot.set_orientation(turn)
    back = base_motion(robot, [0, 0, 0], geometry.from_rpy(0, 0, -3.0))
    assert back.end["yaw"] == pytest.approx(2 * math.pi - 3.0)  # the short way round


@pytest.mark.slow
def test_the_base_drives_around_obstacles(robot: Object, tmp_path: Path, sink: MemorySink) -> None:
    Object("island", "environment", box(tmp_path, "island", (0.6, 1.0, 0.9)), [1.5, 0, 0.45])
    before = take_snapshot(robot)
    planned = base_motion(robot, AHEAD, UPRIGHT)
    assert take_snapshot(robot) == before
    assert planned.search.planner == "RRT-Connect"
    assert 0.8 < sideways(planned) < 2.5
    (query,) = sink.of(records.Query)
    assert "would touch island" in rejections(query)
    assert deepest(robot, planned, 60) < 5e-3


@pytest.mark.slow
def test_the_base_makes_a_long_detour_if_there_is_no_short_one(robot: Object, tmp_path: Path) -> None:
    Object("wall", "environment", box(tmp_path, "wall", (0.1, 12.0, 1.0)), [1.5, 0, 0.5])
    planned = base_motion(robot, AHEAD, UPRIGHT)
    assert 6.0 < sideways(planned) < 9.0
    assert deepest(robot, planned, 20) < 5e-3


@pytest.mark.slow
def test_extended_arms_and_held_objects_must_pass(robot: Object, tmp_path: Path) -> None:
    for side in (-1.45, 1.45):
        wall = Object(f"wall{side}", "environment", box(tmp_path, "wall", (0.2, 1.0, 2.0)), [1.5, side, 1.0])
    gap = wall.get_AABB()[0][1]
    assert gap == pytest.approx(0.95, abs=0.01)
    assert base_motion(robot, AHEAD, UPRIGHT).search.planner == "straight line"
    tool = robot.get_link_position_and_orientation("l_gripper_tool_frame")
    rod = Object("rod", "rod", box(tmp_path, "rod", (0.03, 2.6, 0.03)), tool[0], UPRIGHT)
    robot.attach(rod, "l_gripper_tool_frame")
    planned = base_motion(robot, AHEAD, UPRIGHT)
    assert planned.search.planner == "RRT-Connect"
    assert deepest(robot, planned, 60) < 5e-3


def test_impossible_goals_of_a_base_are_refused_before_a_search(
    robot: Object, tmp_path: Path, sink: MemorySink
) -> None:
    Object("island", "environment", box(tmp_path, "island", (0.6, 1.0, 0.9)), [3.0, 0, 0.45])
    with pytest.raises(InCollision, match="would touch island") as failure:
        base_motion(robot, AHEAD, UPRIGHT)
    assert failure.value.position == AHEAD
    assert failure.value.pairs[0].depth > 0.1
    with pytest.raises(NotDrivable, match=r"the wheels would be 0.50 m above the ground"):
        base_motion(robot, [1, 1, 0.5], UPRIGHT)
    with pytest.raises(NotDrivable, match=r"the wheels would be 0.10 m below the ground"):
        base_motion(robot, [1, 1, -0.1], UPRIGHT)
    with pytest.raises(NotDrivable, match="the robot would lean over by 29 degrees"):
        base_motion(robot, [1, 1, 0], geometry.from_rpy(0.5, 0, 0))
    checks = [json.loads(each.json) for query in sink.of(records.Query) for each in query.evidence]
    assert not checks


def test_a_fixed_base_does_not_move(world: BulletWorld) -> None:
    arm = Object("ur5", "robot", "ur5.urdf")
    with pytest.raises(NotDrivable, match="the robot's base is fixed"):
        base_motion(arm, AHEAD, UPRIGHT)


@pytest.mark.slow
def test_among_hundreds_of_objects_the_budget_holds_and_a_blocking_drawer_is_named(
    robot: Object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(path, "MAX_CHECKS", 1000)
    for number in range(500):
        x, y = 0.2 * (number % 25) - 1.0, 2.5 + 0.2 * (number // 25)
        Object(f"thing{number}", "thing", box(tmp_path, "thing", (0.05, 0.05, 0.05)), [x, y, 0.025])
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    robot.set_position([0.1, 0.9, 0])
    goal = [0.6, 0.9, 0]
    assert base_motion(robot, goal, UPRIGHT).search.checks <= 1000
    kitchen.set_joint_position("sink_area_left_middle_drawer_main_joint", 0.45)
    with pytest.raises((InCollision, NoPath), match="would touch sink_area_left_middle_drawer") as failure:
        base_motion(robot, goal, UPRIGHT)
    assert "sink_area_left_middle_drawer" in failure.value.pairs[0].body_link
    monkeypatch.setattr(path, "MAX_CHECKS", 600)
    for side, (x, y) in enumerate(((-1.2, 0), (1.2, 0), (0, -1.2), (0, 1.2))):
        size = (0.05, 2.4, 1.0) if x else (2.4, 0.05, 1.0)
        Object(f"fence{side}", "environment", box(tmp_path, "fence", size), [-3 + x, -3 + y, 0.5])
    robot.set_position([-3, -3, 0])
    with pytest.raises(NoPath, match="no path was found for the base") as trapped:
        base_motion(robot, [1.0, -3.0, 0], UPRIGHT)
    assert 600 <= trapped.value.checks < 800
    assert "fence" in trapped.value.pairs[0].body
