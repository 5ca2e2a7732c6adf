"""Simulated time: gravity, real time, and how both end."""

from __future__ import annotations

import queue
import random
import threading

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.bullet_world_reasoning import reachable, stable
from pycram.failures import WorldClosed
from pycram.world.transaction import take_snapshot


def test_objects_fall_with_gravity(world: BulletWorld) -> None:
    body = Object("milk", "milk", "milk.stl", [0, 0, 10])
    world.simulate(1.0)
    assert world.sim_step == 240
    fallen = 10 - body.get_position()[2]
    assert 0.9 * 4.9 < fallen < 4.95  # PyBullet's air brakes a little


def test_a_posture_that_was_simulated_can_be_set_again(world: BulletWorld) -> None:
    robot = Object("pr2", "robot", "pr2.urdf")  # with its wrists at their upper limit, 0
    world.set_gravity([0, 0, -9.8])
    world.simulate(0.5)
    posture = robot.get_joint_positions()
    _, upper = robot.joint_limits("r_wrist_flex_joint")
    assert posture["r_wrist_flex_joint"] > upper + 1e-6  # motors give way a little
    robot.set_joint_positions(posture)
    assert robot.get_joint_positions() == posture


@pytest.mark.parametrize("seed", range(5))
def test_a_snapshot_is_what_the_engine_has_after_any_change(scene: BulletWorld, seed: int) -> None:
    dice = random.Random(seed)
    robot, kitchen, milk, bowl = (scene.get_object(name) for name in ("pr2", "kitchen", "milk", "bowl"))
    changes = [
        lambda: robot.set_position([dice.uniform(-1, 1), 0.5, 0]),
        lambda: robot.set_joint_position("head_pan_joint", dice.uniform(-1, 1)),
        lambda: kitchen.set_joint_position("iai_fridge_door_joint", dice.uniform(0, 1)),
        lambda: milk.set_position([dice.uniform(0, 1), 2, dice.uniform(0, 2)]),
        lambda: scene.engine.set_velocity(milk.handle, [0, dice.uniform(-1, 1), 0, 0, 0, 1]),
        lambda: scene.simulate(0.05),
        lambda: robot.detach(bowl) if robot.carried else robot.attach(bowl, "l_gripper_tool_frame"),
        lambda: reachable(bowl, robot, "l_gripper_tool_frame"),
        lambda: stable(milk),
    ]
    for change in dice.choices(changes, k=60):
        change()
        for body in scene.objects:
            fresh = (
                scene.engine.pose(body.handle),
                scene.engine.velocity(body.handle),
                *scene.engine.joints(body.handle),
            )
            assert take_snapshot(body) == fresh


def test_real_time_starts_and_stops(world: BulletWorld) -> None:
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


def test_an_error_of_a_handler_in_real_time_is_reported_and_time_goes_on(
    scene: BulletWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    reported: list[type[BaseException]] = []
    monkeypatch.setattr(threading, "excepthook", lambda hook: reported.append(hook.exc_type))
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
    assert reported == [ZeroDivisionError]
    assert not scene.realtime


def test_exit_ends_a_simulation_in_another_thread(world: BulletWorld) -> None:
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
