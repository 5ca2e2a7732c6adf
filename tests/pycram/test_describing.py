"""``pycram describe`` writes descriptions with which robots work; its checks find wrong values."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from contextlib import chdir
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from PIL import Image

from pycram import bullet_world_reasoning as btr, cli
from pycram.bullet_world import BulletWorld, Object
from pycram.describing.guess import guess
from pycram.designator import MotionDesignator
from pycram.models import load
from pycram.models.files import mount_gripper
from pycram.models.robots.description import RobotDescription
from pycram.process_module import ProcessModule
from recorder import geometry
from tests.pycram.models import gantry, hands

if TYPE_CHECKING:
    from collections.abc import Callable

REPO = Path(__file__).parents[2]
ROBOTS = REPO / "pycram" / "models" / "robots"


class Ended(NamedTuple):
    """What a command has left."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def describe(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Runs ``pycram describe`` in ``tmp_path``, within this process: to start one takes longer than most descriptions."""

    def run(*arguments: str) -> Ended:
        capfd.readouterr()
        with chdir(tmp_path):
            try:
                code = cli.main(["describe", *arguments])
            except SystemExit as end:
                code = end.code
        return Ended(code, *capfd.readouterr())

    return run


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def urdf_of(name: str) -> str:
    files = metadata.files("example-robot-data") or []
    return next(str(Path(str(file.locate())).resolve()) for file in files if file.as_posix().endswith(name))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["pr2", "tiago_pro", "panda", "ur5"])
def test_guesses_of_bundled_robots_agree_with_their_descriptions(
    describe: Callable[..., Ended], tmp_path: Path, robot: str
) -> None:
    ended = describe(f"{robot}.urdf")
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    guessed = RobotDescription.parse(ended.stdout)
    known = RobotDescription.load(ROBOTS / f"{robot}.toml")
    assert guessed.drives == known.drives
    assert guessed.head == known.head
    assert (guessed.torso and guessed.torso.joint) == (known.torso and known.torso.joint)
    assert (guessed.camera and guessed.camera.frame) == (known.camera and known.camera.frame)
    assert {arm.joints for arm in guessed.arms.values()} == {arm.joints for arm in known.arms.values()}
    for arm in known.arms.values():
        (same,) = (other for other in guessed.arms.values() if other.joints == arm.joints)
        assert "park" in same.poses
        assert set(same.gripper.joints) == set(arm.gripper.joints)
        assert same.gripper.aperture == pytest.approx(arm.gripper.aperture, abs=0.003)
        for share in (0.0, 1.0):
            assert same.gripper.at(share) == pytest.approx(arm.gripper.at(share), abs=1e-3)
    (tmp_path / "mine.toml").write_text(ended.stdout)
    checked = describe("--check", "mine.toml", f"{robot}.urdf")
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.slow
def test_the_command_prints_only_the_description(describe: Callable[..., Ended], tmp_path: Path) -> None:
    """In a process of its own: nothing that is imported warns, nothing else comes to stdout."""
    ended = subprocess.run(
        [sys.executable, "-m", "pycram", "describe", "panda.urdf"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env={"PYTHONPATH": str(REPO), "PATH": "/usr/bin:/bin", "PYTHONWARNINGS": "error"},
    )
    assert Ended(ended.returncode, ended.stdout, ended.stderr) == describe("panda.urdf")


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["pr2", pytest.param("tiago_pro", marks=pytest.mark.costly), "panda", "ur5"])
def test_bundled_robots_pass_all_checks(describe: Callable[..., Ended], tmp_path: Path, robot: str) -> None:
    ended = describe("--check", str(ROBOTS / f"{robot}.toml"), "--picture", "robot.png")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    lines = ended.stdout.splitlines()
    assert all(line.startswith("ok") for line in lines)
    assert {"reach", "gripper", "park", "stillness"} <= set(re.findall(r"reach|gripper|park|stillness", ended.stdout))
    picture = Image.open(tmp_path / "robot.png")
    colors = picture.convert("RGB").getcolors(1 << 20)
    assert picture.size == (800, 600)
    assert len(colors) > 200, "more than a sky"


