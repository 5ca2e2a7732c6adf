"""Events of a world: their handlers run when its lock is free, whatever changed it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest

from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule

if TYPE_CHECKING:
    from pycram.bullet_world import BulletWorld, Object


def test_handlers_may_read_and_change_the_world(scene: BulletWorld) -> None:
    calls: list[tuple[str, object]] = []
    robot, milk, kitchen = scene.robot, scene.get_object("milk"), scene.get_object("kitchen")
    assert robot is not None

    def in_another_thread(carrier: Object, body: Object) -> None:
        calls.append(("attached", (carrier.name, body.name)))
        thread = threading.Thread(target=lambda: calls.append(("position", milk.get_position())))
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
    detached += lambda carrier, body: calls.append(("detached", (carrier.name, body.name)))
    manipulated += lambda body: calls.append(("manipulated", body.name))
    robot.attach(milk, "r_gripper_tool_frame")
    kitchen.set_joint_position("iai_fridge_door_joint", 0.5)
    attached -= in_another_thread
    assert [kind for kind, _ in calls] == ["attached", "position", "detached", "manipulated"]
    assert calls[-1] == ("manipulated", "kitchen")


@pytest.mark.slow
def test_handlers_run_only_when_the_lock_is_released(scene: BulletWorld) -> None:
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
