"""Doors and drawers: what opened from a place closes from there; a failure says where, why, and what would do."""

from __future__ import annotations

import itertools
import math
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import (
    AccessFailed,
    BadArgument,
    HandleBlocked,
    HandleUnreachable,
    PlanFailure,
    UnknownName,
    Unreachable,
)
from pycram.models.files import resources
from pycram.models.robots.description import RobotDescription
from pycram.process_module import ProcessModule
from pycram.world.transaction import restore_snapshot, take_snapshot
from recorder import geometry
from recorder.urdf import Urdf
from tests import measures
from tests.pycram.motions.placing_scenes import box

if TYPE_CHECKING:
    from collections.abc import Iterator

ROBOTS = Path(__file__).parents[3] / "pycram" / "models" / "robots"
KITCHEN = Urdf.parse((resources() / "kitchen.urdf").read_text())
HANDLES = sorted((link for link in KITCHEN.links if link.endswith("_handle")), key=lambda link: "door" not in link)
CASES = list(itertools.product(HANDLES, ("left", "right")))  # doors first
PLACES = 3  # from which each is opened and closed
TRIED = 10  # places that are tried for it
FRIDGE = "iai_fridge_door_joint", "iai_fridge_door_handle"
DRAWER = """<robot name="chest"><link name="chest"/>
<link name="front"><collision><geometry><box size="0.02 0.3 0.1"/></geometry></collision></link>
<link name="bar"><collision><geometry><box size="0.015 0.1 0.015"/></geometry></collision></link>
<joint name="slide" type="prismatic"><parent link="chest"/><child link="front"/><axis xyz="-1 0 0"/>
<limit lower="0" upper="0.3" effort="10" velocity="1"/></joint>
<joint name="hold" type="fixed"><parent link="front"/><child link="bar"/><origin xyz="-0.05 0 0"/></joint></robot>"""


@pytest.fixture
def scene(shared_scene: BulletWorld) -> BulletWorld:
    return shared_scene


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def access(scene: BulletWorld, joint: str, handle: str, arm: str, distance: float) -> None:
    kitchen = scene.get_object("kitchen")
    perform(type="accessing", drawer_joint=joint, drawer_handle=handle, part_of=kitchen, arm=arm, distance=distance)


def go(x: float, y: float, yaw: float) -> None:
    perform(type="moving", target=[x, y, 0.0], orientation=list(geometry.from_rpy(0, 0, yaw)))


def joint_of(handle: str) -> str:
    joint = KITCHEN.parent_joint(handle)
    while not joint.movable:
        joint = KITCHEN.parent_joint(joint.parent)
    return joint.name


def places(kitchen: Object, joint: str, handle: str) -> Iterator[tuple[float, float, float]]:
    """Where a robot may stand before a handle and face it."""
    closed = np.array(kitchen.get_link_position(handle))
    kitchen.set_joint_position(joint, 0.05)
    way = np.array(kitchen.get_link_position(handle)) - closed
    kitchen.set_joint_position(joint, 0.0)
    axis = int(np.argmax(np.abs(way[:2])))
    out = np.sign(way[axis]) * np.eye(3)[axis]
    side = np.array([-out[1], out[0], 0.0])
    for distance, beside in itertools.product((0.7, 0.6, 0.8, 0.9), (0.0, -0.2, 0.2, -0.4, 0.4, -0.6, 0.6)):
        x, y, _ = (closed + distance * out + beside * side).tolist()
        yield x, y, math.atan2(-out[1], -out[0])


