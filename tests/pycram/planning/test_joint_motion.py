"""Motions of joints: what is in the way is gone around, and what can't be is said."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import BadArgument, JointLimitError, NoPath, PostureInCollision, UnknownName
from pycram.planning import joint_motion, path, rrt_connect, through, together
from pycram.reasoning.collision import checker
from pycram.reasoning.kinematics import inverse
from pycram.scheduling.schedule import seed_order
from pycram.world.transaction import take_snapshot
from recorder import geometry, records
from recorder.records.text import rejections
from tests.pycram.motions.placing_scenes import box
from tests.pycram.planning.conftest import LEFT, RIGHT
from tests.pycram.planning.random_queries import deepest

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.planning import PlannedMotion
    from tests.conftest import MemorySink


def ends(planned: PlannedMotion) -> tuple[dict[str, float], dict[str, float]]:
    trajectory = planned.trajectory
    assert set(trajectory.velocities[0]) == set(trajectory.velocities[-1]) == {0.0}
    return dict(zip(trajectory.joints, trajectory.positions[0], strict=True)), planned.end


def length(planned: PlannedMotion) -> float:
    width = len(planned.trajectory.joints)
    numbers = planned.search.way_points
    rows = [numbers[start : start + width] for start in range(0, len(numbers), width)]
    return sum(itertools.starmap(math.dist, itertools.pairwise(rows)))


def test_without_obstacles_the_path_is_straight(arm: Object) -> None:
    planned = joint_motion(arm, LEFT)
    assert planned.search.planner == "straight line"
    assert ends(planned) == (RIGHT, LEFT)
    lifts = [row[planned.trajectory.joints.index("elbow_joint")] for row in planned.trajectory.positions]
    assert lifts == pytest.approx([RIGHT["elbow_joint"]] * len(lifts))


@pytest.mark.slow
def test_the_arm_goes_around_obstacles(
    pillar: Object, arm: Object, sink: MemorySink, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = [take_snapshot(body) for body in arm.world.objects]
    planned = joint_motion(arm, LEFT)
    assert [take_snapshot(body) for body in arm.world.objects] == before
    assert planned.search.planner == "RRT-Connect"
    assert length(planned) < 2 * math.dist(RIGHT.values(), LEFT.values())
    assert ends(planned) == (RIGHT, LEFT)
    (query,) = sink.of(records.Query)
    assert query.name == "path"
    assert query.candidates[query.chosen].names == ["RRT-Connect"]
    assert "would touch pillar" in rejections(query)
    evidence = {argument.name: json.loads(argument.json) for argument in query.evidence}
    assert evidence["checks"] == planned.search.checks <= path.MAX_CHECKS
    back = joint_motion(arm, RIGHT, start=LEFT, earlier=[planned])
    assert back.search.planner == "earlier path"
    assert length(back) <= length(planned)
    monkeypatch.setattr(path, "MAX_CHECKS", 60)
    with pytest.raises(NoPath):
        joint_motion(arm, LEFT)
    patient = joint_motion(arm, LEFT, patience=100)
    assert path.MAX_CHECKS < patient.search.checks <= patient.search.max_checks == 100 * path.MAX_CHECKS
    assert max(deepest(arm, planned, 240), deepest(arm, back, 240)) < 5e-3
    pillar.set_position([0.55, 0, 0.75])
    assert joint_motion(arm, RIGHT, start=LEFT, earlier=[planned], patience=100).search.planner != "earlier path"


@pytest.mark.usefixtures("pillar")
def test_a_search_that_overlooks_an_obstacle_ends_before_it(arm: Object, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of searches may be too large to find a thin thing; the path is checked in smaller steps."""
    monkeypatch.setattr(rrt_connect, "search", lambda _, start, goal, *__, **___: (np.array([start, goal]), goal))
    with pytest.raises(NoPath) as failure:
        joint_motion(arm, LEFT)
    assert -1.0 < failure.value.nearest["shoulder_pan_joint"] < 0.0
    assert 1.0 < failure.value.distance < 2.0


