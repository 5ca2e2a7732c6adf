"""Robots hold still with any damping, limits and inertia; mimic joints follow; recordings say how models were loaded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError, BadArgument
from pycram.physics.loading import NOW, Loading
from recorder.records import LoadBody, Loading as LoadingRecord, Mutation

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink

SOLID = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="{mass}"/>'
    '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
    '<collision><origin xyz="0 0 0.1"/><geometry><box size="0.05 0.05 0.2"/></geometry></collision>'
)


def joint(name: str, parent: str, child: str, inside: str, kind: str = "revolute", axis: str = "0 1 0") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.2"/><axis xyz="{axis}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def arm(folder: Path, limit: str, extra: str = "") -> Path:
    """An arm of three links, the last one on a wrist of two frames."""
    links = "".join(f'<link name="l{number}">{SOLID.format(mass=3 - number)}</link>' for number in range(3))
    frames = '<link name="wrist_x"/><link name="wrist_y"/>'
    joints = (
        joint("shoulder", "l0", "l1", limit)
        + joint("wrist_1", "l1", "wrist_x", limit)
        + joint("wrist_2", "wrist_x", "wrist_y", limit, axis="1 0 0")
        + joint("wrist_3", "wrist_y", "l2", limit, axis="0 0 1")
    )
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm">{links}{frames}{joints}{extra}</robot>')
    return file


@pytest.mark.parametrize("dynamics", ["", '<dynamics damping="2e10" friction="100"/>', '<dynamics damping="0.5"/>'])
@pytest.mark.parametrize("limit", ['lower="-2" upper="2"', 'lower="0.4" upper="2"', 'lower="-2" upper="-0.4"'])
def test_a_robot_without_contacts_holds_still(tmp_path: Path, world: BulletWorld, dynamics: str, limit: str) -> None:
    file = arm(tmp_path, f'<limit {limit} effort="0.001" velocity="0.1"/>{dynamics}')
    robot = Object("arm", "robot", file, [0, 0, 1], [0, 0.6, 0, 0.8])
    start = robot.get_joint_positions()
    bounds = [robot.joint_limits(name) for name in robot.joints]
    assert all(lower <= value <= upper for value, (lower, upper) in zip(start.values(), bounds, strict=True))
    for _ in range(8):
        world.simulate(0.25)
        assert robot.get_joint_positions() == pytest.approx(start, abs=1e-3)


def test_a_heavy_industrial_arm_holds_still(tmp_path: Path, world: BulletWorld) -> None:
    """Masses and lengths are those of an arm for 210 kg, stretched out; nothing is known of its motors."""
    masses, lengths = (138, 95, 71, 17, 7), (0.35, 1.15, 0.4, 0.8, 0.2)
    parts, parent, reach = ['<link name="base"/>'], "base", 0.0
    for number, (mass, length) in enumerate(zip(masses, lengths, strict=True)):
        moments = f'ixx="5" iyy="{mass * length**2 / 12}" izz="{mass * length**2 / 12}" ixy="0" ixz="0" iyz="0"'
        parts.append(
            f'<link name="l{number}"><inertial><origin xyz="{length / 2} 0 0"/><mass value="{mass}"/>'
            f'<inertia {moments}/></inertial></link><joint name="j{number}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{number}"/><origin xyz="{reach} 0 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3"/></joint>'
        )
        parent, reach = f"l{number}", length
    file = tmp_path / "heavy.urdf"
    file.write_text(f'<robot name="heavy">{"".join(parts)}</robot>')
    robot = Object("heavy", "robot", file, [0, 0, 2])
    start = robot.get_joint_positions()
    world.simulate(2)
    assert robot.get_joint_positions() == pytest.approx(start, abs=1e-3)


def test_recordings_contain_how_a_body_was_loaded(tmp_path: Path, world: BulletWorld, sink: MemorySink) -> None:
    Object("arm", "robot", arm(tmp_path, '<limit lower="0.4" upper="2"/>'))
    loaded = next(record.load_body for record in sink.of(Mutation) if record.HasField("load_body"))
    assert Loading.of(loaded) == NOW
    assert list(loaded.loading.ListFields())
    assert world.get_object("arm").get_joint_position("shoulder") == 0.4


def test_recordings_of_0_1_0_load_models_as_0_1_0_did() -> None:
    then = Loading.of(LoadBody())
    assert then == Loading(
        undamped=False, clamped=False, mimic=False, inertia=False, armature=0.0, gain=0.1, strength=0.0
    )
    assert then.to_record() is None
    later = LoadBody(loading=LoadingRecord(undamped=True, clamped=True, mimic=True, inertia=True, armature=0.001))
    assert Loading.of(later) == Loading(armature=0.001, gain=0.1, strength=0.0), "motors were softer then"


GRIPPER = (
    '<link name="palm"/>'
    + "".join(f'<link name="{name}"/>' for name in ("leader", "follower", "second", "guided"))
    + joint("lead", "palm", "leader", '<limit lower="0" upper="1"/>')
    + joint(
        "follow", "palm", "follower", '<limit lower="-3" upper="3"/><mimic joint="lead" multiplier="-2" offset="0.5"/>'
    )
    + joint("chained", "palm", "second", '<limit lower="-1" upper="3"/><mimic joint="follow" multiplier="0.5"/>')
    + joint("guide", "palm", "guided", '<limit lower="0" upper="0.2"/><mimic joint="lead"/>', "prismatic")
)


def hand(folder: Path, more: str = "") -> Path:
    file = folder / "hand.urdf"
    file.write_text(f'<robot name="hand">{GRIPPER}{more}</robot>')
    return file


def test_mimic_joints_move_with_the_joint_that_they_mimic(tmp_path: Path, world: BulletWorld) -> None:
    robot = Object("hand", "robot", hand(tmp_path), [0, 0, 1])
    assert robot.get_joint_positions() == {"lead": 0, "follow": 0.5, "chained": 0.25, "guide": 0}
    robot.set_joint_position("lead", 0.1)
    wanted = {"lead": 0.1, "follow": 0.3, "chained": 0.15, "guide": 0.1}
    assert robot.get_joint_positions() == pytest.approx(wanted)
    world.simulate(1)
    assert robot.get_joint_positions() == pytest.approx(wanted, abs=1e-3)
    robot.set_joint_position("chained", -0.25)  # the joint that all of them mimic moves so that this one gets there
    assert robot.get_joint_positions() == pytest.approx({"lead": 0.5, "follow": -0.5, "chained": -0.25, "guide": 0.2})
    robot.set_joint_positions({"lead": 0.2, "guide": 0.2})
    assert robot.get_joint_position("follow") == pytest.approx(0.1)


def test_positions_of_mimic_joints_must_agree(tmp_path: Path, world: BulletWorld) -> None:
    robot = Object("hand", "robot", hand(tmp_path))
    before = robot.get_joint_positions()
    with pytest.raises(
        BadArgument, match=r"follow = 1.* expected 0\.3, because follow mimics lead, which moves to 0\.1; set only lead"
    ):
        robot.set_joint_positions({"lead": 0.1, "follow": 1.0})
    with pytest.raises(BadArgument, match=r"joint lead of hand = -1\.0: expected a value from 0 to 1"):
        robot.set_joint_position("follow", 2.5)
    assert robot.get_joint_positions() == before


def test_poses_computed_from_the_file_have_mimic_joints_too(tmp_path: Path, world: BulletWorld) -> None:
    robot = Object("hand", "robot", hand(tmp_path))
    robot.set_joint_position("lead", 0.4)
    for link, (position, orientation) in robot.urdf.link_poses({"lead": 0.4}).items():
        assert robot.get_link_position(link) == pytest.approx(position, abs=1e-6)
        assert robot.get_link_orientation(link) == pytest.approx(orientation, abs=1e-6)


def test_a_joint_that_mimics_an_unknown_joint_moves_on_its_own(tmp_path: Path, world: BulletWorld) -> None:
    alone = joint("alone", "palm", "odd", '<limit lower="-1" upper="1"/><mimic joint="lede" multiplier="3"/>')
    robot = Object("hand", "robot", hand(tmp_path, f'<link name="odd"/>{alone}'))
    robot.set_joint_positions({"lead": 0.1, "alone": 0.7})
    assert robot.get_joint_position("alone") == 0.7


def test_circular_mimic_joints_are_rejected(tmp_path: Path, world: BulletWorld) -> None:
    circle = "".join(
        joint(name, "palm", name, f'<limit lower="-1" upper="1"/><mimic joint="{other}"/>')
        for name, other in (("a", "b"), ("b", "a"))
    )
    with pytest.raises(AssetError, match="joint a mimics itself"):
        Object("hand", "robot", hand(tmp_path, f'<link name="a"/><link name="b"/>{circle}'))
    assert not world.objects
