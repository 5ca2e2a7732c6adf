"""The thesis' listings 5.1 to 5.5 run as printed, but for the locations of files."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr, tasks
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.language import par
from pycram.process_module import ProcessModule
from recorder import geometry
from recorder.records import Mutation

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.conftest import MemorySink

targets = {
    "milk": ([-0.8, 1, 0.93], "left"),
    "bowl": ([-0.8, 1.2, 0.9], "right"),
    "cereal": ([-1, 1, 0.94], "right"),
    "spoon": ([-0.8, 1.2, 0.94], "right"),
}


@pytest.fixture
def listing_5_1(request: pytest.FixtureRequest) -> Iterator[dict[str, Object]]:
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    plane = Object("floor", "environment", "plane.urdf", world=world)
    robot = Object("pr2", "robot", "pr2.urdf")
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    milk = Object("milk", "milk", "milk.stl", [1.3, 1, 1])
    spoon = Object("spoon", "spoon", "spoon.stl", [1.4, 0.8, 1])
    cereal = Object("cereal", "cereal", "breakfast_cereal.stl", [1.3, 0.6, 1])
    bowl = Object("bowl", "bowl", "bowl.stl", [1.3, 0.8, 1])
    BulletWorld.robot = robot
    getattr(request, "param", lambda world: world.simulate(0.5))(world)
    yield {body.name: body for body in (plane, robot, kitchen, milk, spoon, cereal, bowl)}
    world.exit()


@pytest.mark.slow
def test_listing_5_2_opens_the_drawer(listing_5_1: dict[str, Object]) -> None:
    kitchen = listing_5_1["kitchen"]
    BulletWorld.robot.set_position([0.65, 0.7, 0])
    # fmt: off
    ProcessModule.perform(MotionDesignator([('type', 'accessing'), ('drawer-joint', 'sink_area_left_upper_drawer_main_joint'), ('drawer-handle', 'sink_area_left_upper_drawer_handle'), ('arm', 'left'), ('distance', 0.3), ('part-of', kitchen)]))  # noqa: Q000
    # fmt: on
    assert kitchen.get_joint_position("sink_area_left_upper_drawer_main_joint") == pytest.approx(0.3)
    tool = BulletWorld.robot.get_link_position("l_gripper_tool_frame")
    bar = kitchen.get_link_position("sink_area_left_upper_drawer_handle")
    assert math.dist(tool[::2], bar[::2]) < 0.03
    assert abs(tool[1] - bar[1]) < 0.3, "somewhere on the bar, which is 0.7 m long"


@pytest.mark.slow
def test_listings_5_3_to_5_5_carry_the_milk(listing_5_1: dict[str, Object]) -> None:
    object_type = "milk"
    target, arm = targets[object_type]
    gripper = "l_gripper_tool_frame"
    # fmt: off
    with par as s:
        ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('left-arm', 'park'), ('right-arm', 'park')]))  # noqa: Q000
        ProcessModule.perform(MotionDesignator([('type', 'moving'), ('target', [0.65, 0.7, 0]), ('orientation', [0, 0, 0, 1])]))  # noqa: Q000
        ProcessModule.perform(MotionDesignator([('type', 'looking'), ('target', [1.3, 0.6, 1])]))  # noqa: Q000
        det_obj = ProcessModule.perform(MotionDesignator([('type', 'detecting'), ('object', object_type)]))  # noqa: Q000

    block = btr.blocking(det_obj, BulletWorld.robot, gripper)
    block_new = list(filter(lambda obj: obj.type != "environment", block))
    assert not block_new
    ProcessModule.perform(MotionDesignator([('type', 'pick-up'), ('object', det_obj), ('arm', arm)]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('right-arm', 'park')]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('left-arm', 'park')]))  # noqa: Q000

    ProcessModule.perform(MotionDesignator([('type', 'moving'), ('target', [-0.3, 1, 0]), ('orientation', [0, 0, 1, 0])]))  # noqa: Q000
    if btr.reachable_pose(target, BulletWorld.robot, gripper):
        ProcessModule.perform(MotionDesignator([('type', 'place'), ('object', det_obj), ('target', target), ('arm', arm)]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('left-arm', 'park'), ('right-arm', 'park')]))  # noqa: Q000
    if not btr.stable(det_obj):
        raise btr.ReasoningError
    # fmt: on
    assert det_obj == listing_5_1["milk"]
    assert math.dist(listing_5_1["milk"].get_position(), target) < 0.03
    assert s.state.name == "SUCCEEDED"


def move_object(object_type: str, target: list[float], arm: str) -> None:
    """Chapter 5's plan for one object."""
    gripper = f"{arm[0]}_gripper_tool_frame"
    # fmt: off
    with par:
        ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('left-arm', 'park'), ('right-arm', 'park')]))  # noqa: Q000
        ProcessModule.perform(MotionDesignator([('type', 'moving'), ('target', [0.65, 0.7, 0]), ('orientation', [0, 0, 0, 1])]))  # noqa: Q000
        ProcessModule.perform(MotionDesignator([('type', 'looking'), ('target', [1.3, 0.6, 1])]))  # noqa: Q000
        det_obj = ProcessModule.perform(MotionDesignator([('type', 'detecting'), ('object', object_type)]))  # noqa: Q000
    block = btr.blocking(det_obj, BulletWorld.robot, gripper)
    block_new = list(filter(lambda obj: obj.type != "environment", block))
    if block_new:
        move_object(block_new[0].type, *targets[block_new[0].type])
        ProcessModule.perform(MotionDesignator([('type', 'moving'), ('target', [0.65, 0.7, 0]), ('orientation', [0, 0, 0, 1])]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'pick-up'), ('object', det_obj), ('arm', arm)]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('right-arm', 'park')]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('left-arm', 'park')]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'moving'), ('target', [-0.3, 1, 0]), ('orientation', [0, 0, 1, 0])]))  # noqa: Q000
    if btr.reachable_pose(target, BulletWorld.robot, gripper):
        ProcessModule.perform(MotionDesignator([('type', 'place'), ('object', det_obj), ('target', target), ('arm', arm)]))  # noqa: Q000
    ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('left-arm', 'park'), ('right-arm', 'park')]))  # noqa: Q000
    if not btr.stable(det_obj):
        raise btr.ReasoningError
    # fmt: on


