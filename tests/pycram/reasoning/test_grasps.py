"""What a gripper has picked up it really holds: both fingers are at the object, however it lay."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule

if TYPE_CHECKING:
    from collections.abc import Iterator

HOUSEHOLD = {
    "spoon": 0.9,
    "fork": 0.9,
    "knife": 0.9,
    "milk": 0.96,
    "breakfast_cereal": 0.97,
    "cup": 0.92,
    "bottle": 1.0,
    "plate": 0.9,
    "pot": 0.95,
    "apple": 0.92,
    "glass": 0.93,
    "bowl": 0.9,
}
CASES = list(itertools.product(HOUSEHOLD, (0, 30, 45, 60)))
QUICK = {("spoon", 30), ("milk", 45), ("plate", 0), ("bowl", 60)}
TURNED = (0, 45)  # of the others, what is shown where CI is set


@pytest.fixture(scope="module")
def kitchen() -> Iterator[BulletWorld]:
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("kitchen", "environment", "kitchen.urdf")
        world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
        yield world


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "degrees"),
    [
        pytest.param(
            *case, marks=[] if case in QUICK else pytest.mark.costly if case[1] in TURNED else pytest.mark.long
        )
        for case in CASES
    ],
)
def test_both_fingers_touch_a_picked_up_object(kitchen: BulletWorld, kind: str, degrees: int) -> None:
    robot = kitchen.robot
    assert robot is not None
    assert robot.description is not None
    half = math.radians(degrees) / 2
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    body = Object("thing", kind, f"{kind}.stl", [1.36, 0.9, HOUSEHOLD[kind]], [0, 0, math.sin(half), math.cos(half)])
    try:
        kitchen.simulate(1.0)
        pose = body.get_position_and_orientation()
        perform(type="pick-up", object=body, arm="left")
        assert body.get_position_and_orientation() == pose, "the hand goes to the object, not the object to the hand"
        for side in ("l", "r"):
            fingers = (f"l_gripper_{side}_finger_link", f"l_gripper_{side}_finger_tip_link")
            touches = [
                touch.distance
                for finger in fingers
                for touch in kitchen.engine.link_closest_points(robot.handle, finger, body.handle, 0.1)
            ]
            assert -0.001 < min(touches) < 0.0045, side
    finally:
        body.remove()


@pytest.mark.slow
def test_fingers_stay_as_far_apart_as_the_object_is_wide(kitchen: BulletWorld) -> None:
    robot = kitchen.robot
    assert robot is not None
    assert robot.description is not None
    gripper = robot.description.arm("left").gripper
    opened: dict[str, float] = {}
    for kind in ("knife", "milk"):
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        body = Object("thing", kind, f"{kind}.stl", [1.36, 0.9, HOUSEHOLD[kind]])
        kitchen.simulate(1.0)
        perform(type="pick-up", object=body, arm="left")
        opened[kind] = robot.get_joint_position(gripper.joints[0])
        body.remove()
    assert gripper.closed[0] <= opened["knife"] < 0.2 < opened["milk"] < gripper.open[0]
