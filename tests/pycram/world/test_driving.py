"""Bodies that follow trajectories: how near, what goes along, what is refused meanwhile, and how they stop."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import (
    BadArgument,
    FollowsTrajectory,
    JointLimitError,
    TrackingLost,
    TrajectoryEnded,
    UnknownName,
)
from pycram.language import par
from pycram.world.driving import LOST, follow
from pycram.world.simulation import wait
from pycram.world.trajectory import Trajectory
from recorder import geometry
from recorder.records import Mutation
from tests.smooth_motions import Given, drive, move, smooth, to

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.conftest import MemorySink

CABINET = Path(__file__).parents[2] / "replay" / "golden" / "cabinet.urdf"
SWING = {"shoulder_pan_joint": 0.6, "elbow_joint": 0.9, "wrist_1_joint": -0.5}


@pytest.fixture
def ur5(world: BulletWorld) -> Object:
    world.set_gravity([0, 0, -9.81])
    return Object("ur5", "robot", "ur5.urdf", [0, 0, 1])


def each_step(world: BulletWorld, look: Callable[[], None]) -> None:
    """Have something looked at after each step of the engine, not only where the world tells."""
    step = world.engine.step

    def stepped(steps: int) -> None:
        step(steps)
        look()

    world.engine.step = stepped  # type: ignore[method-assign]


def falling(world: BulletWorld) -> Object:
    """Something far away that falls, so the engine simulates all the time."""
    return Object("apple", "apple", "apple.stl", [50, 0, 1000])


ARMS = {
    "ur5.urdf": SWING,
    "panda.urdf": {"panda_joint1": 0.7, "panda_joint2": 0.6, "panda_joint4": -1.0, "panda_joint6": 1.2},
    "pr2.urdf": {"l_shoulder_pan_joint": 0.9, "l_elbow_flex_joint": -1.2, "l_wrist_flex_joint": -0.9},
    "tiago_pro.urdf": {"arm_left_1_joint": 0.6, "arm_left_2_joint": -0.6, "torso_lift_joint": 0.2},
}


@pytest.mark.slow
@pytest.mark.parametrize("file", ARMS)
def test_an_arm_is_where_its_trajectory_says_in_each_step(world: BulletWorld, file: str) -> None:
    world.set_gravity([0, 0, -9.81])
    robot = Object("robot", "robot", file, [0, 0, 1])
    falling(world)
    trajectory = to(robot, ARMS[file], 1.0)
    errors: list[float] = []

    def look() -> None:
        at = trajectory.at((len(errors) + 1) / 240)[0]
        errors.append(max(abs(robot.get_joint_position(name) - x) for name, x in zip(ARMS[file], at, strict=True)))

    each_step(world, look)
    follow(world, [(robot, Given(trajectory))])
    assert len(errors) == 240
    assert max(errors) < 1e-3


def test_a_motion_takes_its_time_and_is_one_record(ur5: Object, sink: MemorySink) -> None:
    world = ur5.world
    move(ur5, SWING, 0.5)
    assert world.sim_step == 120
    assert ur5.get_joint_positions() == pytest.approx(dict.fromkeys(ur5.joints, 0.0) | SWING, abs=1e-3)
    begun, driven = sink.of(Mutation)[-2:]
    assert begun.begin_trajectory.number == 1
    assert Trajectory.of_record(begun.begin_trajectory.trajectory).duration == 0.5
    assert [(each.number, each.body, each.time, each.ended) for each in driven.simulate.driven] == [
        (1, "ur5", 0.5, True)
    ]
    assert 0 < driven.simulate.driven[0].error < 1e-3
    assert driven.simulate.driven[0].joint in ur5.joints
    assert len(driven.effect.samples) == 14  # and the effect itself


def test_motors_hold_the_end_of_a_trajectory(ur5: Object) -> None:
    move(ur5, SWING, 0.3)
    ur5.world.simulate(1)
    assert ur5.get_joint_position("elbow_joint") == pytest.approx(0.9, abs=1e-3)


def test_a_base_drives_with_what_is_attached_and_stays_level(ur5: Object) -> None:
    world = ur5.world
    ur5.set_position_and_orientation([1, 2, 0.7], geometry.from_rpy(0, 0.05, 3.0))
    cup = Object("cup", "cup", "cup.stl", [1, 2, 2])
    ur5.attach(cup)
    before = geometry.multiply(geometry.invert(world.engine.pose(ur5.handle)), world.engine.pose(cup.handle))
    apart = []

    def look() -> None:
        now = geometry.multiply(geometry.invert(world.engine.pose(ur5.handle)), world.engine.pose(cup.handle))
        apart.append(math.dist(now[0], before[0]))

    each_step(world, look)
    drive(ur5, [1, 2, 3.0 - math.tau], [1.5, 2.2, 4.0 - math.tau], 1.0)  # almost 1 m/s; yaw is the same, turned
    position, orientation = ur5.get_position_and_orientation()
    assert position == pytest.approx([1.5, 2.2, 0.7], abs=1e-12)
    assert geometry.angle(orientation, geometry.from_rpy(0, 0.05, 4.0)) < 1e-6
    assert max(apart) < 1e-3


def test_what_is_held_stays_in_a_fast_hand(ur5: Object) -> None:
    world, link = ur5.world, "tool0"
    cup = Object("cup", "cup", "cup.stl", ur5.get_link_position(link))
    ur5.attach(cup, link)
    pose = ur5.attachments[cup].pose
    apart = []

    def look() -> None:
        hand = geometry.invert(world.engine.link_pose(ur5.handle, link))
        apart.append(math.dist(geometry.multiply(hand, world.engine.pose(cup.handle))[0], pose[0]))

    falling(world)
    each_step(world, look)
    move(ur5, {"shoulder_pan_joint": 1.0, "elbow_joint": 1.0}, 1.0)  # 1.9 rad/s
    assert len(apart) == 240
    assert max(apart) < 1e-3


def test_the_engine_rests_while_only_an_arm_moves(ur5: Object) -> None:
    """It simulates whatever falls, is touched, or loses its hold, as if the arm never coasted."""
    world, steps = ur5.world, []
    each_step(world, lambda: steps.append(world.sim_step))
    cup = Object("cup", "cup", "cup.stl", geometry.transform(world.engine.link_pose(ur5.handle, "tool0"), (0, 0, 0.2)))
    ur5.attach(cup, "tool0")
    held = ur5.attachments[cup].pose
    move(ur5, {"shoulder_pan_joint": 1.0}, 2.0)
    assert len(steps) < 120, "until all is known to be at rest, and the last interval"
    hand = geometry.invert(world.engine.link_pose(ur5.handle, "tool0"))
    assert geometry.multiply(hand, world.engine.pose(cup.handle))[0] == pytest.approx(held[0], abs=1e-6)
    move(ur5, {"shoulder_pan_joint": 1.5}, 0.5)
    ur5.detach(cup)
    high = cup.get_position()[2]
    move(ur5, {"shoulder_pan_joint": 0.0}, 1.0)
    assert high - cup.get_position()[2] > 4.0, "it fell for a second"
    cup.remove()
    x, y, z = geometry.transform(world.engine.link_pose(ur5.handle, "tool0"), (0, 0, 0.0))
    Object("table", "environment", "table.urdf", [x - 0.2, y, z - 0.78])
    milk = Object("milk", "milk", "milk.stl", [x, y, z + 0.03])
    move(ur5, {"shoulder_pan_joint": 0.6}, 1.0)
    milk.set_position([x, y, z + 0.03], [0, 0, 0, 1])
    world.settle()
    before = milk.get_position()
    steps.clear()
    move(ur5, {"shoulder_pan_joint": -0.6}, 2.0)
    assert math.dist(before, milk.get_position()) > 0.1, "the arm pushed it"
    assert len(steps) > 30


def test_a_drawer_follows_and_takes_along_what_lies_in_it(world: BulletWorld) -> None:
    world.set_gravity([0, 0, -9.81])
    cabinet = Object("cabinet", "environment", CABINET, [0, 0, 0.6])
    lower, upper = cabinet.get_AABB("drawer")
    apple = Object("apple", "apple", "apple.stl", [(lower[0] + upper[0]) / 2, 0, upper[2] + 0.04])
    world.settle()
    start = apple.get_position()[0]
    moved = []
    event = world.get_manipulation_event()
    event += moved.append
    move(cabinet, {"drawer_joint": 0.25}, 1.5)
    assert cabinet.get_joint_position("drawer_joint") == pytest.approx(0.25, abs=1e-3)
    assert abs(apple.get_position()[0] - start) == pytest.approx(0.25, abs=0.1)
    assert cabinet in moved


@pytest.mark.slow
def test_joints_that_mimic_one_follow_too(world: BulletWorld) -> None:
    robot = Object("panda", "robot", "panda.urdf", [0, 0, 1])
    (follower, mimic), *_ = robot.urdf.mimics.items()
    move(robot, {mimic.leader: 0.03}, 0.4)
    assert robot.get_joint_position(follower) == pytest.approx(mimic.multiplier * 0.03 + mimic.offset, abs=1e-3)


def test_a_stopped_trajectory_ends_soon_and_on_its_path(ur5: Object) -> None:
    world = ur5.world
    number = world.begin_trajectory(ur5, to(ur5, SWING, 1.0))
    world.simulate(0.5)
    world.stop_trajectory(number)
    stopped = world.sim_step
    shares = []
    while world.trajectories.active:
        world.simulate_steps(1)
        shares.append([ur5.get_joint_position(name) / goal for name, goal in SWING.items()])
    assert world.sim_step - stopped <= 0.2 * 240
    assert all(max(each) - min(each) < 1e-3 for each in shares)
    speeds = [b[0] - a[0] for a, b in pairwise(shares)]
    assert speeds[0] > 10 * speeds[-1]
    world.simulate(0.5)
    assert ur5.get_joint_position("elbow_joint") / 0.9 == pytest.approx(shares[-1][1], abs=1e-3)


def test_what_hasnt_moved_yet_is_stopped_at_once(ur5: Object) -> None:
    world = ur5.world
    world.stop_trajectory(world.begin_trajectory(ur5, to(ur5, SWING, 1.0)))
    assert not world.trajectories.active


def test_what_follows_a_trajectory_cant_be_set_by_hand(ur5: Object) -> None:
    world = ur5.world
    world.begin_trajectory(ur5, to(ur5, SWING, 1.0))
    with pytest.raises(
        FollowsTrajectory, match=r"trajectory 1 moves elbow_joint of ur5; .* stop_trajectory\(1\)"
    ) as error:
        ur5.set_joint_positions({"elbow_joint": 0.1, "wrist_3_joint": 0.1})
    assert (error.value.number, error.value.joints) == (1, ("elbow_joint",))
    with pytest.raises(FollowsTrajectory):
        world.begin_trajectory(ur5, to(ur5, {"elbow_joint": 0.2}, 1.0))
    with pytest.raises(FollowsTrajectory, match="save the state"):
        world.save()
    ur5.set_joint_position("wrist_3_joint", 0.1)
    ur5.set_position([3, 0, 1])  # the arm's trajectory is one of joints
    second = world.begin_trajectory(ur5, smooth((), [3, 0, 0], [4, 0, 0], 1.0))
    with pytest.raises(FollowsTrajectory, match="the base of ur5"):
        ur5.set_position([0, 0, 0])
    assert second == 2
    world.simulate(1)
    ur5.set_position([0, 0, 0])


ENDS = {
    "reset": BulletWorld.reset,
    "removal": lambda world: world.get_object("ur5").remove(),
    "restoring": lambda world: world.restore(world.saved),
    "a stop by others": lambda world: world.stop_trajectory(1),
}


@pytest.mark.parametrize("what", ENDS)
def test_who_waits_for_a_trajectory_is_told_that_it_ended_early(ur5: Object, what: str) -> None:
    world = ur5.world
    world.saved = world.save()

    def end() -> None:
        wait(world, lambda: world.sim_step >= 48)
        ENDS[what](world)

    def swing() -> None:
        with pytest.raises(TrajectoryEnded, match=r"trajectory 1 of ur5 ended after 0.\d+ of 1.000 s") as error:
            move(ur5, SWING, 1.0)
        assert 0.2 <= error.value.time < 0.4

    par(swing, end)
    assert not world.trajectories.active


def test_after_a_restore_nothing_moves_on(ur5: Object) -> None:
    world = ur5.world
    saved = world.save()
    world.begin_trajectory(ur5, to(ur5, SWING, 1.0))
    world.simulate(0.1)
    world.restore(saved)
    world.simulate(0.5)
    assert ur5.get_joint_position("elbow_joint") == pytest.approx(0, abs=1e-3)


BAD = {
    "a joint that it lacks": (lambda _: smooth(["knee"], [0], [1], 1), UnknownName, "knee"),
    "a joint twice": (lambda _: smooth(["elbow_joint"] * 2, [0, 0], [1, 1], 1), BadArgument, "each joint once"),
    "a goal beyond a limit": (lambda u: to(u, {"elbow_joint": 99}, 1), JointLimitError, "elbow_joint of ur5"),
    "another start": (
        lambda _: smooth(["elbow_joint"], [0.3], [1], 1),
        BadArgument,
        r"start of elbow_joint = 0.3.*0.0000",
    ),
    "another place": (lambda _: smooth((), [1, 0, 0], [2, 0, 0], 1), BadArgument, "start of x"),
    "hours": (lambda u: to(u, SWING, 4000), BadArgument, "3600 s"),
    "the end of the world": (
        lambda _: smooth((), [0, 0, 0], [1e7, 0, 0], 1),
        BadArgument,
        r"position = 10000000.0: .* up to 1e\+06",
    ),
    "a speed that is none": (
        lambda _: Trajectory(("elbow_joint",), (0.0, 1.0), ((0.0,), (1.0,)), ((0.0,), (1e300,))),
        BadArgument,
        r"velocity = 1e\+300",
    ),
    "no trajectory": (lambda _: [0.3], BadArgument, "a Trajectory"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cant_be_followed_is_refused_before_anything_changes(ur5: Object, sink: MemorySink, what: str) -> None:
    make, kind, text = BAD[what]
    with pytest.raises(kind, match=text):
        ur5.world.begin_trajectory(ur5, make(ur5))
    assert not [record for record in sink.of(Mutation) if record.HasField("begin_trajectory")]
    assert not ur5.world.trajectories.active


def test_physics_moves_the_base_of_a_cup(world: BulletWorld) -> None:
    cup = Object("cup", "cup", "cup.stl")
    with pytest.raises(BadArgument, match="physics moves the base"):
        world.begin_trajectory(cup, smooth((), [0, 0, 0], [1, 0, 0], 1))


def test_none_of_several_begins_if_one_is_refused(ur5: Object) -> None:
    world = ur5.world
    motions = [(ur5, Given(to(ur5, SWING, 1.0))), (ur5, Given(to(ur5, {"elbow_joint": 0.1}, 1.0)))]
    with pytest.raises(FollowsTrajectory):
        follow(world, motions)
    assert not world.trajectories.active
    world.simulate(0.2)
    assert ur5.get_joint_position("elbow_joint") == pytest.approx(0, abs=1e-3)


def test_an_arm_that_is_blocked_stops_and_says_by_what(ur5: Object) -> None:
    world = ur5.world
    hand = ur5.get_link_position("tool0")
    Object("cabinet", "environment", CABINET, [hand[0] - 0.2, hand[1] + 0.5, hand[2]])
    with pytest.raises(TrackingLost, match=r"ur5 is 0.\d+ off trajectory 1 after .* cabinet") as error:
        move(ur5, {"shoulder_pan_joint": 1.5}, 1.0)
    lost = error.value
    assert lost.joint in ur5.joints
    assert LOST["revolute"] < lost.error
    assert {pair.body for pair in lost.pairs} == {"cabinet"}
    assert {pair.mover for pair in lost.pairs} == {"ur5"}
    assert not world.trajectories.active
    where = ur5.get_joint_position("shoulder_pan_joint")
    assert where < 1.4
    world.simulate(0.5)  # it doesn't push on
    assert ur5.get_joint_position("shoulder_pan_joint") == pytest.approx(where, abs=0.05)