@pytest.mark.slow
@pytest.mark.parametrize(
    "listing_5_1",
    [lambda world: world.simulate(2), lambda world: world.settle(), lambda _: None],
    ids=["simulate", "settle", "as printed"],
    indirect=True,
)
def test_the_plan_runs_to_its_end_although_the_spoon_lies_in_the_bowl(listing_5_1: dict[str, Object]) -> None:
    """For the engine, the spoon is several millimetres inside of the bowl, at rest."""
    for object_type in ("milk", "bowl", "cereal"):
        move_object(object_type, *targets[object_type])
    for object_type in ("milk", "bowl", "cereal"):
        body, target = listing_5_1[object_type], targets[object_type][0]
        assert math.dist(body.get_position()[:2], target[:2]) < 0.02, object_type
        assert geometry.lean(body.get_orientation(), geometry.IDENTITY[1]) < math.radians(5), object_type
    assert listing_5_1["spoon"].get_position()[0] > 1.2, "it stays on the counter"


def stretched_out(robot: Object) -> dict[str, dict[str, float]]:
    """Turns both arms away from where they are parked; returns by arm where they would be."""
    parked = {name: arm.posture("park") for name, arm in robot.description.arms.items()}
    robot.set_joint_positions({joint: 0.9 * value - 0.05 for arm in parked.values() for joint, value in arm.items()})
    return parked


