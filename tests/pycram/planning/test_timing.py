"""Trajectories are as fast as limits allow, and not faster; their corners stay near the path."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError
from pycram.models.robots.description import RobotDescription
from pycram.planning import base_motion, joint_motion, through, timing, together
from pycram.planning.timing import Knots, NoVelocityLimit, Rates
from tests.pycram.planning.conftest import RIGHT

if TYPE_CHECKING:
    from pycram.world.trajectory import Trajectory

PLAN = Path(__file__).parents[3] / "demos" / "fails_to_reach.py"
ENDLESS = np.full(3, math.inf)
RATES = Rates(-ENDLESS, ENDLESS, np.eye(3), np.array([1.0, 2.0, 0.1]), np.array([4.0, 2.0, 0.5]))
ROW = st.lists(st.floats(-2, 2), min_size=3, max_size=3)


def peaks(knots: Knots) -> tuple[np.ndarray, np.ndarray]:
    """The largest velocity and acceleration of each coordinate, from positions at 1,200 Hz."""
    times = np.arange(0, knots.times[-1], 1 / 1200)
    rows = timing.at(knots, times)
    velocities = np.diff(rows, axis=0) * 1200
    return np.abs(velocities).max(axis=0), np.abs(np.diff(velocities, axis=0) * 1200).max(axis=0)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.lists(ROW, min_size=2, max_size=6), st.sampled_from(timing.SPACINGS))
def test_limits_of_velocity_and_acceleration_hold_between_the_knots(path: list[list[float]], spacing: float) -> None:
    knots = timing.timed(np.array(path), RATES, spacing)
    assert (knots.positions[0].tolist(), knots.positions[-1].tolist()) == (path[0], path[-1])
    assert not knots.velocities[[0, -1]].any()
    if len(knots.times) > 2:
        velocities, accelerations = peaks(knots)
        assert (velocities <= RATES.velocities * 1.001).all()
        assert (accelerations <= RATES.accelerations * 1.01).all()


def test_a_straight_line_is_about_as_fast_as_possible() -> None:
    path = np.array([[0, 0, 0], [2.0, 0, 0]])
    fastest = 2.0 / 1.0 + 1.0 / 4.0  # way by velocity, and the time to speed up
    assert fastest <= timing.timed(path, RATES, 0.3).times[-1] < 1.25 * fastest


def test_nearer_way_points_stay_nearer_to_the_path_and_stops_stay_on_it() -> None:
    path = np.array([[0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0], [0, 1.0, 0.2]])
    slow = Rates(-ENDLESS, ENDLESS, np.eye(3), np.ones(3), np.ones(3))

    def away(knots: Knots) -> float:
        rows = timing.at(knots, np.linspace(0, knots.times[-1], 500))
        line = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(path)])
        return float(np.linalg.norm(rows[:, None] - line, axis=2).min(axis=1).max())

    timings = [timing.timed(path, slow, spacing) for spacing in timing.SPACINGS]
    errors = [away(knots) for knots in timings]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] < 0.05
    stops = timing.stopping(path, slow)
    assert away(stops) < 4e-3  # of the line's points from each other
    assert stops.times[-1] > timings[0].times[-1]


def test_a_spline_that_turns_at_a_limit_stays_within_it() -> None:
    path = np.array([[0, 0, 0], [0.9, 0, 0], [1.0, 0.1, 0], [1.0, 1.0, 0]])
    upper = np.array([1.0, 2.0, 2.0])
    free = timing.timed(path, RATES, 0.3)
    assert free.positions[:, 0].max() > 1.001
    limited = timing.timed(path, Rates(-upper, upper, np.eye(3), RATES.velocities, RATES.accelerations), 0.3)
    assert limited.positions[:, 0].max() == 1.0


def test_bodies_that_move_together_reach_their_way_points_together(arm: Object) -> None:
    kitchen = Object("kitchen", "environment", "kitchen.urdf", [5, 0, 0])
    drawer = "sink_area_left_upper_drawer_main_joint"
    postures = [RIGHT | {"shoulder_pan_joint": -1.0 + 0.2 * i} for i in range(6)]
    opened = [{drawer: 0.08 * i} for i in range(6)]
    pulling, sliding = together([(arm, postures), (kitchen, opened)])
    assert (pulling.search.planner, sliding.trajectory.joints) == ("given", (drawer,))
    assert pulling.trajectory.times == sliding.trajectory.times
    ratios = [
        (row[0] + 1.0) / 0.2 - other[0] / 0.08
        for row, other in zip(pulling.trajectory.positions, sliding.trajectory.positions, strict=True)
    ]
    assert max(map(abs, ratios)) < 1e-6
    alone = through(arm, postures)
    assert alone.trajectory.duration <= pulling.trajectory.duration


def speeds(trajectory: Trajectory) -> list[float]:
    times = [i / 240 for i in range(int(trajectory.duration * 240))]
    return [math.hypot(vx, vy) for vx, vy, _ in (trajectory.at(time)[1] for time in times)]


def test_a_base_is_not_faster_in_any_direction(world: BulletWorld) -> None:
    robot = Object("pr2", "robot", "pr2.urdf")
    limit = robot.description.limits.base_velocity
    for degrees in (0, 22.5, 45, 80):
        x, y = 2 * math.cos(math.radians(degrees)), 2 * math.sin(math.radians(degrees))
        fast = max(speeds(base_motion(robot, [x, y, 0], [0, 0, 0, 1]).trajectory))
        assert 0.9 * limit < fast <= limit * 1.001


def test_a_description_sets_the_speed_of_a_robot(world: BulletWorld) -> None:
    own = Object("pr2", "robot", "pr2.urdf").description
    slow = RobotDescription.parse(own.text + "\n[limits]\nbase_velocity = 0.1\nturning_acceleration = 0.5\n")
    robot = Object("slow", "robot", "pr2.urdf", [0, 2, 0], description=slow)
    assert base_motion(robot, [1, 2, 0], [0, 0, 0, 1]).trajectory.duration > 10
    turn = joint_motion(robot, {"head_pan_joint": 1.0}).trajectory.duration
    assert turn == pytest.approx(2 * math.sqrt(1.0 / 0.5), rel=0.25)
    with pytest.raises(AssetError, match=r"only turning_velocity, .* here"):
        RobotDescription.parse(own.text + "\n[limits]\nspeed = 1.0\n")
    with pytest.raises(AssetError, match="base_velocity"):
        RobotDescription.parse(own.text + "\n[limits]\nbase_velocity = 0.0\n")


LIMITLESS = """<robot name="limitless"><link name="base"/><link name="tip"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="10"/></joint></robot>"""


def test_a_robot_without_velocity_limits_gets_defaults_and_one_warning(world: BulletWorld, tmp_path: Path) -> None:
    file = tmp_path / "limitless.urdf"
    file.write_text(LIMITLESS.replace('effort="10"', 'effort="10" velocity="0"'))
    robot = Object("limitless", "robot", file)
    timing._warn.cache_clear()
    with pytest.warns(NoVelocityLimit, match=r"limitless: .* no velocity limit for shoulder; .* 1 rad/s"):
        planned = joint_motion(robot, {"shoulder": 1.5})
    assert planned.trajectory.duration > 1.5
    assert joint_motion(robot, {"shoulder": 1.5}) == planned  # warnings are errors in tests


@pytest.mark.slow
def test_a_plan_of_instant_motions_loads_neither_ompl_nor_toppra(tmp_path: Path) -> None:
    plan = (
        "import runpy, sys\n"
        f"sys.argv = ['pycram', 'run', {str(PLAN)!r}, '--log', {str(tmp_path / 'demo.mcap')!r}]\n"
        "try: runpy.run_module('pycram', run_name='__main__')\n"
        "except SystemExit: pass\n"
        "print({'ompl', 'toppra', 'matplotlib'} & set(sys.modules), 'pybullet' in sys.modules)\n"
    )
    ended = subprocess.run([sys.executable, "-c", plan], capture_output=True, text=True, check=False, timeout=300)
    assert ended.stdout.endswith("set() True\n"), ended.stderr
