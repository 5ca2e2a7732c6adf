"""All robots with arms in example-robot-data load, hold still and have the poses of their files.

The table is that of ``docs/reference/robot_models.md``; ``make test-long`` tells how long each takes to load.
"""

from __future__ import annotations

import math
import random
import re
import time
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError
from pycram.models import files
from recorder import geometry
from tests.measures import seeded

if TYPE_CHECKING:
    from collections.abc import Callable

GUIDE = (Path(__file__).parents[3] / "docs" / "reference" / "robot_models.md").read_text()
FOLDER = files.find("pr2.urdf").parents[2]
ROWS = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in GUIDE.splitlines() if ".urdf` |" in line]
ROBOTS = [row for row in ROWS if len(row) == 5 and (FOLDER / row[0]).is_file()]
REFUSED = [row for row in ROWS if len(row) == 2 and (FOLDER / row[0]).is_file()]
SAME_VERSION = f"example-robot-data {metadata.version('example-robot-data')}" in GUIDE


def moved(robot: Object, seconds: float) -> tuple[float, float]:
    """How far joints (rad or m) and link frames (m) are from where they were, at most, while time passes."""
    joints, links = robot.get_joint_positions(), {name: robot.get_link_position(name) for name in robot.links}
    turn = way = 0.0
    for _ in range(4):
        robot.world.simulate(seconds / 4)
        now = robot.get_joint_positions()
        turn = max([turn, *(abs(now[name] - before) for name, before in joints.items())])
        way = max([way, *(math.dist(robot.get_link_position(name), before) for name, before in links.items())])
    return turn, way


def kinematic_error(robot: Object, numbers: random.Random) -> tuple[float, float]:
    """Largest distance (m) and angle (rad) of link poses in the engine from those computed from the file."""
    far = turned = 0.0
    for _ in range(3):
        values = {}
        for name in robot.joints:
            if name in robot.urdf.mimics:
                continue
            lower, upper = robot.joint_limits(name)
            values[name] = numbers.uniform(max(lower, -math.pi), min(upper, math.pi))
        robot.set_joint_positions(values)
        base = robot.get_position_and_orientation()
        for link, pose in robot.urdf.link_poses(values).items():
            wanted, found = geometry.multiply(base, pose), robot.get_link_position_and_orientation(link)
            far = max(far, math.dist(wanted[0], found[0]))
            turned = max(turned, geometry.angle(wanted[1], found[1]))
    return far, turned


@seeded("robots of example-robot-data", range(len(ROBOTS)), 1, always=4)
def test_robots_load_hold_still_and_have_the_poses_of_their_files(
    world: BulletWorld, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    for number in seeds:
        path, links, joints, mimic, still = ROBOTS[number]
        times = []
        for name in ("again", "robot"):
            begun = time.perf_counter()
            robot = Object(name, "robot", FOLDER / path, [0, 0, 3])
            times.append(round((time.perf_counter() - begun) * 1000))
            if name == "again":
                robot.remove()
        record_property("ms first load", times[0])
        record_property("ms second load", times[1])
        start = robot.get_joint_positions()
        for name, value in start.items():
            lower, upper = robot.joint_limits(name)
            assert lower <= value <= upper, name
        turn, way = moved(robot, 2)
        assert turn < 1e-3
        assert way < 1e-3
        assert turn * 1000 == pytest.approx(float(still), abs=0.1)
        far, turned = kinematic_error(robot, random.Random(number))
        assert far < 1e-4  # the engine's numbers of a chain of links are 32-bit
        assert turned < 1e-4
        turn, way = moved(robot, 0.25)  # what the load makes of a posture shows in the first steps
        assert turn < 1e-3
        assert way < 1e-3
        if SAME_VERSION:
            assert [len(robot.links), len(robot.joints), len(robot.urdf.mimics)] == [
                int(links),
                int(joints),
                int(mimic),
            ]


@pytest.mark.parametrize(("path", "cause"), REFUSED, ids=[row[0] for row in REFUSED])
def test_robots_that_can_t_be_loaded_say_why(world: BulletWorld, path: str, cause: str) -> None:
    with pytest.raises(AssetError, match=re.escape(cause)):
        Object("robot", "robot", FOLDER / path)
    assert not world.objects


def test_the_table_has_every_robot_with_arms() -> None:
    names = " ".join(row[0] for row in ROBOTS)
    assert all(
        name in names for name in ("pr2", "panda", "ur5", "ur10", "tiago", "baxter", "kinova", "talos", "xarm", "z1")
    )
