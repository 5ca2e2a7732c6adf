"""Worlds and objects: what the thesis' tables 4.1 and 4.2 promise, several worlds at once, events, time."""

from __future__ import annotations

import math
import queue
import subprocess
import sys
import threading
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import BadArgument, ChangeRefused, UnknownName, WorldClosed
from pycram.language import par
from pycram.process_module import ProcessModule
from pycram.reasoning.queries.query import Verdict, query
from recorder.records import Task

if TYPE_CHECKING:
    from tests.conftest import MemorySink


def poses(world: BulletWorld) -> dict[str, object]:
    return {b.name: (b.get_position_and_orientation(), b.get_joint_positions()) for b in world.objects}


def test_setting_a_pose_is_exact_and_no_time_passes(world: BulletWorld) -> None:
    for mesh in ("spoon.stl", "bowl.stl", "milk.stl"):
        body = Object(mesh, "thing", mesh, [0, 0, 1])
        body.set_position_and_orientation([0.3, -0.2, 1.7], [0.1, 0.2, 0.3, 0.9])
        length = math.sqrt(0.01 + 0.04 + 0.09 + 0.81)
        assert body.get_position() == pytest.approx([0.3, -0.2, 1.7], abs=1e-12)
        assert body.get_orientation() == pytest.approx([x / length for x in (0.1, 0.2, 0.3, 0.9)], abs=1e-12)
    assert world.sim_step == 0


def test_objects_fall_as_gravity_says(world: BulletWorld) -> None:
    body = Object("milk", "milk", "milk.stl", [0, 0, 10])
    world.simulate(1.0)
    assert world.sim_step == 240
    fallen = 10 - body.get_position()[2]
    assert 0.9 * 4.9 < fallen < 4.95  # PyBullet's air brakes a little


def test_worlds_dont_disturb_each_other() -> None:
    with BulletWorld() as first, BulletWorld() as second:
        first.set_gravity([0, 0, -9.8])
        here = Object("cup", "cup", "cup.stl", [0, 0, 1], world=first)
        there = Object("cup", "cup", "cup.stl", [5, 0, 1], world=second)
        robot = Object("pr2", "robot", "pr2.urdf", world=second)
        second.robot = robot
        robot.attach(there, "r_gripper_tool_frame")
        first.simulate(0.5)
        assert there.get_position() == pytest.approx([5, 0, 1])
        assert here.get_position()[2] < 0
        here.set_position([0, 0, 3])
        robot.set_position([1, 0, 0])
        assert here.get_position() == pytest.approx([0, 0, 3])
        assert there.get_position() == pytest.approx([6, 0, 1])
        assert first.robot is None


def test_the_current_world_is_always_an_open_one() -> None:
    first, second, third = BulletWorld(), BulletWorld(), BulletWorld()
    assert BulletWorld.current_bullet_world is third
    second.exit()
    third.exit()
    third.exit()
    assert BulletWorld.current_bullet_world is first
    with pytest.raises(ZeroDivisionError), BulletWorld():
        _ = 1 / 0
    assert BulletWorld.current_bullet_world is first
    first.exit()
    assert BulletWorld.current_bullet_world is None
    with pytest.raises(WorldClosed, match="simulate"):
        first.simulate(1)


