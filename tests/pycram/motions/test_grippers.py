"""Fingers go as far as nothing stops them, and what a gripper that opens held is free."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import Object
from pycram.failures import GripperBlocked
from recorder.records import Task
from tests.pycram.motions.placing_scenes import box, finger_depth, perform

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.bullet_world import BulletWorld
    from tests.conftest import MemorySink

TOOL = "l_gripper_tool_frame"


def stretch_out(world: BulletWorld) -> tuple[float, float, float]:
    """Brings the closed left hand before the robot, and returns where it is."""
    perform(type="move-tcp", target=[1.15, 0.9, 1.2], orientation=[0, 0, 0, 1], arm="left")
    x, y, z = world.robot.get_link_position(TOOL)
    return x, y, z


def test_fingers_that_open_stop_at_a_neighbour(scene: BulletWorld, sink: MemorySink) -> None:
    x, y, z = stretch_out(scene)
    bottle = Object("beside", "bottle", "bottle.stl", [x, y + 0.038 + 0.045, z])
    assert finger_depth(scene, bottle) < 0
    stood = bottle.get_position_and_orientation()
    opened = perform(type="opening-gripper", gripper="left")
    assert finger_depth(scene, bottle) < 2e-3
    assert bottle.get_position_and_orientation() == stood
    assert 0.1 < opened.share < 0.9
    assert {pair.body for pair in opened.stopped_by} == {"beside"}
    assert opened.stopped_by[0].link.startswith("l_gripper_l_finger")
    result = [
        r for r in sink.records if isinstance(r, Task) and r.phase == Task.FINISHED and r.name == "opening-gripper"
    ]
    fields = json.loads(result[-1].result_json)
    assert (fields["share"], fields["released"]) == (opened.share, None)
    assert fields["stopped_by"][0]["body"] == "beside"
    bottle.remove()
    assert perform(type="opening-gripper", gripper="left").share == 1.0
    assert perform(type="closing-gripper", gripper="left").share == 0.0


def test_fingers_that_close_stop_at_what_is_between_them(scene: BulletWorld) -> None:
    x, y, z = stretch_out(scene)
    perform(type="opening-gripper", gripper="left")
    glass = Object("between", "glass", "glass.stl", [x + 0.03, y, z])
    closed = perform(type="closing-gripper", gripper="left")
    assert 0.2 < closed.share < 1.0
    assert finger_depth(scene, glass) < 2e-3
    assert closed.stopped_by[0].body == "between"
    assert closed.released is None


@pytest.mark.slow
def test_a_gripper_that_opens_lets_go(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    stood = milk.get_position()
    perform(type="pick-up", object=milk, arm="left")
    x, y, z = scene.robot.get_link_position(TOOL)
    perform(type="move-tcp", target=[x, y, z + 0.03], orientation=[0, 0, 0, 1], arm="left")
    assert milk.get_position()[2] > stood[2] + 0.02
    opened = perform(type="opening-gripper", gripper="left")
    assert opened.released is milk
    assert opened.settled
    assert milk.carrier is None
    assert milk.get_position()[2] == pytest.approx(stood[2], abs=2e-3), "it falls back onto the counter"
    assert perform(type="opening-gripper", gripper="left").released is None


def test_fingers_that_cannot_let_go_say_so_before_anything_changes(scene: BulletWorld, tmp_path: Path) -> None:
    milk = scene.get_object("milk")
    perform(type="pick-up", object=milk, arm="left", grasp="front")
    perform(type="move-tcp", target=[1.15, 0.9, 1.25], orientation=[0, 0, 0, 1], arm="left")
    wall = box(tmp_path, "wall", (0.2, 0.02, 0.3))
    x, y, z = scene.robot.get_link_position(TOOL)
    for name, side in (("left_wall", 1), ("right_wall", -1)):
        Object(name, "environment", wall, [x, y + side * 0.2, z])
        body = scene.get_object(name)
        while finger_depth(scene, body) < 2e-4:  # until the fingers, which close around the milk, just touch it
            body.set_position([x, body.get_position()[1] - side * 1e-3, z])
    before = [(b.get_position_and_orientation(), b.get_joint_positions()) for b in scene.objects]
    with pytest.raises(GripperBlocked, match=r"can't release milk: l_gripper_\w+ would touch \w+_wall") as raised:
        perform(type="opening-gripper", gripper="left")
    assert raised.value.body == "milk"
    assert {pair.body for pair in raised.value.pairs} <= {"left_wall", "right_wall"}
    assert [(b.get_position_and_orientation(), b.get_joint_positions()) for b in scene.objects] == before
    assert milk.carrier is scene.robot
