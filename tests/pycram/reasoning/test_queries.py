"""The reasoning queries: right on known cases, and without a trace."""

from __future__ import annotations

import math

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from recorder import geometry

CAMERA = "wide_stereo_optical_frame"


@pytest.fixture
def table(world: BulletWorld) -> Object:
    return Object("floor", "environment", "plane.urdf")


def test_stable(world: BulletWorld, table: Object) -> None:
    bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 0.0345])
    spoon = Object("spoon", "spoon", "spoon.stl", [0, 0, 0.1])
    milk = Object("milk", "milk", "milk.stl", [1, 0, 0.098])
    world.simulate(0.5)
    for body in (bowl, spoon, milk):
        verdict = btr.stable(body)
        assert verdict, body
        assert verdict.evidence["moved"] < 1e-3
    milk.set_orientation(geometry.from_rpy(0.3, 0, 0))
    milk.set_position([1, 0, 0.115])
    fallen = btr.stable(milk)
    assert not fallen
    assert fallen.evidence["moved"] > 0.01 or fallen.evidence["turned"] > 0.08
    spoon.set_position([0, 0, 0.4])
    assert not btr.stable(spoon)
    assert btr.stable(bowl)


def test_a_box_over_the_edge_tips_only_beyond_its_middle(world: BulletWorld, table: Object) -> None:
    base = Object("base", "environment", "breakfast_cereal.stl", [0, 0, 0.112])
    edge = base.get_AABB()[1][0]
    box = Object("box", "box", "milk.stl", [0, 0, 0.3])
    lying = geometry.from_rpy(0, math.pi / 2, 0)  # 0.194 long
    for beyond, stays in ((-0.03, True), (-0.015, True), (0.02, False), (0.05, False)):
        box.set_position_and_orientation([edge + beyond, 0, 0.2235 + 0.0335], lying)
        assert bool(btr.stable(box)) is stays, beyond