@pytest.mark.slow
def test_a_held_object_must_get_around_obstacles_too(arm: Object, tmp_path: Path) -> None:
    tool = arm.get_link_position_and_orientation("gripper_tool")
    reach = math.hypot(*tool[0][:2]) + 0.1
    Object("post", "environment", box(tmp_path, "post", (0.05, 0.05, 0.4)), [reach, 0, tool[0][2]])
    assert joint_motion(arm, LEFT).search.planner == "straight line"
    held = geometry.multiply(tool, ((0.1, 0, 0), geometry.IDENTITY[1]))
    arm.attach(Object("stick", "stick", box(tmp_path, "stick", (0.2, 0.03, 0.03)), *held), "gripper_tool")
    planned = joint_motion(arm, LEFT)
    assert planned.search.planner == "RRT-Connect"
    assert deepest(arm, planned, 240) < 5e-3


def test_ignored_objects_and_links_are_no_obstacles(arm: Object, pillar: Object) -> None:
    assert joint_motion(arm, LEFT, ignored=[pillar]).search.planner == "straight line"
    assert joint_motion(arm, LEFT, ignored_links=[(pillar, pillar.base_link)]).search.planner == "straight line"


def test_a_motion_may_start_from_another_posture(arm: Object, pillar: Object) -> None:
    beyond = RIGHT | {"shoulder_pan_joint": 0.6}
    planned = joint_motion(arm, LEFT, start=beyond)
    assert planned.search.planner == "straight line"
    assert ends(planned) == (beyond, LEFT)
    open_fingers = {"gripper_left_finger_joint": 0.04, "gripper_right_finger_joint": 0.04}
    planned = joint_motion(arm, LEFT, start=beyond | open_fingers)
    assert ends(planned) == (beyond, LEFT)  # fingers count, but aren't moved


def test_a_present_touch_blocks_only_if_it_gets_deeper(arm: Object, tmp_path: Path) -> None:
    def wall(inside: float) -> Object:
        low, high = arm.get_AABB("wrist_3_link")
        at = [(low[0] + high[0]) / 2, high[1] + 0.05 - inside, (low[2] + high[2]) / 2]
        return Object("wall", "environment", box(tmp_path, "wall", (0.05, 0.1, 0.05)), at)

    arm.set_joint_positions(RIGHT | {"shoulder_pan_joint": -0.2})
    wall(0.02)
    away = joint_motion(arm, {"shoulder_pan_joint": -1.0})
    assert away.search.planner == "straight line"
    with pytest.raises(PostureInCollision, match="would touch wall"):
        joint_motion(arm, {"shoulder_pan_joint": 0.0})


def test_a_goal_in_collision_fails_before_a_search(arm: Object, pillar: Object, sink: MemorySink) -> None:
    with pytest.raises(PostureInCollision, match=r"the ur5 arm .* would touch pillar") as failure:
        joint_motion(arm, RIGHT | {"shoulder_pan_joint": 0.0})
    assert failure.value.bodies == ["pillar"]
    (query,) = sink.of(records.Query)
    assert query.chosen == -1


def test_impossible_goals_are_refused_before_a_search(arm: Object, sink: MemorySink) -> None:
    with pytest.raises(JointLimitError, match=r"elbow_joint of ur5 = 9.0: expected a value from -3.14159 to 3.14159"):
        joint_motion(arm, {"elbow_joint": 9.0})
    with pytest.raises(BadArgument, match="nan"):
        joint_motion(arm, {"elbow_joint": math.nan})
    with pytest.raises(UnknownName, match="elbow_joint"):
        joint_motion(arm, {"elbow": 1.0})
    with pytest.raises(BadArgument, match="2 way points for each body"):
        together([(arm, [RIGHT, LEFT]), (arm, [RIGHT])])
    with pytest.raises(BadArgument, match="way points of ur5 with the same joints"):
        through(arm, [RIGHT, {"elbow_joint": 1.0}])
    assert not sink.of(records.Query)