@measures.seeded(
    "doors and drawers that open close again", range(len(CASES))[::-1], 1, always=3
)  # the fridge, last, takes longest
def test_what_opened_from_a_place_closes_from_there(
    built: BulletWorld, seeds: range, record_property: pytest.RecordProperty
) -> None:
    kitchen, before = built.get_object("kitchen"), {body: take_snapshot(body) for body in built.objects}
    opened = somewhere = 0
    for seed in seeds:
        handle, arm = CASES[seed]
        joint = joint_of(handle)
        distance = 0.3 if KITCHEN.joint(joint).type == "prismatic" else 1.0
        tried = times = 0
        for place in list(places(kitchen, joint, handle)):
            for body, state in before.items():
                restore_snapshot(body, state)
            try:
                go(*place)
                tried += 1
                access(built, joint, handle, arm, distance)
            except PlanFailure:
                if tried == TRIED:
                    break
                continue
            times += 1
            assert kitchen.get_joint_position(joint) == pytest.approx(distance)
            with suppress(PlanFailure):  # where it stands open in the way of the arm, that stays at the handle
                perform(type="move-arm-joints", left_arm="park", right_arm="park")
            access(built, joint, handle, arm, 0.0)
            assert kitchen.get_joint_position(joint) == pytest.approx(0.0, abs=1e-6)
            if times == PLACES:
                break
        opened += times
        somewhere += times > 0
    for body, state in before.items():
        restore_snapshot(body, state)
    record_property("opened and closed", opened)
    record_property("handles and arms that open something", somewhere)


@pytest.mark.slow
def test_a_handle_out_of_reach_is_named_with_joint_value_and_orientation_and_what_would_do(scene: BulletWorld) -> None:
    joint, handle = "sink_area_left_upper_drawer_main_joint", "sink_area_left_upper_drawer_handle"
    go(0.1, 0.7, 0.0)
    with pytest.raises(HandleUnreachable) as raised:
        access(scene, joint, handle, "left", 0.3)
    failure = raised.value
    assert isinstance(failure, AccessFailed)
    assert isinstance(failure, Unreachable)  # recoveries by that type serve here, too
    assert (failure.joint, failure.handle, failure.arm) == (joint, handle, "left")
    assert (failure.value, failure.asked) == pytest.approx((0.0, 0.3), abs=1e-6)
    assert failure.reached is None
    assert failure.distance > 0.05
    forward = geometry.rotate(failure.orientation, (1, 0, 0))
    assert forward == pytest.approx((1, 0, 0), abs=1e-6)  # from the front
    for part in (joint, handle, "left arm", f"stays {failure.distance:.3f} m"):
        assert part in str(failure)
    (place,) = [
        re.search(r"the (\w+) arm can move the handle with the robot at \[(.*?)\]", each) for each in failure.remedies
    ]
    x, y, _ = (float(part) for part in place[2].split(","))
    go(x, y, 0.0)
    access(scene, joint, handle, place[1], 0.3)


@pytest.mark.slow
def test_a_robot_that_is_bolted_down_is_not_told_to_stand_elsewhere(world: BulletWorld, tmp_path: Path) -> None:
    drawer = tmp_path / "drawer.urdf"
    drawer.write_text(DRAWER)
    drives = RobotDescription.load(ROBOTS / "pr2.toml")
    chest = Object("chest", "environment", drawer, [1.4, 0.0, 0.9])
    remedies = {}
    for description in (drives, replace(drives, drives=False)):
        world.robot = robot = Object("pr2", "robot", "pr2.urdf", description=description)
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
        with pytest.raises(HandleUnreachable) as raised:
            perform(
                type="accessing", drawer_joint="slide", drawer_handle="bar", part_of=chest, arm="left", distance=0.2
            )
        remedies[description.drives] = raised.value.remedies
        robot.remove()
    assert any("with the robot at" in remedy for remedy in remedies[True])
    assert remedies[False] == ["other arms and nearby places don't help"]


@pytest.mark.slow
def test_an_arm_that_gets_no_further_says_how_far_it_gets(scene: BulletWorld) -> None:
    joint, handle = FRIDGE
    before = take_snapshot(scene.robot)
    x, y, yaw = next(places(scene.get_object("kitchen"), joint, handle))
    go(x, y, yaw)
    with pytest.raises(AccessFailed) as raised:
        access(scene, joint, handle, "left", 1.5)
    assert take_snapshot(scene.robot).positions == before.positions
    reached = raised.value.reached
    assert reached is not None
    assert f"from here the arm could move the joint to {reached:.3f}" in str(raised.value)
    access(scene, joint, handle, "left", reached)
    assert scene.get_object("kitchen").get_joint_position(joint) == pytest.approx(reached)