@pytest.mark.slow
def test_a_robot_with_a_guessed_description_picks_up_objects(
    describe: Callable[..., Ended], tmp_path: Path, world: BulletWorld
) -> None:
    """Baxter's right arm takes a block with the description that was guessed; its fingers open from 20 to 58 mm."""
    world.set_gravity([0, 0, -9.8])
    file = urdf_of("robots/baxter_description/urdf/baxter.urdf")
    ended = describe(file)
    assert ended.returncode == 0, ended.stderr
    described = RobotDescription.parse(ended.stdout)
    assert set(described.arms) == {"left", "right"}
    Object("floor", "environment", "plane.urdf")
    world.robot = robot = Object("baxter", "robot", file, [0, 0, 0.93], description=described)
    Object("table", "environment", "table.urdf", [0.75, 0, 0])
    (tmp_path / "block.urdf").write_text(BLOCK)
    block = Object("block", "block", tmp_path / "block.urdf", [0.75, -0.3, 0.78])
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    world.simulate(0.5)
    perform(type="pick-up", object=block, arm="right")
    perform(type="place", object=block, target=[0.75, -0.15, 0.78], arm="right")
    perform(type="move-arm-joints", right_arm="park")
    assert math.dist(block.get_position()[:2], [0.75, -0.15]) < 0.02
    assert btr.stable(block)
    assert not robot.carried


