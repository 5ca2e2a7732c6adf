"""Which grasps are found: also what only a long search of the arm finds, and near what fingers sweep."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.models.shapes import pieces_of
from pycram.process_module import ProcessModule
from pycram.reasoning.grasping import fingers
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.geometry import Vector


@pytest.fixture(scope="module")
def panda() -> Iterator[Object]:
    with BulletWorld() as world:
        world.robot = robot = Object("panda", "robot", "panda.urdf")
        assert robot.description is not None
        robot.set_joint_positions(robot.description.arm("panda").posture("park"))
        Object("apple", "apple", "apple.stl", [0.5, 0, 0.5])
        Object("cereal", "cereal", "breakfast_cereal.stl", [0.5, 0.3, 0.5])
        yield robot


@pytest.mark.parametrize(
    ("apple", "cereal"),
    [
        ((0.68, -0.54, 0.27), (0.77, -0.4, 0.22)),
        ((0.58, -0.55, 0.41), (0.7, -0.49, 0.4)),
        ((0.59, -0.48, 0.12), (0.62, -0.47, 0.23)),
        ((0.69, -0.55, 0.32), (0.65, -0.41, 0.43)),
    ],
)
def test_a_free_grasp_is_found_even_if_the_quick_search_finds_only_blocked_ones(
    panda: Object, apple: Vector, cereal: Vector
) -> None:
    world = panda.world
    target = world.get_object("apple")
    target.set_position(apple)
    world.get_object("cereal").set_position(cereal)
    assert btr.blocking(target, panda, "panda_hand_tcp") == []


@pytest.mark.parametrize("at", [(0.3, -0.1), (0.45, -0.1), (0.45, 0.1)])
def test_an_arm_reaches_behind_itself_if_its_first_posture_is_blocked(at: tuple[float, float]) -> None:
    """It is found first with its elbow down, in the table."""
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("table", "environment", "table.urdf", [-0.35, 0, 0])
        world.robot = robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 0.72], [0, 0, 1, 0])
        robot.set_joint_positions(robot.description.arm("ur5").posture("park"))
        spoon = Object("spoon", "spoon", "spoon.stl", [*at, 0.73])
        assert btr.blocking(spoon, robot, "gripper_tool") == []
        spoon.set_position([-0.4, 0.1, 0.73])
        ProcessModule.perform(MotionDesignator(type="pick-up", object=spoon, arm="ur5"))
        down = MotionDesignator(type="place", object=spoon, target=[*at, 0.73], orientation=[0, 0, 0, 1], arm="ur5")
        ProcessModule.perform(down)


@pytest.mark.parametrize("model", ["pr2.urdf", "panda.urdf", "ur5.urdf", "tiago_pro.urdf"])
def test_everything_that_fingers_sweep_is_checked(model: str) -> None:
    with BulletWorld() as world:
        robot = Object("robot", "robot", model)
        assert robot.description is not None
        pieces = list(pieces_of(robot.model.path))
        shares = np.random.default_rng(3).uniform(0.0, 1.0, 12)
        for arm in robot.description.arms.values():
            gripper = arm.gripper
            swept = fingers._swept(robot.model.path, gripper, ())
            for share in shares.tolist():
                robot.set_joint_positions(gripper.at(share))
                palm_T_world = geometry.invert(world.engine.link_pose(robot.handle, gripper.palm))
                for finger in gripper.fingers:
                    pose = geometry.multiply(palm_T_world, world.engine.link_pose(robot.handle, finger))
                    matrix = geometry.pose_matrix(pose)
                    for piece in (corners for link, corners in pieces if link == finger):
                        there = piece @ matrix[:3, :3].T + matrix[:3, 3]
                        outside = np.abs(there[:, None] - swept.centers) - swept.half_extents
                        within = (outside.max(axis=2) <= 0.0).all(axis=0)  # one box has all corners
                        assert within.any(), (arm.name, finger, share)
