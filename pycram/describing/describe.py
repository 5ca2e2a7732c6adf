"""A first description of a robot as TOML: what its URDF tells, and postures that were tried in a world."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.describing import postures
from pycram.describing.guess import guess
from pycram.describing.text import as_toml
from pycram.models import load
from pycram.models.robots.description import RobotDescription
from pycram.world.object import Object
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from pathlib import Path


def describe(urdf: str | Path) -> str:
    """Return a first description of the robot with a URDF.

    Args:
        urdf: a file, or the name of a robot in the box.

    Raises:
        AssetError: it can't be loaded.
    """
    model = load.load(urdf)
    found = guess(model)
    draft = RobotDescription.parse(as_toml(found), "the first description")
    with BulletWorld() as world:
        robot = Object("robot", "robot", urdf, description=draft, model=model)
        arms = [draft.arm(chain.name) for chain, _ in found.arms]
        with world.lock:
            touching = set().union(*(postures.always_touching(robot, arm) for arm in arms))
        robot.remove()
        tolerant = RobotDescription.parse(as_toml(found, may_touch=touching), "the first description")
        robot = Object("robot", "robot", urdf, description=tolerant, model=model)
        park: dict[str, list[float]] = {}
        with world.lock:
            for arm in arms:
                park[arm.name] = postures.parked(robot, arm)
                robot.set_joint_positions(dict(zip(arm.joints, park[arm.name], strict=True)))
    return as_toml(found, park, touching)