def test_held_things_are_stable(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    milk.set_position(robot.get_link_position("l_gripper_tool_frame"))
    assert not btr.stable(milk)
    robot.attach(milk, "l_gripper_tool_frame")
    assert btr.stable(milk)


def test_contact_and_support(scene: BulletWorld) -> None:
    kitchen, milk, bowl, spoon = (scene.get_object(name) for name in ("kitchen", "milk", "bowl", "spoon"))
    assert btr.contact(kitchen, milk)
    assert btr.contact(milk, kitchen).evidence["links"] == [("milk", "sink_area_surface")]
    assert not btr.contact(milk, bowl)
    assert btr.supporting(kitchen, milk).evidence["links"] == ["sink_area_surface"]
    assert btr.supporting(kitchen, spoon).evidence["links"] == ["sink_area_left_upper_drawer_main"]
    assert not btr.supporting(milk, kitchen)
    x, y, z = milk.get_position()
    bowl.set_position([x - 0.1015, y, z])  # beside it, touching, and its origin no higher
    assert btr.contact(milk, bowl, margin=0.005)
    assert not btr.supporting(milk, bowl)


def test_visible_and_occluding(scene: BulletWorld) -> None:
    milk, cereal = scene.get_object("milk"), scene.get_object("cereal")
    scene.robot.set_position([0, -1, 0])  # out of the picture
    x, y, z = milk.get_position()
    eye = [x - 0.8, y, z]
    assert btr.visible(milk, eye)
    assert btr.occluding(milk, eye) == []
    cereal.set_position_and_orientation([x - 0.2, y, z], [0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    hidden = btr.visible(milk, eye)
    assert not hidden
    assert hidden.evidence["share"] < 0.05
    assert btr.occluding(milk, eye) == [cereal]
    shares = []
    for offset in (0.02, 0.06, 0.1, 0.14):
        cereal.set_position([x - 0.2, y + offset, z])
        shares.append(btr.visible(milk, eye).evidence["share"])
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert btr.visible(milk, [x, y, z + 0.8])  # from straight above
    assert not btr.visible(milk, (eye, geometry.look_at(eye, [x - 2, y, z])))  # behind the camera
    assert not btr.visible(milk, [x - 0.01, y, z])  # inside of it
    assert not btr.visible(milk, CAMERA)  # the head looks straight ahead, over it


def test_reachable(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    verdict = btr.reachable(milk, robot, "l_gripper_tool_frame")
    assert verdict
    # the evidence is a posture that really brings the tool there
    robot.set_joint_positions(verdict.evidence["joints"])
    low, high = milk.get_AABB()
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    assert math.dist(robot.get_link_position("l_gripper_tool_frame"), middle) < 0.01
    assert not btr.reachable([1.3, 3, 1], robot, "l_gripper_tool_frame")
    assert not btr.reachable_pose([1.3, 1, 0.95], robot, "l_gripper_tool_frame", orientation=[0, 0, 1, 0])
    inside = [1.5, 0.89, 0.53]  # in a closed drawer
    assert not btr.reachable_pose(inside, robot, "l_gripper_tool_frame", collision_free=True)


def test_blocking_marks_furniture_as_environment(scene: BulletWorld) -> None:
    robot, spoon, kitchen = scene.robot, scene.get_object("spoon"), scene.get_object("kitchen")
    drawer, gripper = "sink_area_left_upper_drawer_main_joint", "r_gripper_tool_frame"
    deep_inside = btr.blocking(spoon, robot, gripper)
    assert deep_inside == []
    assert deep_inside.evidence["reached"] is False, "too far for the arm, whatever is in between"
    kitchen.set_joint_position(drawer, 0.1)
    below_the_counter = btr.blocking(spoon, robot, gripper)
    assert kitchen in below_the_counter
    assert below_the_counter.evidence["obstacles"]["kitchen"]["by"] == ["sink_area_surface"]
    kitchen.set_joint_position(drawer, 0.3)
    in_the_open = btr.blocking(spoon, robot, gripper)
    assert in_the_open == []
    assert in_the_open.evidence["reached"] is True


def asked(world: BulletWorld) -> None:
    robot, milk, kitchen = world.robot, world.get_object("milk"), world.get_object("kitchen")
    for body in world.objects:
        if not body.fixed:
            btr.stable(body)
            btr.visible(body, CAMERA)
            btr.occluding(body, [0.5, 0.5, 1.5])
            btr.blocking(body, robot, "l_gripper_tool_frame")
            btr.contact(body, kitchen)
            btr.supporting(kitchen, body)
    btr.reachable([3, 3, 3], robot, "l_gripper_tool_frame")
    with pytest.raises(ValueError, match="pose"):
        btr.reachable_pose([float("nan")] * 3, robot, "l_gripper_tool_frame")
    btr.stable(milk)


def build() -> BulletWorld:
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    world.robot = Object("pr2", "robot", "pr2.urdf")
    Object("kitchen", "environment", "kitchen.urdf")
    Object("milk", "milk", "milk.stl", [1.3, 1, 1])
    Object("bowl", "bowl", "bowl.stl", [1.3, 0.8, 0.95])
    held = Object("cup", "cup", "cup.stl", [0.8, 0.2, 0.8])
    world.robot.set_position([0.6, 0.7, 0])
    world.robot.attach(held, "l_gripper_tool_frame")
    world.simulate(0.1)  # things are still falling
    return world


@pytest.mark.costly
def test_queries_leave_no_trace_now_or_later() -> None:
    """A world that was asked goes on, bit for bit, as one that wasn't."""
    outcomes = []
    for asks in (False, True):
        with build() as world:
            bits = [
                (b.get_position_and_orientation(), b.get_joint_positions(), world.engine.velocity(b.handle))
                for b in world.objects
            ]
            if asks:
                asked(world)
                assert bits == [
                    (b.get_position_and_orientation(), b.get_joint_positions(), world.engine.velocity(b.handle))
                    for b in world.objects
                ]
            world.simulate(1.0)
            outcomes.append([(b.get_position_and_orientation(), b.get_joint_positions()) for b in world.objects])
    assert outcomes[0] == outcomes[1]
