"""Attached bodies keep their relative pose; drawers move the bodies that they support."""

from __future__ import annotations

import math
from contextlib import nullcontext

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AttachmentError
from pycram.language import par
from pycram.world.attachment import StillHeld
from recorder import geometry
from tests.pycram.motions.placing_scenes import perform

DRAWER = "sink_area_left_upper_drawer_main_joint"


def relative(carrier: Object, link: str, body: Object) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return geometry.multiply(
        geometry.invert(carrier.get_link_position_and_orientation(link)), body.get_position_and_orientation()
    )


def assert_kept(before: object, after: object, metres: float = 1e-7, degrees: float = 1e-5) -> None:
    assert math.dist(before[0], after[0]) < metres
    assert math.degrees(geometry.angle(before[1], after[1])) < degrees


def test_attached_bodies_keep_their_relative_pose_through_chains_and_joints(scene: BulletWorld) -> None:
    robot, milk, spoon = scene.robot, scene.get_object("milk"), scene.get_object("spoon")
    link = "l_gripper_tool_frame"
    milk.set_position_and_orientation([0.9, 1.1, 1.2], [0.2, 0.1, 0.3, 0.9])
    robot.attach(milk, link)
    milk.attach(spoon)
    held, carried = relative(robot, link, milk), relative(milk, milk.base_link, spoon)
    robot.set_position_and_orientation([-0.4, 0.2, 0], [0, 0, 0.6, 0.8])
    robot.set_joint_positions({"l_elbow_flex_joint": -1.0, "torso_lift_joint": 0.1})
    assert_kept(held, relative(robot, link, milk))
    assert_kept(carried, relative(milk, milk.base_link, spoon))
    assert robot.attachments[milk] is milk.attachments[robot]
    assert milk.carrier is robot


@pytest.mark.slow
def test_an_attached_body_stays_in_the_gripper_in_simulation(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    link = "l_gripper_tool_frame"
    milk.set_position_and_orientation(robot.get_link_position(link), [0.1, 0, 0, 1])
    robot.attach(milk, link)
    before = relative(robot, link, milk)
    scene.simulate(2)
    assert_kept(before, relative(robot, link, milk), metres=1e-3, degrees=0.1)
    robot.detach(milk)
    scene.simulate(0.5)
    assert math.dist(before[0], relative(robot, link, milk)[0]) > 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "height", "held"), [("cup", 0.05, True), ("bowl", 0.04, False)])
def test_an_object_that_closed_fingers_hold_after_its_detachment_is_warned_of(
    scene: BulletWorld, kind: str, height: float, held: bool
) -> None:
    """The fingers hold a cup on two sides by friction; a bowl's rim slips out."""
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    thing = Object("thing", kind, f"{kind}.stl", [1.36, 1.2, 0.853 + height])
    assert scene.settle()
    perform(type="pick-up", object=thing, arm="left")
    perform(type="move-arm-joints", left_arm="park")
    before = thing.get_position()[2]
    with pytest.warns(StillHeld, match="fingers of the left gripper still hold thing") if held else nullcontext():
        scene.robot.detach(thing)
    scene.simulate(1)
    assert (before - thing.get_position()[2] < 0.01) is held


