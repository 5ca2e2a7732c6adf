"""Objects: poses, joints, names and lookups (thesis, table 4.2), reset and removal."""

from __future__ import annotations

import math

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import BadArgument, ChangeRefused, UnknownName, WorldClosed
from pycram.reasoning.queries.query import Verdict, query


def test_setting_a_pose_is_exact_and_no_time_passes(world: BulletWorld) -> None:
    for mesh in ("spoon.stl", "bowl.stl", "milk.stl"):
        body = Object(mesh, "thing", mesh, [0, 0, 1])
        body.set_position_and_orientation([0.3, -0.2, 1.7], [0.1, 0.2, 0.3, 0.9])
        length = math.sqrt(0.01 + 0.04 + 0.09 + 0.81)
        assert body.get_position() == pytest.approx([0.3, -0.2, 1.7], abs=1e-12)
        assert body.get_orientation() == pytest.approx([x / length for x in (0.1, 0.2, 0.3, 0.9)], abs=1e-12)
    assert world.sim_step == 0


def test_the_methods_of_the_thesis_tables(scene: BulletWorld) -> None:
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
def test_robots_hold_their_posture_and_objects_have_masses(scene: BulletWorld) -> None:
    robot = scene.robot
    assert robot is not None
    before = robot.get_joint_positions()
    scene.simulate(2)
    after = robot.get_joint_positions()
    assert max(abs(after[name] - before[name]) for name in before) < 5e-3
    assert robot.get_position() == pytest.approx([0.65, 0.7, 0], abs=1e-9)

    def mass(body: Object) -> float:
        return scene.engine.center_of_mass(body.handle)[1]

    assert mass(scene.get_object("spoon")) < 0.1
    assert mass(scene.get_object("milk")) == pytest.approx(1.05)
    assert 100 < mass(robot) < 260


def test_reset_restores_poses_and_joints_and_ends_attachments(scene: BulletWorld) -> None:
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


def test_methods_of_a_removed_object_raise_world_closed(world: BulletWorld) -> None:
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


def test_changes_are_refused_during_a_query(world: BulletWorld) -> None:
    body = Object("cup", "cup", "cup.stl")

    @query
    def inspect(object: Object, world: BulletWorld | None = None) -> Verdict:  # noqa: A002
        return Verdict(object.set_position([1, 0, 0]))

    with pytest.raises(ChangeRefused, match=r"move body.*inspect"):
        inspect(body)
    body.set_position([1, 0, 0])


def test_a_keyframe_has_an_object_s_present_colour(world: BulletWorld) -> None:
    milk = Object("milk", "milk", "milk.stl")
    assert not world.transactions.keyframe().loaded[0].color
    milk.set_color([1, 0, 0, 1])
    assert world.transactions.keyframe().loaded[0].color == [1, 0, 0, 1]
