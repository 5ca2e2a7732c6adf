"""Descriptions of robots are checked against the URDF; invalid descriptions are rejected with a cause."""

from __future__ import annotations

from pathlib import Path

import pytest

import pycram.models.robots
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError
from pycram.models.robots.description import RobotDescription

PR2 = (Path(pycram.models.robots.__file__).parent / "pr2.toml").read_text()

BROKEN = {
    "not TOML": ("robot = ", "robot = = ", "TOML"),
    "no base": ('base_link = "base_footprint"', "", "base_link"),
    "unknown entry": ('robot = "pr2"', 'robot = "pr2"\nwheels = 4', "wheels = 4: expected only robot, base_link"),
    "opening of less than nothing": ("aperture = 0.090", "aperture = -1", "aperture = -1"),
    "camera without width": ("width = 640", "width = 0", "width = 0"),
    "field of view of nothing": ("horizontal_fov = ", "horizontal_fov = -", "horizontal_fov = -"),
    "far before near": ("far = 10.0", "far = 0.001", "far = 0.001"),
    "an arm without a name": ("[arms.left]", '[arms.""]', "an arm's name = '': expected a string that isn't empty"),
    "poses that are no list": ("park = [1.712, ", "park = 1.712 # [", "park"),
}


def test_the_description_of_the_pr2_fits_its_urdf() -> None:
    with BulletWorld():
        RobotDescription.parse(PR2).check(Object("pr2", "robot", "pr2.urdf").urdf)


@pytest.mark.parametrize("name", BROKEN)
def test_invalid_entries_are_rejected(name: str) -> None:
    good, bad, message = BROKEN[name]
    assert good in PR2
    with pytest.raises(AssetError, match=message) as raised:
        RobotDescription.parse(PR2.replace(good, bad), "mine.toml")
    assert raised.value.path == "mine.toml"


@pytest.mark.parametrize(
    ("good", "bad", "message"),
    [
        ('"l_gripper_tool_frame"', '"l_gripper_tol_frame"', "l_gripper_tool_frame"),
        ("open = 0.548", "open = 5.48", "outside the joint's limits"),
        (
            'joint = "torso_lift_joint"\ndefault = 0.2',
            'joint = "l_elbow_flex_joint"\ndefault = 0.2',
            "to 0.2, outside the joint",
        ),
        ('    "l_shoulder_pan_joint", "l_shoulder_lift_joint",', '    "l_shoulder_lift_joint",', "numbers|joints"),
    ],
)
def test_entries_that_do_not_fit_the_urdf_are_rejected(good: str, bad: str, message: str) -> None:
    assert good in PR2
    with BulletWorld() as world, pytest.raises(AssetError, match=message):
        Object("pr2", "robot", "pr2.urdf", description=RobotDescription.parse(PR2.replace(good, bad)))
    assert not world.objects