def test_moving_an_attached_body_renews_its_relative_pose(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    robot.attach(milk, "r_gripper_tool_frame")
    stood = robot.get_position()
    milk.set_position([1.0, 0.2, 1.3])
    assert robot.get_position() == stood
    assert milk.get_position() == pytest.approx([1.0, 0.2, 1.3])
    robot.set_position([stood[0] + 0.1, stood[1], stood[2]])
    assert milk.get_position() == pytest.approx([1.1, 0.2, 1.3])
    before = relative(robot, "r_gripper_tool_frame", milk)
    scene.simulate(1)
    assert_kept(before, relative(robot, "r_gripper_tool_frame", milk), metres=1e-3, degrees=0.1)


def test_impossible_attachments_are_refused(scene: BulletWorld) -> None:
    robot, milk, bowl = scene.robot, scene.get_object("milk"), scene.get_object("bowl")
    milk.attach(bowl)
    before = dict(milk.attachments)
    milk.attach(bowl, None, None)  # there already: nothing changes
    assert dict(milk.attachments) == before
    for carrier, body, reason in (
        (bowl, bowl, "itself"),
        (robot, bowl, "milk carries bowl"),
        (robot, scene.get_object("kitchen"), "fixed"),
    ):
        with pytest.raises(AttachmentError, match=reason):
            carrier.attach(body)
    bowl.detach(milk)
    with pytest.raises(AttachmentError, match="not attached"):
        milk.detach(bowl)
    robot.attach(bowl)
    bowl.attach(milk)
    with pytest.raises(AttachmentError):
        milk.attach(robot)
    with BulletWorld() as other:
        stranger = Object("cup", "cup", "cup.stl", world=other)
        with pytest.raises(AttachmentError, match="another world"):
            robot.attach(stranger)


def test_a_thing_is_attached_to_a_robot_or_furniture_from_either_side(scene: BulletWorld) -> None:
    robot, milk, kitchen = scene.robot, scene.get_object("milk"), scene.get_object("kitchen")
    milk.attach(robot, None, "r_gripper_tool_frame")
    assert milk.carrier is robot
    assert robot.attachments[milk].carrier_link == "r_gripper_tool_frame"
    before = relative(robot, "r_gripper_tool_frame", milk)
    robot.set_position([0, 0, 0])
    assert_kept(before, relative(robot, "r_gripper_tool_frame", milk))
    milk.detach(robot)
    milk.attach(kitchen, None, "sink_area_left_upper_drawer_main")
    there = milk.get_position()
    kitchen.set_joint_position(DRAWER, 0.2)
    assert math.dist(milk.get_position(), there) == pytest.approx(0.2, abs=1e-6)


@pytest.mark.slow
def test_a_drawer_moves_the_bodies_that_it_supports(scene: BulletWorld) -> None:
    kitchen, spoon, milk = scene.get_object("kitchen"), scene.get_object("spoon"), scene.get_object("milk")
    kitchen.set_joint_position(DRAWER, 0.4)
    plate = Object("plate", "plate", "plate.stl", [1.2, 0.7, 0.74])
    apple = Object("apple", "apple", "apple.stl", [1.2, 0.7, 0.79])
    scene.simulate(0.5)
    rests = {body: body.get_position() for body in (spoon, plate, apple, milk)}
    kitchen.set_joint_position(DRAWER, 0.15)
    for body in (spoon, plate, apple):
        assert body.get_position()[0] == pytest.approx(rests[body][0] + 0.25, abs=1e-6), body
        assert body.get_position()[1:] == pytest.approx(rests[body][1:], abs=1e-6)
    assert milk.get_position() == rests[milk]


def test_the_result_of_a_branch_can_be_attached(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    with par as s:
        found = s(scene.get_object, "milk")
    robot.attach(found, "l_gripper_tool_frame")
    assert milk.carrier is robot
    robot.detach(milk)
    assert milk.carrier is None


@pytest.mark.slow
def test_a_long_chain_of_attachments_stays_together_in_simulation(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    x, y, z = robot.get_link_position("l_gripper_tool_frame")
    milk.set_position([x + 0.05, y, z])
    cup = Object("cup", "cup", "cup.stl", [x + 0.05, y, z + 0.2])
    plate = Object("plate", "plate", "plate.stl", [x + 0.05, y + 0.3, z + 0.2])
    robot.attach(milk, "l_gripper_tool_frame")
    milk.attach(cup)
    cup.attach(plate)
    before = [relative(robot, "l_gripper_tool_frame", body) for body in (milk, cup, plate)]
    scene.simulate(1.0)
    for body, (position, orientation) in zip((milk, cup, plate), before, strict=True):
        now = relative(robot, "l_gripper_tool_frame", body)
        assert math.dist(now[0], position) < 1e-3, body
        assert geometry.angle(now[1], orientation) < math.radians(0.1), body
