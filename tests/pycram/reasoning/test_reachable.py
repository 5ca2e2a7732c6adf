"""What an arm reaches, proved by going there; what it doesn't, against dense sampling; and what blocks it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import BadArgument, Blocked
from pycram.process_module import ProcessModule
from pycram.reasoning.kinematics.forward import Chain
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pycram.reasoning.queries.query import Verdict
    from recorder.geometry import Pose

LEFT, RIGHT = "l_gripper_tool_frame", "r_gripper_tool_frame"
DRAWER = "sink_area_left_upper_drawer_main_joint"


@pytest.fixture(scope="module")
def robot() -> Iterator[Object]:
    """Alone in the world."""
    with BulletWorld() as world:
        pr2 = Object("pr2", "robot", "pr2.urdf", [0.3, -0.2, 0], list(geometry.from_rpy(0, 0, 0.7)))
        for arm in pr2.description.arms.values():
            pr2.set_joint_positions(arm.posture("park"))
        assert world.robot is None
        yield pr2


def arm_of(robot: Object, link: str) -> Chain:
    arm = robot.description.arm_of(link)
    return Chain(robot.urdf, arm.base_link, arm.tool_frame, arm.joints)


def in_world(robot: Object, pose: tuple[Sequence[float], Sequence[float]]) -> Pose:
    return geometry.multiply(robot.get_link_position_and_orientation("torso_lift_link"), pose)


def goes_there(robot: Object, link: str, verdict: Verdict) -> Pose:
    """Applies the evidence in a copy of the robot; setting refuses what is beyond limits."""
    with BulletWorld() as world:
        copy = Object("copy", "robot", "pr2.urdf", *robot.get_position_and_orientation())
        assert copy.world is world
        copy.set_joint_positions(robot.get_joint_positions())
        copy.set_joint_positions(verdict.evidence["joints"])
        position, orientation = copy.get_link_position_and_orientation(link)
    return tuple(position), tuple(orientation)


def random_postures(robot: Object, link: str, count: int, seed: int) -> np.ndarray:
    lower, upper = zip(*(robot.joint_limits(name) for name in robot.description.arm_of(link).joints), strict=True)
    low, high = np.maximum(lower, -math.pi), np.minimum(upper, math.pi * 2)
    low, high = np.where(np.isinf(lower), -math.pi, low), np.where(np.isinf(upper), math.pi, high)
    return low + np.random.default_rng(seed).random((count, len(lower))) * (high - low)


@pytest.mark.parametrize("link", [LEFT, RIGHT])
@pytest.mark.slow
def test_every_pose_of_a_random_posture_is_reached(robot: Object, link: str) -> None:
    for pose in arm_of(robot, link).poses(random_postures(robot, link, 40, 3)):
        position, turn = in_world(robot, (pose[:3, 3], geometry.from_matrix(pose[:3, :3])))
        verdict = btr.reachable_pose(position, robot, link, orientation=turn)
        assert verdict, verdict.evidence
        assert btr.reachable_pose(position, robot, link)
    there = goes_there(robot, link, verdict)
    assert math.dist(there[0], position) < 0.01
    assert geometry.angle(there[1], turn) < math.radians(2)


@pytest.mark.costly
@pytest.mark.parametrize("link", [LEFT, pytest.param(RIGHT, marks=pytest.mark.long)])
def test_spheres_around_the_shoulder_against_dense_sampling(robot: Object, link: str) -> None:
    arm = arm_of(robot, link)
    reached = np.vstack([arm.poses(random_postures(robot, link, 50_000, seed))[:, :3, 3] for seed in range(4)])
    rng = np.random.default_rng(1)
    verdicts = []
    for radius in (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95, 1.0, 1.03, 1.1, 1.5):
        for _ in range(8):
            direction = rng.normal(size=3)
            target = arm.shoulder + radius * direction / np.linalg.norm(direction)
            verdict = btr.reachable_pose(in_world(robot, (target, (0, 0, 0, 1)))[0], robot, link)
            nearest = float(np.linalg.norm(reached - target, axis=1).min())
            assert verdict or nearest > 0.01, (radius, target)
            assert not verdict or verdict.evidence["distance"] <= 0.01
            assert radius < 1.02 or not verdict, "the stretched arm is 1.0 m long"
            verdicts.append(bool(verdict))
    assert any(verdicts)
    assert not all(verdicts)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.floats(-0.2, 1.0), st.floats(-0.9, 0.9), st.floats(-0.8, 0.8), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_the_arms_are_mirrors_and_solutions_hold(
    robot: Object, x: float, y: float, z: float, yaw: float, pitch: float
) -> None:
    left = in_world(robot, ((x, y, z), geometry.from_rpy(0, pitch, yaw)))
    right = in_world(robot, ((x, -y, z), geometry.from_rpy(0, pitch, -yaw)))
    by_left = btr.reachable_pose(left[0], robot, LEFT, orientation=left[1])
    by_right = btr.reachable_pose(right[0], robot, RIGHT, orientation=right[1])
    difference = abs(by_left.evidence["distance"] - by_right.evidence["distance"])
    if difference < 1e-3:  # not at the edge of what counts as reached
        assert bool(by_left) is bool(by_right)
    if by_left:
        arm = arm_of(robot, LEFT)
        values = np.array([[by_left.evidence["joints"][name] for name in arm.joints]])
        there = arm.poses(values)[0]
        assert math.dist(in_world(robot, (there[:3, 3], (0, 0, 0, 1)))[0], left[0]) < 0.0101
        limits = [robot.joint_limits(name) for name in arm.joints]
        assert all(low - 1e-9 <= value <= high + 1e-9 for value, (low, high) in zip(values[0], limits, strict=True))


@pytest.mark.parametrize(
    ("position", "grasp", "expected"),
    [
        ([0.7, 0.2, 0.9], None, True),
        ([0.7, 0.2, 0.9], "front", True),
        ([0.55, 0.2, 0.7], "top", True),
        ([0.6, 0.5, 0.9], "right", True),
        ([1.2, 0.2, 0.9], None, False),
        ([0.9, 0.2, 0.9], "top", False),  # within reach, but the hand has to be turned
        ([0.9, 0.2, 0.9], None, True),
        ([-0.6, 0.2, 0.9], None, False),
    ],
)
def test_grasps(world: BulletWorld, position: list[float], grasp: str | None, expected: bool) -> None:
    robot = Object("pr2", "robot", "pr2.urdf")
    cup = Object("cup", "cup", "cup.stl", position)
    verdict = btr.reachable_object(cup, robot, LEFT, grasp=grasp)
    assert bool(verdict) is expected, verdict.evidence


def test_the_threshold_is_the_distance_that_counts_as_reached(robot: Object) -> None:
    arm = arm_of(robot, LEFT)
    beyond = in_world(robot, (arm.shoulder + np.array([1.05, 0, 0]), (0, 0, 0, 1)))[0]
    assert not btr.reachable_pose(beyond, robot, LEFT)
    miss = btr.reachable_pose(beyond, robot, LEFT).evidence["distance"]
    assert 0.04 < miss < 0.06
    assert btr.reachable_pose(beyond, robot, LEFT, threshold=miss + 0.005)


def test_collisions_count_only_if_asked_for(scene: BulletWorld) -> None:
    robot, kitchen, milk = scene.robot, scene.get_object("kitchen"), scene.get_object("milk")
    closed = [1.45, 0.89, 0.72]  # in the drawer
    assert btr.reachable_pose(closed, robot, LEFT)
    verdict = btr.reachable_pose(closed, robot, LEFT, collision_free=True)
    assert not verdict
    assert "kitchen" in verdict.evidence["obstacles"]
    x, y, _ = robot.get_link_position("torso_lift_link")
    chest = [x + 0.05, y + 0.02, 1.0]
    within = btr.reachable_pose(chest, robot, LEFT, collision_free=True)
    assert not within
    assert btr.reachable_object(milk, robot, LEFT, grasp="front", collision_free=True)
    before = [*milk.get_position()]
    bowl = scene.get_object("bowl")
    bowl.set_position([before[0] - 0.07, before[1], before[2] - 0.02])
    blocked = btr.reachable_object(milk, robot, LEFT, grasp="front", collision_free=True)
    assert not blocked
    assert "bowl" in blocked.evidence["obstacles"]
    assert kitchen.get_joint_position(DRAWER) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_many_targets_get_the_same_answers_as_single_ones(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    at = milk.get_position()
    rng = np.random.default_rng(2)
    bases = [
        ([*rng.uniform([0.3, 0.4], [0.9, 1.6]), 0.0], geometry.from_rpy(0, 0, float(rng.uniform(-0.5, 0.5))))
        for _ in range(30)
    ]
    turn = [0, 0, 0, 1]
    found = btr.reachable_poses([at], robot, LEFT, orientations=[turn], bases=bases)
    anywhere = btr.reachable_poses([at], robot, LEFT, bases=bases)
    free = btr.reachable_poses([at], robot, LEFT, bases=bases, collision_free=True, ignoring=[milk])
    assert 0 < sum(found) < len(found)
    assert all(more >= less for more, less in zip(anywhere, found, strict=True))
    assert all(more >= less for more, less in zip(anywhere, free, strict=True))
    for base, oriented, some in zip(bases, found, anywhere, strict=True):
        robot.set_position_and_orientation(*base)
        assert btr.reachable_pose(at, robot, LEFT, orientation=turn) == oriented
        assert btr.reachable_pose(at, robot, LEFT) == some
    robot.set_position_and_orientation(*bases[0])
    targets = [[at[0] + 0.1 * i, at[1], at[2]] for i in range(-5, 5)]
    many = btr.reachable_poses(targets, robot, LEFT)
    assert many == [btr.reachable_pose(target, robot, LEFT) for target in targets]
    with pytest.raises(BadArgument, match="orientations"):
        btr.reachable_poses(targets, robot, LEFT, orientations=[turn, turn])


def test_blocking_names_the_objects_and_the_links_that_touch(scene: BulletWorld) -> None:
    robot, kitchen = scene.robot, scene.get_object("kitchen")
    milk, bowl, cereal, spoon = (scene.get_object(name) for name in ("milk", "bowl", "cereal", "spoon"))
    assert btr.blocking(milk, robot, LEFT) == []
    assert btr.blocking(milk, robot, LEFT, grasp="front") == []
    bowl.set_position([1.5, 0.3, 0.886])
    # the drawer is hardly open: only furniture is in the way, and is marked as such
    kitchen.set_joint_position(DRAWER, 0.1)
    found = btr.blocking(spoon, robot, RIGHT)
    assert [body.type for body in found] == ["environment"]
    info = found.evidence["obstacles"]["kitchen"]
    assert info["by"] == ["sink_area_surface"]
    assert any("r_gripper" in link or "r_wrist" in link for link in info["links"])
    kitchen.set_joint_position(DRAWER, 0.3)
    assert btr.blocking(spoon, robot, RIGHT) == []
    kitchen.set_joint_position(DRAWER, 0.0)
    # a wall of things right before it
    x, y, z = milk.get_position()
    cereal.set_position_and_orientation([x - 0.09, y, z + 0.015], geometry.from_rpy(0, 0, math.pi / 2))
    assert cereal in btr.blocking(milk, robot, LEFT, grasp="front")
    assert btr.blocking(milk, robot, LEFT, grasp="front").evidence["obstacles"]["cereal"]["by"] == ["breakfast_cereal"]
    cereal.set_position([x, y - 0.5, z + 0.015])
    # what is behind it or beside it isn't
    bowl.set_position([x + 0.2, y, 0.886])
    assert btr.blocking(milk, robot, LEFT) == []


def test_blocking_never_names_held_objects(scene: BulletWorld) -> None:
    robot, milk, bowl = scene.robot, scene.get_object("milk"), scene.get_object("bowl")
    robot.set_joint_positions(btr.reachable_object(bowl, robot, RIGHT).evidence["joints"])
    bowl.set_position(robot.get_link_position(RIGHT))
    robot.attach(bowl, RIGHT)
    assert bowl not in btr.blocking(milk, robot, LEFT)
    tall = Object("tall", "cereal", "breakfast_cereal.stl", robot.get_link_position(LEFT))
    robot.attach(tall, LEFT)
    assert tall not in btr.blocking(milk, robot, LEFT)


def test_an_object_in_the_other_hand_is_no_obstacle(scene: BulletWorld) -> None:
    robot, cereal = scene.robot, scene.get_object("cereal")
    tall = Object("tall", "cereal", "breakfast_cereal.stl", [1.5, 1.4, 0.85])  # half in the counter
    robot.attach(tall, LEFT)
    found = btr.blocking(cereal, robot, RIGHT)
    assert found == []
    assert found.evidence["reached"] is True


def test_nothing_blocks_a_target_out_of_reach_and_the_evidence_says_so(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    milk.set_position([1.3, 3, 0.95])
    found = btr.blocking(milk, robot, LEFT)
    assert found == []
    assert found.evidence["reached"] is False
    assert found.evidence["distance"] > 0.5


def test_a_target_reached_only_in_self_collision_is_out_of_reach_and_pick_up_says_why(world: BulletWorld) -> None:
    robot = world.robot = Object("pr2", "robot", "pr2.urdf")
    cup = Object("cup", "cup", "cup.stl", [0.1, 0, 0.6])  # before its belly
    found = btr.blocking(cup, robot, LEFT)
    assert found == []
    assert found.evidence["reached"] is False
    assert ["l_forearm_link", "base_link"] in found.evidence["touches_itself"]
    with pytest.raises(Blocked, match=r"its own l_.* would touch"):
        ProcessModule.perform(MotionDesignator([("type", "pick-up"), ("object", cup), ("arm", "left")]))
    assert robot.attachments == {}


def test_reachable_takes_an_orientation_or_a_grasp(world: BulletWorld) -> None:
    robot = Object("pr2", "robot", "pr2.urdf")
    near, far = [0.7, 0.2, 0.9], [0.9, 0.2, 0.9]  # the hand reaches both, but can point down at neither of the far ones
    cup = Object("cup", "cup", "cup.stl", far)
    down = geometry.from_rpy(0, math.pi / 2, 0)
    for target in (cup, far):
        assert btr.reachable(target, robot, LEFT)
        assert btr.reachable(target, robot, LEFT, grasp="front")
        for asked in ({"grasp": "top"}, {"orientation": down}):
            assert not btr.reachable(target, robot, LEFT, **asked)
    table = Object("table", "environment", "kitchen.urdf", [0.0, 0.0, 0.0])
    assert not btr.reachable([1.45, 0.89, 0.72], robot, LEFT, collision_free=True)
    table.remove()
    assert btr.reachable(near, robot, LEFT, orientation=[0, 0, 0, 1], collision_free=True)
    with pytest.raises(BadArgument, match="either a grasp or an orientation"):
        btr.reachable(cup, robot, LEFT, grasp="top", orientation=down)