def test_without_a_path_the_failure_has_the_nearest_configuration_and_the_obstacles(
    arm: Object, pillar: Object, sink: MemorySink, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(path, "MAX_CHECKS", 300)
    for x in (-1.3, 1.3):
        Object(f"high{x}", "environment", box(tmp_path, "high", (2.0, 0.1, 3.0)), [x, 0, 1.5])
    goal = RIGHT | {"shoulder_pan_joint": 1.8}
    with pytest.raises(
        NoPath, match=r"no path was found for the ur5 arm: .* \d+ checked configurations.* would touch"
    ) as failure:
        joint_motion(arm, goal)
    found = failure.value
    assert 300 <= found.checks < 400
    assert found.goal == goal
    assert 0.3 < found.distance <= 2.8
    assert math.dist(found.nearest.values(), goal.values()) == pytest.approx(found.distance)
    assert found.pairs[0].body in ("high1.3", "pillar")
    query = sink.of(records.Query)[-1]
    assert f"no path in {found.checks} checks, which came within {found.distance:.2f} of the goal" in rejections(query)
    monkeypatch.setattr(rrt_connect, "search", None)
    with pytest.raises(NoPath, match=f"{found.distance:.2f} from the goal after {found.checks} checked"):
        joint_motion(arm, goal)  # the same search isn't repeated
    assert rejections(sink.of(records.Query)[-1]) == rejections(query)
    pillar.set_position([0, 0, 3])
    with pytest.raises(TypeError, match="not callable"):
        joint_motion(arm, goal)


def test_links_that_are_placed_one_by_one_overlap_as_in_the_whole_robot(shared_scene: BulletWorld) -> None:
    robot, milk = shared_scene.robot, shared_scene.get_object("milk")
    arm = robot.description.arm("left")
    x, y, _ = milk.get_position()
    milk.set_position(robot.get_link_position(arm.tool_frame))
    robot.attach(milk, arm.tool_frame)
    postures = [arm.posture("park") | {arm.joints[0]: 0.1 * turn, arm.joints[1]: 0.1 * turn} for turn in range(12)]
    found = []
    for single in (False, True):
        with checker.CollisionChecker(robot, arm.joints, margin=0.01, single_links=single) as checked:
            every = checked.predict(postures, ([x - 0.5, y, 0.0], geometry.from_rpy(0, 0, 0.1)))
            pairs = [[*checked.pairs(each), *checked.self_pairs([each])[0]] for each in every]
            found.append([checked.depth(each, pair) for each, of in zip(every, pairs, strict=True) for pair in of])
    assert max(found[0]) > 0.0
    assert found[1] == pytest.approx(found[0], abs=1e-5)


def test_joints_without_limits_go_to_the_nearest_equivalent_angle(shared_scene: BulletWorld) -> None:
    robot = shared_scene.robot
    robot.set_joint_position("l_wrist_roll_joint", 3.0)
    planned = joint_motion(robot, {"l_wrist_roll_joint": -3.0})
    assert planned.end["l_wrist_roll_joint"] == pytest.approx(2 * math.pi - 3.0)
    assert planned.trajectory.duration < 1.0


def test_joints_with_limits_go_to_the_nearest_equivalent_angle_within_them(arm: Object) -> None:
    assert joint_motion(arm, {"shoulder_pan_joint": 5.0}).end["shoulder_pan_joint"] == pytest.approx(5.0 - 2 * math.pi)
    arm.set_joint_position("elbow_joint", 3.0)  # which can't go beyond pi
    assert joint_motion(arm, {"elbow_joint": -0.5}).end["elbow_joint"] == -0.5


def test_an_arm_at_its_goal_does_not_move(shared_scene: BulletWorld) -> None:
    robot = shared_scene.robot
    left, right = (robot.description.arm(name) for name in ("left", "right"))
    lifted = right.posture("park") | {"r_shoulder_pan_joint": -1.0}
    assert joint_motion(robot, left.posture("park") | lifted).trajectory.joints == right.joints
    there = joint_motion(robot, left.posture("park"))
    assert (there.trajectory.duration, there.trajectory.joints) == (0.0, left.joints)
    roll, lift = (robot.get_joint_position(name) for name in ("l_forearm_roll_joint", "l_shoulder_lift_joint"))
    motors = {"l_forearm_roll_joint": roll - 2 * math.pi, "l_shoulder_lift_joint": lift + 1e-4}  # as they leave it
    robot.set_joint_positions(motors)
    assert joint_motion(robot, left.posture("park") | lifted).trajectory.joints == right.joints


QUERIES = """
import json, sys
from pathlib import Path
from pycram.bullet_world import BulletWorld, Object
from pycram.planning import joint_motion
from pycram.reasoning.collision import checker
from pycram.reasoning.kinematics import inverse
from pycram.scheduling.schedule import seed_order
from tests.pycram.planning.conftest import LEFT, RIGHT

seed_order(int(sys.argv[1]))
with BulletWorld() as world:
    robot = Object("ur5", "robot", "ur5.urdf")
    robot.set_joint_positions(RIGHT)
    Object("pillar", "environment", sys.argv[2], [0.55, 0, 0.45])
    for other in range(int(sys.argv[3])):
        joint_motion(robot, LEFT | {"elbow_joint": 1.0 + 0.1 * other})
    trajectory = joint_motion(robot, LEFT).trajectory
    sys.stderr.write(json.dumps([trajectory.times, trajectory.positions]))
"""


@pytest.mark.costly
@pytest.mark.slow
def test_the_same_seed_finds_the_same_path_in_another_process_after_other_queries(arm: Object, pillar: Object) -> None:
    try:
        found = []
        for seed in (5, 6):
            seed_order(seed)
            found.append(joint_motion(arm, LEFT).trajectory)
    finally:
        seed_order(None)
    assert found[0] != found[1]
    for others in (0, 2):
        ended = subprocess.run(
            [sys.executable, "-c", QUERIES, "5", pillar.path, str(others)],
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        assert ended.stdout == ""  # OMPL prints nothing
        times, positions = json.loads(ended.stderr)  # and nothing at the end, as of objects that were left
        assert (tuple(times), tuple(map(tuple, positions))) == (found[0].times, found[0].positions)


INTERRUPTED = """
import sys
from pycram.bullet_world import BulletWorld, Object
from pycram.planning import joint_motion, space
from tests.pycram.planning.conftest import LEFT, RIGHT

whole = space.Clearance.free
def free(self, rows):
    if self.checks > 1000:
        raise KeyboardInterrupt
    return whole(self, rows)
space.Clearance.free = free

with BulletWorld() as world:
    robot = Object("ur5", "robot", "ur5.urdf")
    robot.set_joint_positions(RIGHT)
    Object("pillar", "environment", sys.argv[1], [0.55, 0, 0.45])
    joint_motion(robot, LEFT)
"""


@pytest.mark.slow
def test_an_interrupt_ends_a_search_and_is_raised_unchanged(pillar: Object) -> None:
    command = [sys.executable, "-c", INTERRUPTED, pillar.path]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert ended.stderr.endswith("\nKeyboardInterrupt\n")
    assert "nanobind" not in ended.stderr  # which tells of objects that were left


@pytest.mark.slow
@pytest.mark.parametrize(("side", "y"), [("left", 0.85), ("right", 1.15)])
def test_a_parked_arm_gets_over_a_table_close_to_its_robot(world: BulletWorld, side: str, y: float) -> None:
    Object("kitchen", "environment", "kitchen.urdf")
    world.robot = robot = Object("tiago_pro", "robot", "tiago_pro.urdf", [-0.3, 1, 0], [0, 0, 1, 0])
    for each in robot.description.arms.values():
        robot.set_joint_positions(each.posture("park"))
    tool, down = robot.description.arm(side).tool_frame, geometry.from_rpy(0, 1.2, math.pi)
    found = [
        posture.positions
        for posture in inverse.postures(robot, tool, [-1.0, y, 1.05], down)
        if posture.reaches() and not checker.in_the_way(robot, posture.positions)
    ]
    assert found
    planned = joint_motion(robot, found[0])
    assert deepest(robot, planned, 20) < 5e-3