BLOCK = """<robot name="block"><link name="block"><collision><geometry><box size="0.04 0.04 0.1"/></geometry></collision>
</link></robot>"""
WRONG = {
    "aperture": (
        "aperture = 0.078",
        "aperture = 0.06",
        "panda gripper: aperture is described as 60.0 mm, measured 80.0 mm",
    ),
    "tool frame": (
        "tool_offset = { rpy",
        "tool_offset = { xyz = [0, 0.01, 0], rpy",
        "panda gripper: the middle between the fingers is 10.0 mm from the tool frame",
    ),
    "a tool frame that points aside, though fingers are as thick as long": (
        "tool_offset = { rpy = [0, -1.5707963267948966, 0] }",
        "tool_offset = { rpy = [0, 0, 0] }",
        "panda gripper: underside is described as 35.0 mm, measured 129.3 mm",
    ),
    "depth": (
        "depth = 0.025",
        "depth = 0.06",
        "panda gripper: depth is described as 60.0 mm, measured 37.4 mm",
    ),
    "tips": ("tips = 0.0095", "tips = 0.03", "panda gripper: tips is described as 30.0 mm, measured 9.5 mm"),
    "park": (
        "park = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]",
        "park = [0.0, 1.7, 0.0, -3.0, 0.0, 0.5, 0.785]",
        "panda arm, park: panda_",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_checks_find_wrong_values(describe: Callable[..., Ended], tmp_path: Path, what: str) -> None:
    good, bad, message = WRONG[what]
    text = (ROBOTS / "panda.toml").read_text()
    assert good in text
    (tmp_path / "mine.toml").write_text(text.replace(good, bad))
    ended = describe("--check", "mine.toml")
    assert ended.returncode == 1
    assert any(line.startswith("FAILED") and message in line for line in ended.stdout.splitlines()), ended.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give a URDF, or --check"),
        (("nothing.urdf",), "nothing.urdf: no such file"),
        (("--check", "nothing.toml"), "nothing.toml"),
        (("--check", "other.toml"), "describes other, which isn't bundled"),
        (("panda.urdf", "--check", "other.toml"), "other.toml: "),
    ],
)
def test_wrong_usage_is_reported_in_one_line(
    describe: Callable[..., Ended], tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    text = (ROBOTS / "ur5.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace('robot = "ur5_with_gripper"', 'robot = "other"'))
    ended = describe(*arguments)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert message in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


ONE_ARM = """<robot name="my robot 2.0"><link name="base"/>{links}<link name="hand"/>
{joints}<joint name="end" type="fixed"><parent link="link 3"/><child link="hand"/></joint></robot>"""


@pytest.mark.slow
def test_robot_names_that_are_not_plain_toml_keys(describe: Callable[..., Ended], tmp_path: Path) -> None:
    shape = '<origin xyz="0 0 0.1"/><geometry><box size="0.04 0.04 0.16"/></geometry>'
    red = '<material name="red"><color rgba="1 0 0 1"/></material>'
    box = f"<visual>{shape}{red}</visual><collision>{shape}</collision>"
    links = "".join(f'<link name="link {i}">{box}</link>' for i in range(4))
    joints = "".join(
        f'<joint name="turn &quot;{i}&quot;" type="revolute"><origin xyz="0 0 0.2"/><axis xyz="0 {i % 2} {1 - i % 2}"/>'
        f'<parent link="{f"link {i - 1}" if i else "base"}"/><child link="link {i}"/>'
        '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
        for i in range(4)
    )
    (tmp_path / "mine.urdf").write_text(ONE_ARM.format(links=links, joints=joints))
    ended = describe("mine.urdf")
    assert ended.returncode == 0, ended.stderr
    guessed = RobotDescription.parse(ended.stdout)
    assert guessed.robot == "my robot 2.0"
    assert list(guessed.arms) == ["my-robot-2-0"]  # as a plan can write it: my_robot_2_0_arm="park"
    assert guessed.arm("my-robot-2-0").joints[0] == 'turn "0"'
    (tmp_path / "mine.toml").write_text(ended.stdout)
    checked = describe("--check", "mine.toml", "mine.urdf", "--picture", "mine.png")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    picture = np.asarray(Image.open(tmp_path / "mine.png")).astype(int)
    rows, columns = np.nonzero((picture[..., 0] > 60) & (picture[..., 2] < 20))
    assert 0 < rows.min() < 100, "all of a tall robot is in the picture, and fills it"
    assert 400 < rows.max() < 599
    assert 0 < columns.min() < columns.max() < 799


@pytest.mark.costly
@pytest.mark.slow
def test_unrecognised_hands_are_left_out(describe: Callable[..., Ended], tmp_path: Path) -> None:
    urdf = urdf_of("alex_sake_hands.urdf")
    ended = describe(urdf)
    assert ended.returncode == 0, ended.stderr
    assert {name: arm.hand for name, arm in RobotDescription.parse(ended.stdout).arms.items()} == {
        "left": None,
        "right": None,
    }
    assert (
        "# no gripper: by their collision shapes, LeftSakeBaseFingerLink1, LeftSakeBaseFingerLink2 don't close on one "
        "another from two sides\n" in ended.stdout
    ), "the file turns them otherwise than what is seen"
    (tmp_path / "mine.toml").write_text(ended.stdout)
    checked = describe("--check", "mine.toml", urdf)
    assert checked.returncode == 1
    failed = [line for line in checked.stdout.splitlines() if not line.startswith("ok")]
    assert len(failed) == 2, "parked arms don't meet, but both hands are missing"
    assert all("SakeBaseFingerLink1" in line and "the description has no gripper" in line for line in failed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "joints", "why"),
    [
        ("so100.urdf", 5, "jaw has no collision shapes that could hold objects"),
        pytest.param(  # LeftGripperYaw turns all of the hand
            *("alex_nub_hands.urdf", 7, "no movable joint follows the arm's last link"), marks=pytest.mark.costly
        ),
    ],
)
def test_an_arm_without_a_recognised_gripper_says_why(robot: str, joints: int, why: str) -> None:
    arms = guess(load.load(urdf_of(robot))).arms
    assert {(len(arm.joints), hand) for arm, hand in arms} == {(joints, why)}


@pytest.mark.costly
def test_a_hand_with_one_turning_jaw_is_described(describe: Callable[..., Ended], tmp_path: Path) -> None:
    """SO-101: its jaw turns towards one that is part of the hand, by up to 110 degrees."""
    urdf = urdf_of("so101.urdf")
    ended = describe(urdf)
    assert ended.returncode == 0, ended.stderr
    (arm,) = RobotDescription.parse(ended.stdout).arms.values()
    assert arm.gripper.fingers == ("moving_jaw_so101_v1_link", "gripper_link")
    assert arm.gripper.joints == ("gripper",)
    assert 0.02 < arm.gripper.aperture < 0.06
    (tmp_path / "mine.toml").write_text(ended.stdout)
    checked = describe("--check", "mine.toml", urdf)
    failed = [line for line in checked.stdout.splitlines() if not line.startswith("ok")]
    assert len(failed) == 1, "five joints and an arm of 0.4 m take nothing from a table"
    assert "picked up from a table: cup 0 of 5, bottle 0 of 5, spoon 0 of 5; " in failed[0]


@pytest.mark.costly
def test_heads_are_not_arms_and_curling_fingers_are_not_grippers(describe: Callable[..., Ended]) -> None:
    """Romeo: four joints turn its head; its fingers have three joints each."""
    ended = describe(urdf_of("romeo.urdf"))
    assert ended.returncode == 0, ended.stderr
    arms = RobotDescription.parse(ended.stdout).arms
    assert {name: arm.joints[0] for name, arm in arms.items()} == {"left": "LShoulderPitch", "right": "RShoulderPitch"}
    assert all(arm.hand is None for arm in arms.values())


def test_the_description_of_a_robot_without_arms_says_so(describe: Callable[..., Ended], tmp_path: Path) -> None:
    links = ("base", "first", "second")
    joints = "".join(
        f'<joint name="{child}" type="continuous"><parent link="{parent}"/><child link="{child}"/></joint>'
        for parent, child in pairwise(links)
    )
    named = "".join(f'<link name="{link}"/>' for link in links)
    (tmp_path / "mine.urdf").write_text(f'<robot name="mine">{named}{joints}</robot>')
    ended = describe("mine.urdf")
    assert not RobotDescription.parse(ended.stdout).arms
    assert "# no arms: no chain of 4 joints" in ended.stdout


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_floating_base_is_not_an_arm(describe: Callable[..., Ended], tmp_path: Path, kind: str) -> None:
    links = "".join(f'<link name="link {i}"/>' for i in range(4))
    joints = "".join(
        f'<joint name="turn {i}" type="revolute"><origin xyz="0 0 0.2"/><axis xyz="0 {i % 2} {1 - i % 2}"/>'
        f'<parent link="{f"link {i - 1}" if i else "base"}"/><child link="link {i}"/>'
        '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
        for i in range(4)
    )
    free = f'<joint name="free" type="{kind}"><parent link="world"/><child link="base"/><axis xyz="0 0 1"/></joint>'
    text = ONE_ARM.format(links=links, joints=joints).replace(">", f'><link name="world"/>{free}', 1)
    (tmp_path / "mine.urdf").write_text(text)
    ended = describe("mine.urdf")
    assert ended.returncode == 0, ended.stderr
    described = RobotDescription.parse(ended.stdout)
    assert [arm.joints for arm in described.arms.values()] == [("turn 0", "turn 1", "turn 2", "turn 3")]
    assert described.drives


SHAPELESS = (
    "<link name='{name}'/><joint name='{name}_joint' type='{kind}'><parent link='{parent}'/><child link='{name}'/>"
    "<axis xyz='0 1 0'/><limit lower='0' upper='0.1' effort='1' velocity='1'/></joint>"
)
MOTOR = SHAPELESS.format(name="slider", kind="prismatic", parent="cup") + SHAPELESS.format(
    name="screw", kind="continuous", parent="slider"
)
MOTORS = {  # as in the PR2 of the thesis: links without shapes, and the parent of a finger
    "beside the fingers": (MOTOR, "cup"),
    "above a finger": (MOTOR, "screw"),
    "below a finger": (SHAPELESS.format(name="tip_frame", kind="prismatic", parent="b_finger"), "cup"),
}


@pytest.mark.parametrize("where", MOTORS)
def test_grippers_are_found_whose_motors_have_no_shapes(where: str, tmp_path: Path) -> None:
    file, _ = hands.write(tmp_path, {"a_finger": (0.0, True), "b_finger": (180.0, True)})
    motor, parent = MOTORS[where]
    ends = "<parent link='{}'/><child link='a_finger'/>"
    text = file.read_text().replace(ends.format("cup"), ends.format(parent))
    file.write_text(text.replace("</robot>", f"{motor}</robot>"))
    ((_, hand),) = guess(load.load(file)).arms
    assert not isinstance(hand, str), hand
    assert (hand.palm, set(hand.fingers)) == ("cup", {"a_finger", "b_finger"})
    assert set(hand.joints) == {"a_finger_joint", "b_finger_joint"}
    assert hand.aperture == pytest.approx(0.163, abs=0.003)


@pytest.mark.parametrize("also", ["", "head"])
def test_a_lift_belongs_to_the_arm_that_alone_it_moves(also: str, tmp_path: Path) -> None:
    """The lift of a Stretch, and the torso of a TIAGo, which also moves a head."""
    links = ("base", "lift", "a", "b", "c", "d")
    joints = "".join(
        f"<joint name='{child}' type='{'prismatic' if child == 'lift' else 'revolute'}'><parent link='{parent}'/>"
        f"<child link='{child}'/><axis xyz='{'0 0 1' if child in 'lift b' else '0 1 0'}'/>"
        "<limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
        for parent, child in [*pairwise(links), *([("lift", also)] if also else [])]
    )
    named = "".join(f"<link name='{link}'/>" for link in (*links, *([also] if also else [])))
    (tmp_path / "mine.urdf").write_text(f"<robot name='mine'>{named}{joints}</robot>")
    found = guess(load.load(tmp_path / "mine.urdf"))
    ((arm, _),) = found.arms
    torso = found.torso and found.torso.name
    assert ([joint.name for joint in arm.joints], torso) == (
        (["a", "b", "c", "d"], "lift") if also else (["lift", "a", "b", "c", "d"], None)
    )


def test_an_arm_without_a_gripper_gets_a_suction_cup_that_passes_the_checks(
    describe: Callable[..., Ended], tmp_path: Path
) -> None:
    file = gantry.write(tmp_path)
    ended = describe(str(file), "--gripper", "suction")
    assert ended.returncode == 0, ended.stderr
    (arm,) = RobotDescription.parse(ended.stdout).arms.values()
    (known,) = RobotDescription.parse(gantry.DESCRIPTION).arms.values()
    assert (arm.joints, arm.gripper.palm, arm.gripper.suction) == (known.joints, "cup", known.gripper.suction)
    x, y, z = known.tool_offset[0]
    assert arm.tool_offset[0] == pytest.approx((x, y, z - 0.003), abs=1e-4), "just beyond the last link"
    out = geometry.rotate(arm.tool_offset[1], (1.0, 0.0, 0.0))
    assert out == pytest.approx((0.0, 0.0, -1.0), abs=1e-6)
    (tmp_path / "mine.toml").write_text(ended.stdout)
    checked = describe("--check", "mine.toml", str(file))
    assert checked.returncode == 0, checked.stdout
    assert "gantry arm, picked up from a table: cup 5 of 5, bottle 0 of 5, spoon 0 of 5\n" in checked.stdout


def test_an_arm_that_takes_nothing_from_a_table_fails_the_check(describe: Callable[..., Ended], tmp_path: Path) -> None:
    """A suction cup that is described as pointing up."""
    file = gantry.write(tmp_path)
    upwards = gantry.DESCRIPTION.replace("rpy = [0, 1.57", "rpy = [0, -1.57")
    assert upwards != gantry.DESCRIPTION
    (tmp_path / "mine.toml").write_text(upwards)
    checked = describe("--check", "mine.toml", str(file))
    assert checked.returncode == 1
    assert (
        "FAILED  z-axis arm, picked up from a table: cup 0 of 0, bottle 0 of 0, spoon 0 of 0; "
        "no posture of the arm brings the tool over a table" in checked.stdout
    )


def test_an_arm_without_a_gripper_gets_two_fingers_in_a_urdf_of_its_own(
    describe: Callable[..., Ended], tmp_path: Path
) -> None:
    file = gantry.write(tmp_path)
    ended = describe(str(file), "--gripper", "two-finger")
    assert ended.stderr == "the robot with grippers is in gantry_with_gripper.urdf; load this file\n"
    (arm,) = RobotDescription.parse(ended.stdout).arms.values()
    assert arm.gripper.fingers == ("gripper_left_finger", "gripper_right_finger")
    (tmp_path / "mine.toml").write_text(ended.stdout)
    checked = describe("--check", "mine.toml", "gantry_with_gripper.urdf")
    assert checked.returncode == 0, checked.stdout
    (taken,) = re.findall(r"picked up from a table: cup (\d) of 5, bottle (\d) of 5, spoon (\d) of 5", checked.stdout)
    assert all(int(count) >= 3 for count in taken)
    again = describe(str(file), "--gripper", "two-finger")
    assert (again.returncode, again.stdout) == (2, ""), "the file exists"
    both = describe("gantry_with_gripper.urdf", "--gripper", "two-finger")
    assert "all arms have a gripper" in both.stderr


def test_grippers_of_two_arms_have_names_of_their_own() -> None:
    robot = ET.fromstring("<robot name='r'><link name='a'/></robot>")
    for side in ("left_", "right_"):
        mount_gripper(robot, "a", "0 0 0", "0 0 0", side)
    names = [(part.tag, part.get("name")) for part in robot]
    assert len(set(names)) == len(names)
    assert {("link", "left_gripper_palm"), ("joint", "right_gripper_mount")} <= set(names)


def test_fingers_that_can_not_move_are_named_and_a_check_misses_the_gripper(
    describe: Callable[..., Ended], tmp_path: Path
) -> None:
    file, described = hands.write(tmp_path, {"a_finger": (0.0, True), "b_finger": (180.0, True)})
    complete = file.read_text()
    file.write_text(complete.replace(f"upper='{hands.OPEN}'", "upper='0'"))
    stuck = "the limits in the URDF don't let the fingers move (a_finger_joint from 0 to 0, b_finger_joint from 0 to 0)"
    ended = describe(str(file))
    assert f"# no gripper: {stuck}\n" in ended.stdout
    without, _, _ = described.partition("[arms.z-axis.gripper]")
    (tmp_path / "mine.toml").write_text(without)
    for text, reason in ((file.read_text(), stuck), (complete, "pycram describe finds a gripper")):
        file.write_text(text)
        checked = describe("--check", "mine.toml", str(file))
        assert checked.returncode == 1
        (failed,) = (line for line in checked.stdout.splitlines() if line.startswith("FAILED"))
        assert "links a_finger, b_finger are named like a gripper" in failed
        assert reason in failed
    arms, _, _ = without.partition("[arms.z-axis]")
    (tmp_path / "mine.toml").write_text(arms)
    checked = describe("--check", "mine.toml", str(file))
    assert "FAILED  grippers: links a_finger, b_finger are named like a gripper, but no arm ends there" in (
        checked.stdout
    )
