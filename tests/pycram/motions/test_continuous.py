"""Motions that take simulated time: the same designators, the same promises; what moves can be stopped."""

from __future__ import annotations

import math
import re
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import pytest

from pycram import planning
from pycram.actions import perform as perform_action
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import ActionDesignator, MotionDesignator
from pycram.failures import AccessFailed, Displaced, GraspFailed, InCollision, NoPath, Unreachable
from pycram.fluent import network
from pycram.fluents.world import joint, pose, position
from pycram.language import State, par, pursue, timeout
from pycram.language.timeouts import TimedOut
from pycram.motions.execution import IN_SIMULATED_TIME
from pycram.motions.process_module import current_environment, set_default
from pycram.planning import path, through
from pycram.process_module import ProcessModule, execution_environment
from pycram.world import simulation
from pycram.world.driving import follow
from recorder import geometry
from recorder.records import STEPS_PER_SECOND, Driven, Mutation, Query, Task

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from tests.conftest import MemorySink

DRAWER = "sink_area_left_upper_drawer_main_joint"
HANDLE = "sink_area_left_upper_drawer_handle"


@pytest.fixture(autouse=True)
def continuous() -> Iterator[None]:
    with execution_environment("continuous"):
        yield


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def seconds(world: BulletWorld, before: int) -> float:
    return (world.sim_step - before) / STEPS_PER_SECOND


def tool(robot: Object, arm: str) -> tuple[list[float], list[float]]:
    return robot.get_link_position_and_orientation(robot.description.arm(arm).tool_frame)


@pytest.mark.costly
def test_the_base_drives_around_what_stands_there(shared_scene: BulletWorld, sink: MemorySink) -> None:
    robot, begun = shared_scene.robot, shared_scene.sim_step
    robot.set_position_and_orientation([0.3, 0.7, 0], [0, 0, 0, 1])
    perform(type="moving", target=[-0.1, 1.3, 0], orientation=[0, 0, 1, 0])
    assert robot.get_position() == pytest.approx([-0.1, 1.3, 0], abs=1e-6)
    assert seconds(shared_scene, begun) > math.pi / 2  # to turn by half a turn, at 1 rad/s at most
    (simulated,) = [record for record in sink.of(Mutation) if record.HasField("simulate")]  # alone: one record
    assert simulated.effect.samples
    with pytest.raises(InCollision):
        perform(type="moving", target=[1.2, 0.7, 0])


@pytest.mark.costly
def test_what_is_picked_up_is_carried_in_the_hand_and_placed(shared_scene: BulletWorld, sink: MemorySink) -> None:
    robot, milk = shared_scene.robot, shared_scene.get_object("milk")
    perform(type="pick-up", object=milk, arm="left")
    held = geometry.multiply(geometry.invert(tool(robot, "left")), milk.get_position_and_orientation())
    assert robot.attachments[milk].carrier is robot
    perform(type="move-arm-joints", left_arm="park")
    now = geometry.multiply(geometry.invert(tool(robot, "left")), milk.get_position_and_orientation())
    assert math.dist(now[0], held[0]) < 1e-3
    perform(type="place", object=milk, target=[1.3, 1.05, 0.95], arm="left")
    assert not robot.carried
    assert milk.get_position()[:2] == pytest.approx([1.3, 1.05], abs=0.02)
    hand, body = tool(robot, "left")[0], milk.get_position()
    assert math.dist(hand, body) > math.hypot(*held[0]) + 0.02  # it was drawn back, as far as nothing is in the way
    assert not [
        record for record in sink.of(Mutation) if record.HasField("move_joints") or record.HasField("move_body")
    ]


@pytest.mark.costly
def test_a_drawer_opens_with_the_hand_and_takes_along_what_lies_in_it(shared_scene: BulletWorld) -> None:
    kitchen, spoon = shared_scene.get_object("kitchen"), shared_scene.get_object("spoon")
    lay = spoon.get_position()
    perform(type="accessing", drawer_joint=DRAWER, drawer_handle=HANDLE, part_of=kitchen, arm="left", distance=0.2)
    assert kitchen.get_joint_position(DRAWER) == pytest.approx(0.2, abs=2e-3)
    assert lay[0] - spoon.get_position()[0] == pytest.approx(0.2, abs=0.01)
    with pytest.raises(AccessFailed, match="its upper limit is"):
        perform(type="accessing", drawer_joint=DRAWER, drawer_handle=HANDLE, part_of=kitchen, arm="left", distance=2)