@pytest.mark.slow
def test_what_is_in_the_way_is_named_with_the_links_that_would_touch(scene: BulletWorld) -> None:
    joint, handle = "sink_area_left_upper_drawer_main_joint", "sink_area_left_upper_drawer_handle"
    x, y, z = scene.get_object("kitchen").get_link_position(handle)
    Object("pot", "pot", "pot.stl", [x - 0.1, y, z])
    with pytest.raises(HandleBlocked, match="pot would be in the way") as raised:
        access(scene, joint, handle, "left", 0.3)
    (pair,) = [pair for pair in raised.value.pairs if pair.body == "pot"]
    assert pair.mover == "kitchen"
    assert pair.link in {handle, KITCHEN.joint(joint).child}
    assert pair.depth > 0.002
    assert raised.value.bodies == ["pot"]


@pytest.mark.slow
def test_links_that_touch_with_several_shapes_are_named_once(scene: BulletWorld) -> None:
    joint, handle = "kitchen_island_left_lower_drawer_main_joint", "kitchen_island_left_lower_drawer_handle"
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    go(-0.07047, 0.87258, -3.59553)
    with pytest.raises(HandleBlocked, match="base_link would touch") as raised:
        access(scene, joint, handle, "right", 0.48)
    links = [(pair.link, pair.body_link) for pair in raised.value.pairs]
    assert ("base_link", "kitchen_island_left_lower_drawer_main") in links
    assert len(links) == len(set(links))
    depths = [pair.depth for pair in raised.value.pairs]
    assert depths == sorted(depths, reverse=True)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_drawer_near_the_floor_is_opened_and_closed_with_the_torso_down(scene: BulletWorld, arm: str) -> None:
    joint, handle = "sink_area_left_bottom_drawer_main_joint", "sink_area_left_bottom_drawer_handle"
    kitchen, robot = scene.get_object("kitchen"), scene.robot
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    height = robot.get_joint_position("torso_lift_joint")
    for place in places(kitchen, joint, handle):
        with suppress(PlanFailure):
            go(*place)
            access(scene, joint, handle, arm, 0.3)
            break
    assert kitchen.get_joint_position(joint) == pytest.approx(0.3)
    assert robot.get_joint_position("torso_lift_joint") < height - 0.02
    x, _, z = robot.get_link_position(robot.description.arm(arm).tool_frame)
    bar_x, _, bar_z = kitchen.get_link_position(handle)  # it runs along y
    assert math.hypot(x - bar_x, z - bar_z) < 0.02, "the hand is at the bar"
    access(scene, joint, handle, arm, 0.0)
    assert kitchen.get_joint_position(joint) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_what_lies_in_a_drawer_goes_in_with_it(scene: BulletWorld, tmp_path: Path) -> None:
    """The hand that closes it ends where the tray is as long as it is open."""
    drawer = "sink_area_left_upper_drawer_main_joint", "sink_area_left_upper_drawer_handle", "left"
    go(0.65, 0.7, 0.0)
    tray = Object("tray", "tray", box(tmp_path, "tray", (0.16, 0.6, 0.07)), [1.36, 0.93, 0.75], world=scene)
    try:
        scene.simulate(0.5)
        lay = tray.get_position()
        access(scene, *drawer, 0.35)
        assert tray.get_position() == pytest.approx([lay[0] - 0.35, *lay[1:]], abs=1e-3)
        perform(type="move-arm-joints", left_arm="park")
        access(scene, *drawer, 0.0)
        assert tray.get_position() == pytest.approx(lay, abs=1e-3)
    finally:
        tray.remove()


