"""The tool goes straight, and turns evenly; where the arm can't, that is said."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram.failures import Unreachable
from pycram.planning import line
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pycram.bullet_world import BulletWorld, Object
    from recorder.geometry import Pose


def tool_at(robot: Object, posture: Mapping[str, float], frame: str) -> Pose:
    robot.set_joint_positions(posture)
    return robot.get_link_position_and_orientation(frame)


@pytest.mark.parametrize(("name", "frame"), [("left", "l_gripper_tool_frame"), ("right", "r_gripper_tool_frame")])
def test_the_tool_moves_on_a_straight_line(shared_scene: BulletWorld, name: str, frame: str) -> None:
    robot = shared_scene.robot
    arm = robot.description.arm(name)
    start = arm.posture("park") | {
        f"{name[0]}_elbow_flex_joint": -1.5,
        f"{name[0]}_wrist_flex_joint": -0.8,
        "torso_lift_joint": 0.25,
    }
    begin = tool_at(robot, start, frame)
    robot.set_joint_position("torso_lift_joint", 0.2)  # the line begins at the given posture, not at the present one
    goal = geometry.multiply(begin, ((0.05, 0.02, -0.03), geometry.from_rpy(0.1, -0.2, 0.1)))
    before = robot.get_joint_positions()
    postures = line(robot, arm, start, goal)
    assert robot.get_joint_positions() == before
    assert postures[0] == start
    assert len(postures) >= 6
    poses = [tool_at(robot, posture, frame) for posture in postures]
    a, b = np.array(begin[0]), np.array(goal[0])
    for number, (position, orientation) in enumerate(poses):
        share = number / (len(poses) - 1)
        assert math.dist(position, a + share * (b - a)) < 1e-3
        turned = geometry.angle(begin[1], orientation)
        assert turned == pytest.approx(share * geometry.angle(begin[1], goal[1]), abs=0.02)
    assert geometry.angle(poses[-1][1], goal[1]) < 0.01
    assert max(abs(b[j] - a[j]) for a, b in itertools.pairwise(postures) for j in arm.joints) < 0.35


def test_the_failure_tells_where_the_line_ends(arm: Object) -> None:
    start = arm.get_joint_positions()
    position, orientation = arm.get_link_position_and_orientation("gripper_tool")
    with pytest.raises(Unreachable, match=r"stays \d\.\d+ m away; the straight line ends there") as failure:
        line(arm, arm.description.arm("ur5"), start, ([position[0] * 3, position[1] * 3, position[2]], orientation))
    assert 0.5 < failure.value.distance < 2.0
    assert arm.get_joint_positions() == start