def joints_of(robot: Object, joints: dict[str, float]) -> dict[str, float]:
    return {joint: robot.get_joint_position(joint) for joint in joints}


@pytest.mark.slow
def test_listing_5_3_moves_base_arms_and_head_in_branches(sink: MemorySink, listing_5_1: dict[str, Object]) -> None:
    robot, object_type = listing_5_1["pr2"], "milk"
    parked = stretched_out(robot)
    sink.records.clear()
    # fmt: off
    with par as s:
        ProcessModule.perform(MotionDesignator([('type', 'move-arm-joints'), ('left-arm', 'park'), ('right-arm', 'park')]))  # noqa: Q000
        ProcessModule.perform(MotionDesignator([('type', 'moving'), ('target', [0.65, 0.7, 0]), ('orientation', [0, 0, 0, 1])]))  # noqa: Q000
        ProcessModule.perform(MotionDesignator([('type', 'looking'), ('target', [1.3, 0.6, 1])]))  # noqa: Q000
        det_obj = ProcessModule.perform(MotionDesignator([('type', 'detecting'), ('object', object_type)]))  # noqa: Q000
    # fmt: on
    assert det_obj == listing_5_1["milk"]
    assert [branch.state.name for branch in s.branches] == ["SUCCEEDED"] * 4
    for joints in parked.values():
        assert joints_of(robot, joints) == pytest.approx(joints)
    assert robot.get_position() == [0.65, 0.7, 0]
    threads = {record.thread for record in sink.of(Mutation)}
    assert threads == {"par-1 move-arm-joints", "par-2 moving", "par-3 looking"}


def test_three_branches_move_base_and_arms(sink: MemorySink, listing_5_1: dict[str, Object]) -> None:
    robot = listing_5_1["pr2"]
    parked = stretched_out(robot)
    sink.records.clear()
    with par as s:
        for arm in parked:
            ProcessModule.perform(MotionDesignator([("type", "move-arm-joints"), (f"{arm}-arm", "park")]))
        ProcessModule.perform(MotionDesignator([("type", "moving"), ("target", [0.3, 0.7, 0])]))
    assert s.state.name == "SUCCEEDED"
    assert robot.get_position() == [0.3, 0.7, 0]
    moved = {record.thread: record for record in sink.of(Mutation)}
    assert sorted(moved) == ["par-1 move-arm-joints", "par-2 move-arm-joints", "par-3 moving"]
    for (name, joints), thread in zip(parked.items(), sorted(moved), strict=False):
        assert joints_of(robot, joints) == pytest.approx(joints)
        assert set(moved[thread].move_joints.joints) == set(joints), name
    assert moved["par-3 moving"].move_body.position == [0.3, 0.7, 0]
    (block,) = [node for node in tasks.tree().roots if node.name == "par"]
    assert [(child.kind, child.name, child.status.word) for child in block.children] == [
        ("motion", "move-arm-joints", "succeeded"),
        ("motion", "move-arm-joints", "succeeded"),
        ("motion", "moving", "succeeded"),
    ]


@pytest.mark.slow
def test_an_obstacle_is_named_by_blocking_and_can_be_moved(listing_5_1: dict[str, Object]) -> None:
    """A box before the milk: blocking names it, and when it is gone the way is free (Listing 5.4)."""
    robot, milk, cereal = listing_5_1["pr2"], listing_5_1["milk"], listing_5_1["cereal"]
    robot.set_position([0.65, 0.7, 0])
    x, y, _ = milk.get_position()
    cereal.set_position([x - 0.06, y, 0.963], [0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    found = btr.blocking(milk, robot, "l_gripper_tool_frame", grasp="front")
    assert cereal in found
    assert "l_gripper_palm_link" in found.evidence["obstacles"]["cereal"]["links"]
    cereal.set_position([1.3, 0.3, 0.963])
    assert not btr.blocking(milk, robot, "l_gripper_tool_frame", grasp="front")
