"""An arm on the floor with a pillar before it, between two postures of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import Object
from tests.pycram.motions.placing_scenes import box

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pycram.bullet_world import BulletWorld

JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
RIGHT = dict(zip(JOINTS, (-1.0, -0.8, 1.2, -0.4, 1.57, 0.0), strict=True))
LEFT = RIGHT | {"shoulder_pan_joint": 1.0}


@pytest.fixture
def arm(world: BulletWorld) -> Object:
    """A UR5, turned to the right."""
    world.robot = Object("ur5", "robot", "ur5.urdf")
    world.robot.set_joint_positions(RIGHT)
    return world.robot


@pytest.fixture
def pillar(arm: Object, tmp_path: Path) -> Iterator[Object]:
    return Object("pillar", "environment", box(tmp_path, "pillar", (0.1, 0.1, 0.9)), [0.55, 0, 0.45])