@pytest.mark.slow
def test_an_arm_in_the_way_is_named_and_parking_it_helps_where_the_failure_says_so(scene: BulletWorld) -> None:
    joint, handle = "sink_area_left_upper_drawer_main_joint", "sink_area_left_upper_drawer_handle"
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    go(0.49, 0.89, 0.0)
    perform(type="move-tcp", arm="left", target=[1.166, 0.87, 0.915])  # its forearm is above the bar
    with pytest.raises(HandleBlocked, match="l_forearm_link would touch") as raised:
        access(scene, joint, handle, "right", 0.3)
    assert "the right arm can move the handle from here if the left arm is parked" in raised.value.remedies
    perform(type="move-arm-joints", left_arm="park")
    access(scene, joint, handle, "right", 0.3)
    assert scene.get_object("kitchen").get_joint_position(joint) == pytest.approx(0.3)


@pytest.mark.slow
def test_an_arm_that_is_in_the_way_where_it_is_parked_is_named(scene: BulletWorld) -> None:
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    go(0.58, -0.37, 0.0)
    with pytest.raises(HandleBlocked, match="r_gripper_r_finger_link would touch") as raised:
        access(scene, *FRIDGE, "left", 1.0)
    assert "the right arm is in the way even if it is parked" in raised.value.remedies


@pytest.mark.slow
def test_a_door_doesnt_open_through_the_robot(scene: BulletWorld) -> None:
    kitchen, robot, (joint, handle) = scene.get_object("kitchen"), scene.robot, FRIDGE
    x, y, _ = kitchen.get_link_position(handle)
    for place in itertools.product((0.6, 0.5, 0.7), (0.3, 0.2, 0.4, 0.1)):
        go(x - place[0], y + place[1], 0.0)
        with suppress(AccessFailed):
            access(scene, joint, handle, "right", 1.2)
            overlaps = [
                touch
                for touch in scene.engine.closest_points(robot.handle, kitchen.handle)
                if touch.distance < -0.005 and touch.link_b.startswith("iai_fridge_door")
            ]
            assert all("gripper" in touch.link_a and touch.link_b == handle for touch in overlaps)
            kitchen.set_joint_position(joint, 0.0)
        for arm in robot.description.arms.values():
            robot.set_joint_positions(arm.posture("park"))


def test_what_the_other_hand_holds_is_in_a_drawers_way(scene: BulletWorld) -> None:
    kitchen, milk, robot = scene.get_object("kitchen"), scene.get_object("milk"), scene.robot
    joint, handle = "sink_area_left_upper_drawer_main_joint", "sink_area_left_upper_drawer_handle"
    x, y, z = kitchen.get_link_position(handle)
    milk.set_position([x - 0.12, y - 0.25, z])  # before the drawer's end
    robot.attach(milk, "r_gripper_tool_frame")
    before = robot.get_joint_positions()
    with pytest.raises(
        HandleBlocked, match=r"milk would be in the way: sink_area_left_upper_drawer\w* would touch milk"
    ):
        access(scene, joint, handle, "left", 0.3)
    assert kitchen.get_joint_position(joint) == pytest.approx(0.0, abs=1e-6)
    assert robot.get_joint_positions() == before
    robot.detach(milk)
    milk.set_position([x, y - 2.0, z])
    access(scene, joint, handle, "left", 0.3)
    assert kitchen.get_joint_position(joint) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("joint", "handle", "error"),
    [
        ("sink_area_left_uper_drawer_main_joint", "sink_area_left_upper_drawer_handle", UnknownName),
        ("sink_area_left_upper_drawer_main_joint", "sink_area_left_uper_drawer_handle", UnknownName),
        ("sink_area_left_upper_drawer_main_joint", "iai_fridge_door_handle", BadArgument),
    ],
)
def test_a_wrong_name_is_told_before_a_full_hand(
    scene: BulletWorld, joint: str, handle: str, error: type[Exception]
) -> None:
    scene.robot.attach(scene.get_object("milk"), "l_gripper_tool_frame")
    with pytest.raises(error):
        access(scene, joint, handle, "left", 0.3)
    with pytest.raises(AccessFailed, match="the left gripper holds milk"):
        access(scene, "sink_area_left_upper_drawer_main_joint", "sink_area_left_upper_drawer_handle", "left", 0.3)