@pytest.mark.slow
def test_arms_move_one_after_another_where_no_path_for_both_is_found(
    shared_scene: BulletWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, find = shared_scene.robot, planning.joint_motion
    sides: list[str] = []

    def alone(robot: Object, goal: Mapping[str, float], **options: Any) -> planning.PlannedMotion:
        moving = "".join(sorted({name[0] for name in goal}))
        sides.append(moving)
        if len(moving) > 1 or len(sides) == 2:  # the left arm alone has no way, either, before the right one has moved
            raise NoPath(moving, goal, 1, {}, 0.0, [])
        return find(robot, goal, **options)

    monkeypatch.setattr(planning, "joint_motion", alone)
    begun = shared_scene.sim_step
    perform(type="move-arm-joints", left_arm=park_raised("left"), right_arm=park_raised("right"))
    assert sides == ["lr", "l", "r", "l"]
    together = seconds(shared_scene, begun)
    for arm in ("left", "right"):
        joints = robot.description.arm(arm).joints
        assert [robot.get_joint_position(name) for name in joints] == pytest.approx(park_raised(arm), abs=2e-3)
    budgets: list[int] = []

    def patient(robot: Object, goal: Mapping[str, float], *, patience: int, **options: Any) -> planning.PlannedMotion:
        budgets.append(patience)
        if patience == 1:
            raise NoPath("left arm", goal, 1, {}, 0.0, [])
        return find(robot, goal, patience=patience, **options)

    monkeypatch.setattr(planning, "joint_motion", patient)
    begun = shared_scene.sim_step
    perform(type="move-arm-joints", left_arm="park")
    assert together > 1.5 * seconds(shared_scene, begun)
    assert budgets == [1, 1, 5], "from here, from where the hand is drawn back to, and longer"


@pytest.mark.slow
def test_branches_move_at_the_same_time(shared_scene: BulletWorld) -> None:
    robot = shared_scene.robot
    raised = {arm: park_raised(arm) for arm in ("left", "right")}
    begun = shared_scene.sim_step
    perform(type="move-arm-joints", left_arm=raised["left"])
    alone = seconds(shared_scene, begun)
    perform(type="move-arm-joints", left_arm="park")
    begun = shared_scene.sim_step
    with par:
        perform(type="move-arm-joints", left_arm=raised["left"])
        perform(type="move-arm-joints", right_arm=raised["right"])
    assert seconds(shared_scene, begun) == pytest.approx(alone, abs=0.1)
    for arm, posture in raised.items():
        joints = robot.description.arm(arm).joints
        assert [robot.get_joint_position(name) for name in joints] == pytest.approx(posture, abs=0.01)


@pytest.mark.slow
def test_time_stands_still_while_nobody_moves(shared_scene: BulletWorld) -> None:
    begun = shared_scene.sim_step
    assert perform(type="world-state-detecting", object_type="milk").name == "milk"
    assert shared_scene.sim_step == begun
    perform(type="looking", object=shared_scene.get_object("milk"))
    assert shared_scene.sim_step > begun


@pytest.mark.costly
def test_fingers_close_as_far_as_they_get_and_what_is_let_go_falls(shared_scene: BulletWorld) -> None:
    robot, milk = shared_scene.robot, shared_scene.get_object("milk")
    assert perform(type="closing-gripper", gripper="left").share == pytest.approx(0, abs=0.01)
    opened = perform(type="opening-gripper", gripper="left")
    assert opened.share == pytest.approx(1, abs=0.01)
    finger = robot.description.arm("left").gripper.at(1.0)
    assert {name: robot.get_joint_position(name) for name in finger} == pytest.approx(finger, abs=5e-3)
    perform(type="pick-up", object=milk, arm="left")
    perform(type="move-arm-joints", left_arm="park")
    high = milk.get_position()[2]
    let_go = perform(type="opening-gripper", gripper="left")
    assert let_go.released is milk
    assert milk.get_position()[2] < high - 0.2


@pytest.mark.costly
def test_what_is_moved_while_the_hand_comes_is_not_grasped_blindly(shared_scene: BulletWorld) -> None:
    robot, milk = shared_scene.robot, shared_scene.get_object("milk")
    begun, stood = shared_scene.sim_step, milk.get_position()

    def push() -> None:
        hand = position(robot, robot.description.arm("left").tool_frame)
        (network(lambda at: math.dist(at, stood), hand) < 0.3).wait_for()
        milk.set_position([1.3, 1.2, milk.get_position()[2]])

    def plan() -> None:
        with par as both:
            both(push)
            both(perform, type="pick-up", object=milk, arm="left")

    with pytest.raises(GraspFailed, match=r"the object moved by 0\.200 m .* try again"):
        plan()
    assert not robot.carried
    assert shared_scene.sim_step > begun


@pytest.mark.costly
def test_what_is_taken_away_while_the_fingers_close_is_not_held(shared_scene: BulletWorld) -> None:
    robot, milk = shared_scene.robot, shared_scene.get_object("milk")
    finger = joint(robot, "l_gripper_l_finger_joint")

    def take_away() -> None:
        (finger > 0.53).wait_for()
        (finger < 0.52).wait_for()
        milk.set_position([1.3, 1.2, milk.get_position()[2]])

    def plan() -> None:
        with par as both:
            both(take_away)
            both(perform, type="pick-up", object=milk, arm="left")

    with pytest.raises(GraspFailed, match="the closed fingers touch no side of the object"):
        plan()
    assert not robot.carried


def driven(sink: MemorySink) -> list[Driven]:
    """How far each trajectory got, in the end."""
    records = [each for record in sink.of(Mutation) for each in record.simulate.driven]
    return list({each.number: each for each in records}.values())


@pytest.mark.slow
def test_a_plan_stops_the_arm_when_it_knocks_something_over(shared_scene: BulletWorld, sink: MemorySink) -> None:
    robot = shared_scene.robot
    for number, name in enumerate(("milk", "bowl", "cereal")):
        shared_scene.get_object(name).set_position([1.35, 0.1 + 0.2 * number, 1.0])
    bottle = Object("bottle", "bottle", "bottle.stl", [1.35, -0.2, 1.0])
    shared_scene.settle()
    perform(type="move-tcp", arm="left", target=[1.3, 1.05, 1.0], orientation=[0, 0, 0, 1])
    stands, begun = bottle.get_position_and_orientation(), shared_scene.sim_step
    tipped: list[int] = []

    def stand_in_the_way() -> None:
        (network(itemgetter(1), position(robot, robot.description.arm("left").tool_frame)) < 1.03).wait_for()
        bottle.set_position([1.32, 0.85, stands[0][2]])

    def watch() -> None:
        (network(lambda now: geometry.lean(now[1], stands[1]), pose(bottle)) > math.radians(15)).wait_for()
        tipped.append(shared_scene.sim_step)

    with par as everything:
        everything(stand_in_the_way)
        with pursue as first:
            first(watch)
            first(perform, type="move-tcp", arm="left", target=[1.3, 0.7, 1.0], orientation=[0, 0, 0, 1])
    assert [branch.state for branch in first.branches] == [State.SUCCEEDED, State.CANCELLED]
    assert begun < tipped[0]
    assert tool(robot, "left")[0][1] > 0.75
    (stopped,) = [record for record in sink.of(Mutation) if record.HasField("stop_trajectory")]
    assert stopped.sim_step == tipped[0]  # where it is seen, it is stopped
    assert shared_scene.sim_step - tipped[0] <= 0.2 * STEPS_PER_SECOND
    *_, last = driven(sink)
    assert last.ended
    before = robot.get_joint_positions()
    shared_scene.simulate(0.5)
    assert robot.get_joint_positions() == pytest.approx(before, abs=5e-3)  # it stands


def park_raised(arm: str) -> list[float]:
    """A posture that takes a second to get to."""
    posture = [*BulletWorld.current_robot().description.arm(arm).poses["park"]]
    posture[5] -= 0.8
    return posture


@pytest.mark.slow
def test_a_limit_of_simulated_time_stops_a_motion(shared_scene: BulletWorld, sink: MemorySink) -> None:
    begun = shared_scene.sim_step
    with pytest.raises(TimedOut, match="of simulated time"), timeout(0.5, simulated=True):
        perform(type="move-arm-joints", left_arm=park_raised("left"))
    assert 0.5 <= seconds(shared_scene, begun) <= 0.7
    (stopped,) = driven(sink)
    assert stopped.ended
    assert 0.5 <= stopped.time < 0.7
    (task,) = [each for each in sink.of(Task) if each.kind == "motion" and each.status == Task.CANCELLED]
    assert task.name == "move-arm-joints"
    perform(type="move-arm-joints", left_arm="park")  # it goes on from where it stands


@pytest.mark.slow
def test_ctrl_c_stops_a_motion_and_leaves_the_world_consistent(shared_scene: BulletWorld) -> None:
    robot, wrist = shared_scene.robot, "l_wrist_flex_joint"
    (moving,) = [joint(robot, wrist) < robot.get_joint_position(wrist) - 0.2]

    def press() -> None:
        moving.wait_for()
        signal.raise_signal(signal.SIGINT)

    def plan() -> None:
        with par as both:
            both(perform, type="move-arm-joints", left_arm=park_raised("left"))
            both(press)

    with pytest.raises(KeyboardInterrupt):
        plan()
    assert not shared_scene.trajectories.active
    stands = robot.get_joint_position(wrist)
    shared_scene.simulate(0.25)
    assert robot.get_joint_position(wrist) == pytest.approx(stands, abs=2e-3)


def set_joint(world: BulletWorld, begun: int, joint: str, value: float) -> None:
    """Put a joint somewhere half a second later, while nothing of the arm moves."""
    simulation.wait(world, lambda: world.sim_step >= begun + STEPS_PER_SECOND // 2)
    world.robot.set_joint_position(joint, value)


@pytest.mark.costly
def test_an_arm_that_was_moved_while_its_gripper_opened_goes_on_from_there(shared_scene: BulletWorld) -> None:
    milk, lift = shared_scene.get_object("milk"), "l_shoulder_lift_joint"
    moved = shared_scene.robot.get_joint_position(lift) - 0.2
    with par as both:
        both(perform, type="pick-up", object=milk, arm="left")
        both(set_joint, shared_scene, shared_scene.sim_step, lift, moved)
    assert shared_scene.robot.attachments[milk].carrier is shared_scene.robot


@pytest.mark.slow
def test_fingers_that_were_moved_during_a_motion_are_named_with_what_to_do(shared_scene: BulletWorld) -> None:
    robot, finger = shared_scene.robot, "l_gripper_l_finger_joint"
    now = robot.get_joint_position(finger)
    step = IN_SIMULATED_TIME.pull(robot, robot, "head_pan_joint", [0.0, 0.1], [{finger: now}, {finger: now + 0.1}])
    robot.set_joint_position(finger, now + 0.3)
    begun = shared_scene.sim_step
    with pytest.raises(Displaced, match=f"{finger} of pr2 is at .* instead of {now:.3f}: .* again") as error:
        step()
    assert (error.value.coordinate, error.value.expected) == (finger, pytest.approx(now))
    assert shared_scene.sim_step == begun
    assert not shared_scene.trajectories.active


@pytest.mark.slow
def test_a_hand_around_an_object_is_drawn_straight_back_where_no_other_way_is_found(
    shared_scene: BulletWorld, sink: MemorySink, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, milk = shared_scene.robot, shared_scene.get_object("milk")
    arm = robot.description.arm("left")
    with execution_environment("simulated"):
        perform(type="pick-up", object=milk, arm="left")
    robot.detach(milk)
    robot.set_joint_positions(arm.gripper.positions("open"))  # as when putting it down is stopped here
    stands = milk.get_position()
    monkeypatch.setattr(path, "MAX_CHECKS", 300)  # a search that does find a way out takes some thousand
    perform(type="move-arm-joints", left_arm="park")
    assert len([each for each in sink.of(Mutation) if each.HasField("begin_trajectory")]) == 2  # back, and from there
    off = [robot.get_joint_position(name) - at for name, at in arm.posture("park").items()]
    assert [math.remainder(each, math.tau) for each in off] == pytest.approx([0.0] * len(off), abs=1e-2)
    assert milk.get_position() == pytest.approx(stands, abs=2e-3)


@pytest.mark.slow
def test_a_hand_is_lifted_where_a_motor_left_a_joint_a_little_beyond_its_limit(shared_scene: BulletWorld) -> None:
    robot = shared_scene.robot
    arm = robot.description.arm("left")
    lower, _ = robot.joint_limits("l_wrist_flex_joint")
    robot.set_joint_position("l_wrist_flex_joint", lower)
    robot.world.engine.set_joints(robot.handle, {"l_wrist_flex_joint": lower - 2e-5})
    before = tool(robot, "left")[0][2]
    step = IN_SIMULATED_TIME.lift(robot, arm)
    assert step is not None
    step()
    assert tool(robot, "left")[0][2] > before + 0.02


def test_a_goal_out_of_reach_is_refused_before_anything_is_searched(
    shared_scene: BulletWorld, sink: MemorySink
) -> None:
    with pytest.raises(Unreachable, match="the nearest posture found stays"):
        perform(type="move-tcp", arm="left", target=[3, 3, 1])
    assert not [query for query in sink.of(Query) if query.name == "path"]
    assert not sink.of(Mutation)


def test_what_the_other_hand_holds_is_refused_with_what_to_do(shared_scene: BulletWorld) -> None:
    robot, milk = shared_scene.robot, shared_scene.get_object("milk")
    robot.attach(milk, robot.description.arm("right").tool_frame)
    begun = shared_scene.sim_step
    with pytest.raises(GraspFailed, match=r"the right arm already holds .*; to hand it over, place it .* the left arm"):
        perform(type="pick-up", object=milk, arm="left")
    assert shared_scene.sim_step == begun


@pytest.mark.slow
def test_an_open_drawer_in_the_way_is_named(shared_scene: BulletWorld) -> None:
    kitchen = shared_scene.get_object("kitchen")
    shared_scene.robot.set_position_and_orientation([0.2, 0.9, 0], [0, 0, 0, 1])
    kitchen.set_joint_position(DRAWER, 0.4)
    with pytest.raises(InCollision, match="sink_area_left_upper_drawer"):
        perform(type="moving", target=[0.75, 0.9, 0])
    assert shared_scene.robot.get_position() == pytest.approx([0.2, 0.9, 0])


def test_the_environment_of_a_run_holds_in_all_threads_and_where_the_plan_names_none() -> None:
    set_default("continuous")
    try:
        found: list[str] = []
        thread = threading.Thread(target=lambda: found.append(current_environment()))
        thread.start()
        thread.join()
        assert found == ["continuous"]
        with execution_environment("simulated"):
            assert current_environment() == "simulated"
    finally:
        set_default("")
    with ThreadPoolExecutor(1) as fresh:
        assert fresh.submit(current_environment).result() == "simulated"


@pytest.mark.costly
@pytest.mark.slow
def test_an_arm_waits_for_the_other_one_to_pass(shared_scene: BulletWorld) -> None:
    robot, center = shared_scene.robot, [1.1, 0.7, 1.2]
    right = robot.description.arm("right")
    with execution_environment("simulated"):
        for name in ("milk", "bowl", "cereal"):
            shared_scene.get_object(name).set_position([0.65, -2.0, 0.2])
        perform(type="move-tcp", arm="right", target=center, orientation=[0, 0, 0, 1])
        there = {joint: robot.get_joint_position(joint) for joint in right.joints}
        perform(type="move-arm-joints", right_arm="park")
    passing = through(robot, [right.posture("park"), there, right.posture("park")])
    lift = robot.get_joint_position(right.joints[1])
    set_out = network(lambda now: abs(now - lift), joint(robot, right.joints[1])) > 0.01

    def come_after() -> None:
        set_out.wait_for()
        perform(type="move-tcp", arm="left", target=center, orientation=[0, 0, 0, 1])

    begun = shared_scene.sim_step
    with par as both:
        both(follow, shared_scene, [(robot, passing)])
        both(come_after)
    assert tool(robot, "left")[0] == pytest.approx(center, abs=5e-3)
    assert seconds(shared_scene, begun) > passing.trajectory.duration + 0.5  # it began when the other one had passed


PLAN = """
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule

with BulletWorld() as world:
    world.robot = Object("pr2", "robot", "pr2.urdf")
    ProcessModule.perform(MotionDesignator([("type", "looking"), ("target", [2, 1, 1])]))
    print(world.sim_step > 0)
"""


@pytest.mark.costly
@pytest.mark.slow
def test_a_run_with_motion_is_recorded_and_retraced_as_such(tmp_path: Path) -> None:
    plan, log = tmp_path / "look.py", tmp_path / "look.mcap"
    plan.write_text(PLAN, encoding="utf-8")

    def run(*command: str) -> str:
        ended = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    assert run("pycram", "run", str(plan), "--motion", "continuous", "--log", str(log)).split() == ["True"]
    assert re.search(r"^motion +continuous$", run("replay", "info", str(log)), re.MULTILINE)
    assert run("replay", "retrace", str(log)).startswith("identical")
    assert run("pycram", "run", str(plan), "--log", str(log), "--overwrite").split() == ["False"]
    assert "\nmotion " not in run("replay", "info", str(log))


def max_lean(sink: MemorySink) -> float:
    """How far the bottle leant in all samples of the records, rad."""
    samples = [sample for record in sink.of(Mutation) for sample in record.effect.samples]
    turns = [body.orientation for sample in samples for body in sample.bodies if body.body == "bottle"]
    return max(geometry.lean(turn, geometry.IDENTITY[1]) for turn in turns if turn)


@pytest.mark.slow
def test_a_bottle_stays_upright_on_a_level_way(world: BulletWorld, sink: MemorySink) -> None:
    """The nearest posture that reaches the place tips it; an orientation in which it would lean is refused."""
    Object("floor", "environment", "plane.urdf")
    Object("kitchen", "environment", "kitchen.urdf")
    world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
    with execution_environment("simulated"):
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        bottle = Object("bottle", "bottle", "bottle.stl", [1.36, 0.9, 0.99])
        assert world.settle()
        perform(type="pick-up", object=bottle, arm="left")
    taken = world.save()
    leans = []
    for level in (True, False):
        world.restore(taken)
        sink.records.clear()
        perform(type="move-tcp", arm="left", target=[1.36, 0.5, 1.0], level=level)
        assert math.dist(tool(world.robot, "left")[0], [1.36, 0.5, 1.0]) < 0.01
        leans.append(max_lean(sink))
    assert leans[0] < math.radians(2)
    assert leans[1] > math.radians(15)
    world.restore(taken)
    sink.records.clear()
    with execution_environment("continuous", level=True):
        with pytest.raises(NoPath, match=r"the left hand would lean by \d+ degrees on its way"):
            perform(type="move-arm-joints", left_arm="park")
        perform_action(ActionDesignator(type="parking-arms"))
        perform(type="moving", target=[0.3, 1.0, 0], orientation=[0, 0, 0.3, 0.95])
        perform(type="moving", target=[0.65, 0.7, 0], orientation=[0, 0, 0, 1])
        perform(type="place", object=bottle, arm="left", target=[1.3, 0.6, 0.99])
    assert max_lean(sink) < math.radians(2)
    across = geometry.product(geometry.from_rpy(math.radians(40), 0, 0), tool(world.robot, "left")[1])
    world.restore(taken)
    with pytest.raises(Unreachable, match=r"would lean by \d+ degrees more than now; the maximum is 15 degrees"):
        perform(type="move-tcp", arm="left", target=[1.36, 0.5, 1.0], orientation=across, level=True)