def test_default_names_keep_clear_of_given_ones_and_eight_threads_get_a_name_once() -> None:
    with BulletWorld() as first:
        number = int(first.name.removeprefix("world_"))
    with BulletWorld(name=f"world_{number + 1}"), BulletWorld() as second:
        assert second.name == f"world_{number + 2}"
    start = threading.Barrier(8)
    opened: list[BulletWorld] = []
    refused: list[BadArgument] = []

    def open_one() -> None:
        start.wait()
        try:
            opened.append(BulletWorld(name="the only one"))
        except BadArgument as error:
            refused.append(error)

    threads = [threading.Thread(target=open_one) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(opened) == 1
    assert len(refused) == 7
    opened[0].exit()
    BulletWorld(name="the only one").exit()


def test_a_world_ends_even_if_what_ends_with_it_fails() -> None:
    ended: list[str] = []

    def fail() -> None:
        raise ZeroDivisionError

    world = BulletWorld()
    world.at_exit(lambda: ended.append("first"))
    world.at_exit(fail)
    world.at_exit(lambda: ended.append("last"))
    with pytest.raises(ZeroDivisionError):
        world.exit()
    assert sorted(ended) == ["first", "last"]
    assert world.closed
    assert BulletWorld.current_bullet_world is not world
    world.exit()


def test_tables_of_methods(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    assert scene.get_objects_by_name("milk") == [milk]
    assert scene.get_objects_by_type("environment") == [scene.get_object("floor"), scene.get_object("kitchen")]
    assert scene.get_object_by_id(milk.id) is milk
    assert BulletWorld.robot is scene.robot
    robot = scene.robot
    assert robot is not None
    assert robot.links[0] == "base_footprint"
    assert robot.get_link_id("base_footprint") == -1
    assert robot.get_joint_id("r_shoulder_pan_joint") >= 0
    assert milk.get_pose() == milk.get_position()
    assert robot.get_link_position_and_orientation("base_footprint") == robot.get_position_and_orientation()
    with pytest.raises(UnknownName, match="r_gripper_tool_frame"):
        robot.get_link_position("r_gripper_tol_frame")
    with pytest.raises(UnknownName, match="milk"):
        scene.get_object("mikl")
    with pytest.raises(BadArgument):
        Object("milk", "milk", "milk.stl")


@pytest.mark.slow
def test_robots_hold_their_posture_and_things_have_weight(scene: BulletWorld) -> None:
    robot = scene.robot
    assert robot is not None
    before = robot.get_joint_positions()
    scene.simulate(2)
    after = robot.get_joint_positions()
    assert max(abs(after[name] - before[name]) for name in before) < 5e-3
    assert robot.get_position() == pytest.approx([0.65, 0.7, 0], abs=1e-9)

    def mass(body: Object) -> float:
        return sum(scene.engine.mass(body.handle, link) for link in body.links)

    assert mass(scene.get_object("spoon")) < 0.1
    assert mass(scene.get_object("milk")) == pytest.approx(1.05)
    assert 100 < mass(robot) < 260


def test_events_fire_and_their_handlers_may_do_anything(scene: BulletWorld) -> None:
    told: list[tuple[str, object]] = []
    robot, milk, kitchen = scene.robot, scene.get_object("milk"), scene.get_object("kitchen")
    assert robot is not None

    def in_another_thread(carrier: Object, body: Object) -> None:
        told.append(("attached", (carrier.name, body.name)))
        thread = threading.Thread(target=lambda: told.append(("position", milk.get_position())))
        thread.start()
        thread.join(10)  # would wait for ever if the world were locked
        assert not thread.is_alive()

    def detach_again(carrier: Object, body: Object) -> None:
        carrier.detach(body)

    attached, detached, manipulated = (
        scene.get_attachment_event(),
        scene.get_detachment_event(),
        scene.get_manipulation_event(),
    )
    attached += in_another_thread
    attached += detach_again
    detached += lambda carrier, body: told.append(("detached", (carrier.name, body.name)))
    manipulated += lambda body: told.append(("manipulated", body.name))
    robot.attach(milk, "r_gripper_tool_frame")
    kitchen.set_joint_position("iai_fridge_door_joint", 0.5)
    attached -= in_another_thread
    assert [kind for kind, _ in told] == ["attached", "position", "detached", "manipulated"]
    assert told[-1] == ("manipulated", "kitchen")


def test_handlers_never_run_with_the_world_locked_however_it_was_changed(scene: BulletWorld) -> None:
    robot, kitchen = scene.robot, scene.get_object("kitchen")
    assert robot is not None
    seen: list[tuple[str, bool]] = []

    def read_in_another_thread(name: str) -> None:
        thread = threading.Thread(target=robot.get_position)
        thread.start()
        thread.join(10)
        seen.append((name, thread.is_alive()))

    manipulated = scene.get_manipulation_event()
    manipulated += lambda _: read_in_another_thread("manipulation")
    attached = scene.get_attachment_event()
    attached += lambda *_: read_in_another_thread("attachment")
    kitchen.set_position([0.01, 0, 0])
    kitchen.set_orientation([0, 0, 0, 1])
    kitchen.set_position([0, 0, 0])
    with scene.lock:
        kitchen.set_joint_position("iai_fridge_door_joint", 0.5)
        assert len(seen) == 3, "whoever holds the lock isn't disturbed"
    assert len(seen) == 4

    def fail_after_a_change() -> None:
        with scene.lock:
            kitchen.set_joint_position("iai_fridge_door_joint", 0.0)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_after_a_change()
    assert len(seen) == 5, "what has happened is announced"
    slots = {
        "type": "accessing",
        "drawer-joint": "sink_area_left_upper_drawer_main_joint",
        "drawer-handle": "sink_area_left_upper_drawer_handle",
        "part-of": kitchen,
        "arm": "left",
        "distance": 0.3,
    }
    ProcessModule.perform(MotionDesignator(slots))
    assert len(seen) > 5
    robot.attach(scene.get_object("milk"), "r_gripper_tool_frame")
    assert seen[-1][0] == "attachment"
    scene.reset()
    assert not any(stuck for _, stuck in seen)


def test_reset_puts_everything_back(scene: BulletWorld) -> None:
    robot, milk, kitchen = scene.robot, scene.get_object("milk"), scene.get_object("kitchen")
    assert robot is not None
    milk.set_position([1.3, 1, 1.2])
    robot.attach(milk)
    kitchen.set_joint_position("iai_fridge_door_joint", 0.5)
    scene.reset()
    assert not robot.attachments
    assert milk.get_position() == pytest.approx([1.3, 1, 0.947])
    assert robot.get_position() == pytest.approx([0, 0, 0])
    assert kitchen.get_joint_position("iai_fridge_door_joint") == 0.0


def test_real_time_runs_and_stops(world: BulletWorld) -> None:
    passed = threading.Event()
    body = Object("cup", "cup", "cup.stl", [0, 0, 5])
    world.set_realtime(True)
    for _ in range(500):
        if body.get_position()[2] < 4.9:
            break
        passed.wait(0.01)
    assert body.get_position()[2] < 4.9
    world.set_realtime(False)
    steps = world.sim_step
    passed.wait(0.1)
    assert world.sim_step == steps
    world.set_realtime(True)
    world.exit()
    assert not [thread for thread in threading.enumerate() if "realtime" in thread.name]


def test_an_error_of_a_handler_in_real_time_is_told_and_time_goes_on(
    scene: BulletWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[type[BaseException]] = []
    monkeypatch.setattr(threading, "excepthook", lambda hook: told.append(hook.exc_type))
    calls = queue.Queue[str]()

    def fail(body: Object) -> None:
        calls.put(body.name)
        raise ZeroDivisionError

    manipulated = scene.get_manipulation_event()
    manipulated += fail
    scene.set_realtime(True)
    scene.set_gravity([-1e4, 0.0, 0.0])  # the drawers slide out, whatever holds them
    assert calls.get(timeout=100) == "kitchen"
    while not calls.empty():
        calls.get()
    scene.set_gravity([1e4, 0.0, 0.0])  # and in again, as time goes on
    assert calls.get(timeout=100) == "kitchen"
    with pytest.raises(ZeroDivisionError):
        scene.set_realtime(False)
    assert told == [ZeroDivisionError]
    assert not scene.realtime


def test_a_change_inside_a_query_is_refused(world: BulletWorld) -> None:
    body = Object("cup", "cup", "cup.stl")

    @query
    def inspect(object: Object, world: BulletWorld | None = None) -> Verdict:  # noqa: A002
        return Verdict(object.set_position([1, 0, 0]))

    with pytest.raises(ChangeRefused, match=r"move body.*inspect"):
        inspect(body)
    body.set_position([1, 0, 0])


def test_removed_objects_say_so(world: BulletWorld) -> None:
    cup, bowl = Object("cup", "cup", "cup.stl"), Object("bowl", "bowl", "bowl.stl", [1, 0, 0])
    cup.attach(bowl)
    cup.remove()
    assert world.objects == [bowl]
    assert bowl.carrier is None
    with pytest.raises(WorldClosed, match="object cup"):
        cup.get_position()
    with pytest.raises(WorldClosed):
        cup.remove()
    Object("cup", "cup", "cup.stl")


@pytest.mark.slow
def test_200_worlds_leave_nothing_behind() -> None:
    program = """
import gc, threading
import psutil
from pycram.bullet_world import BulletWorld, Object
process = psutil.Process()

def use():
    with BulletWorld() as world:
        Object("milk", "milk", "milk.stl", [0, 0, 1])
        Object("bowl", "bowl", "bowl.stl", [0.3, 0, 1])
        world.simulate(0.05)

def memory():  # its own, also what is swapped out; not libraries, whose pages the system drops and reads again
    lines = dict(line.split(":") for line in open("/proc/self/status"))
    return sum(int(lines[name].split()[0]) * 1024 for name in ("RssAnon", "VmSwap"))

def told():
    gc.collect()
    return threading.active_count(), process.num_threads(), process.num_fds(), memory(), len(gc.get_objects())

for _ in range(20):
    use()
before = told()
for _ in range(200):
    use()
print(*[after - then for then, after in zip(before, told())])
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)
    python_threads, threads, files, memory, objects = map(int, ended.stdout.split())
    assert (python_threads, threads, files) == (0, 0, 0)
    assert memory < 10e6
    assert objects < 1000


def furnished(name: str) -> BulletWorld:
    made = BulletWorld(name=name)
    made.robot = Object("pr2", "robot", "pr2.urdf")
    return made


def move(x: float, y: float) -> None:
    ProcessModule.perform(MotionDesignator([("type", "moving"), ("target", [x, y, 0])]))


def test_threads_that_chose_a_world_move_the_robot_of_that_world() -> None:
    worlds = [furnished("east"), furnished("west")]
    goals = {"east": 5.0, "west": -5.0}
    together = threading.Barrier(2)

    def plan(mine: BulletWorld) -> None:
        BulletWorld.current_bullet_world = mine
        for step in range(10):
            together.wait(20)
            move(goals[mine.name], step * 0.1)

    threads = [threading.Thread(target=plan, args=(mine,)) for mine in worlds]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for mine in worlds:
        assert mine.robot is not None
        assert mine.robot.get_position() == [goals[mine.name], 0.9, 0.0]
        mine.exit()


def test_branches_act_in_the_world_that_was_current_when_they_were_asked_for(sink: MemorySink) -> None:
    here, there = furnished("here"), furnished("there")
    BulletWorld.current_bullet_world = here
    with par:
        ProcessModule.perform(MotionDesignator({"type": "move-arm-joints", "left-arm": "park", "right-arm": "park"}))
        move(3, 3)
        BulletWorld.current_bullet_world = there
    assert here.robot is not None
    assert there.robot is not None
    assert here.robot.get_position() == [3, 3, 0]
    assert there.robot.get_position() == [0, 0, 0]
    motions = [task for task in sink.of(Task) if task.kind == "motion"]
    assert {task.world for task in motions} == {"here"}
    here.exit()
    there.exit()


def test_leaving_a_world_while_time_runs_in_another_thread_is_quick(world: BulletWorld) -> None:
    Object("cup", "cup", "cup.stl", [0, 0, 5])
    ends: list[BaseException] = []

    def run() -> None:
        try:
            world.simulate(86400.0)
        except WorldClosed as error:
            ends.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    waiting = threading.Event()
    while thread.is_alive() and not world.sim_step:
        waiting.wait(0.001)
    world.exit()
    thread.join(20)
    assert not thread.is_alive()
    assert len(ends) == 1
    assert 0 < world.sim_step < 86400 * 240
