"""Robots with other parts than the PR2: any names of arms, no gripper, half a head, no camera, a fixed base.

They are PR2s whose descriptions leave something out or name it differently: the plan and the URDF are the same.
"""

from __future__ import annotations

import math
import re
from importlib import metadata
from pathlib import Path

import pytest

import pycram.models.robots
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import DesignatorError, MotionDesignator
from pycram.failures import AssetError, GraspFailed, LookingFailed, MissingPart, NotDrivable
from pycram.models.robots.description import Misfitting, RobotDescription
from pycram.process_module import NoProcessModule, ProcessModule
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.kinematics.inverse import Solver
from recorder import geometry
from tests.pycram.models import gantry
from tests.pycram.models.test_robot_descriptions import PR2

CAMERA = "wide_stereo_optical_frame"


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def without(table: str) -> str:
    """The PR2's description without a table and those within it."""
    kept = re.sub(rf"^\[{re.escape(table)}(\.\w+)*\]\n(?:(?!\[\w).*\n?)*", "", PR2, flags=re.MULTILINE)
    assert kept != PR2
    return kept


def robot(text: str) -> Object:
    made = Object("robot", "robot", "pr2.urdf", description=RobotDescription.parse(text))
    assert BulletWorld.current_bullet_world is not None
    BulletWorld.current_bullet_world.robot = made
    return made


@pytest.fixture(autouse=True)
def around(world: BulletWorld) -> None:
    Object("floor", "environment", "plane.urdf")


def test_the_only_arm_is_the_default_whatever_its_name() -> None:
    made = robot(without("arms.left").replace("[arms.right", "[arms.claw"))
    perform(type="move-arm-joints", claw_arm="park")
    assert made.get_joint_position("r_shoulder_pan_joint") == pytest.approx(-1.712)
    perform(type="move-tcp", target=[0.6, -0.2, 0.9])
    assert math.dist(made.get_link_position("r_gripper_tool_frame"), [0.6, -0.2, 0.9]) < 0.002
    perform(type="opening-gripper")
    assert made.get_joint_position("r_gripper_l_finger_joint") == pytest.approx(0.548)
    with pytest.raises(DesignatorError, match="unknown slot left-arm; did you mean claw-arm") as raised:
        perform(type="move-arm-joints", left_arm="park")
    assert "claw-arm (optional)" in raised.value.takes


def test_a_plan_names_one_of_several_arms_without_a_left_arm() -> None:
    robot(PR2.replace("[arms.left", "[arms.upper").replace("[arms.right", "[arms.lower"))
    with pytest.raises(DesignatorError, match="missing slot arm: one of upper, lower"):
        perform(type="move-tcp", target=[0.6, 0.2, 0.9])
    perform(type="move-tcp", target=[0.6, 0.2, 0.9], arm="upper")
    perform(type="move-arm-joints", upper_arm="park", lower_arm="park")


def test_the_tool_frame_may_have_an_offset_from_its_link() -> None:
    offset = (
        'tool_frame = "l_gripper_tool_frame"\ntool_offset = { xyz = [0.1, 0, 0], rpy = [0, 1.5707963267948966, 0] }'
    )
    described = PR2.replace('tool_frame = "l_gripper_tool_frame"', offset)
    made = robot(described)
    target = [0.6, 0.3, 0.9]
    perform(type="move-tcp", target=target, orientation=[0, 0, 0, 1], arm="left")
    pose = made.get_link_position_and_orientation("l_gripper_tool_frame")
    assert math.dist(geometry.transform(pose, (0.1, 0.0, 0.0)), target) < 0.002
    forward = geometry.rotate(pose[1], (0.0, 0.0, -1.0))  # the tool frame's x axis in its link
    assert forward == pytest.approx((1.0, 0.0, 0.0), abs=0.05)


def test_an_arm_without_gripper_moves_but_picks_up_nothing() -> None:
    robot(without("arms.left.gripper"))
    thing = Object("milk", "milk", "milk.stl", [0.7, 0.2, 0.1])
    perform(type="move-arm-joints", left_arm="park")
    for slots in ({"type": "pick-up", "object": thing}, {"type": "opening-gripper", "gripper": "left"}):
        with pytest.raises(MissingPart, match="left arm has no gripper") as raised:
            perform(**slots)
        assert raised.value.data["part"] == "gripper"


@pytest.mark.slow
def test_fingers_of_a_gripper_may_have_different_positions(world: BulletWorld) -> None:
    """The UR5's fingers don't mimic each other."""
    ur5 = (Path(pycram.models.robots.__file__).parent / "ur5.toml").read_text()
    uneven = ur5.replace("closed = 0.0", "closed = [0.0, 0.01]").replace("open = 0.045", "open = [0.02, 0.04]")
    world.robot = made = Object("ur5", "robot", "ur5.urdf", [0, 0, 1], description=RobotDescription.parse(uneven))
    joints = made.description.arm("ur5").gripper.joints
    perform(type="opening-gripper", gripper="ur5")
    assert [made.get_joint_position(joint) for joint in joints] == pytest.approx([0.02, 0.04])
    perform(type="closing-gripper", gripper="ur5")
    assert [made.get_joint_position(joint) for joint in joints] == pytest.approx([0.0, 0.01])
    with pytest.raises(AssetError, match="a number, or 2 numbers for gripper_left_finger_joint"):
        RobotDescription.parse(ur5.replace("open = 0.045", "open = [0.1]"))


@pytest.mark.parametrize(("kept", "moved"), [("pan", "head_pan_joint"), ("tilt", "head_tilt_joint")])
def test_a_head_with_one_joint_brings_objects_into_view(kept: str, moved: str) -> None:
    left_out = {"pan": 'tilt = "head_tilt_joint"\n', "tilt": 'pan = "head_pan_joint"\n'}[kept]
    made = robot(PR2.replace(left_out, ""))
    before = made.get_joint_positions()
    beside, above = ([1.5, 1.5, 0.9], [1.5, 0.1, 0.3])
    seen, unseen = (beside, [0.5, 0, 3]) if kept == "pan" else (above, [-1.5, 0, 1])
    perform(type="looking", target=seen)
    x, y, z = geometry.transform(geometry.invert(made.get_link_position_and_orientation(CAMERA)), seen)
    assert z > 0
    assert abs((x, y)[kept == "tilt"]) < 0.01, "as near to the middle as that joint can bring it"
    changed = {joint for joint, value in made.get_joint_positions().items() if value != before[joint]}
    assert changed == {moved}
    with pytest.raises(LookingFailed):
        perform(type="looking", target=unseen)


def test_a_fixed_camera_does_not_turn() -> None:
    made = robot(without("head"))
    before = made.get_joint_positions()
    perform(type="looking", target=[2, 0.2, 1.2])
    with pytest.raises(LookingFailed):
        perform(type="looking", target=[-1, 0, 1])
    assert made.get_joint_positions() == before


def test_a_robot_without_camera_does_not_look_or_detect() -> None:
    robot(without("camera"))
    for slots in ({"type": "looking", "target": [1, 0, 1]}, {"type": "detecting", "object_type": "milk"}):
        with pytest.raises(MissingPart, match="robot has no camera"):
            perform(**slots)


def test_a_fixed_base_does_not_drive() -> None:
    made = robot(PR2.replace('base_link = "base_footprint"', 'base_link = "base_footprint"\ndrives = false'))
    with pytest.raises(NotDrivable, match="the robot's base is fixed") as raised:
        perform(type="moving", target=[0.5, 0, 0])
    assert raised.value.position == [0.5, 0, 0]
    assert made.get_position() == [0, 0, 0]


def test_fingers_close_around_the_tool_frames_x_axis() -> None:
    urdf = Object("any", "robot", "pr2.urdf").urdf
    frame = 'tool_frame = "l_gripper_tool_frame"'
    for rpy, axis in (("[0, 0, 1.5708]", "x"), ("[1.5708, 0, 0]", "z")):
        turned = PR2.replace(frame, f"{frame}\ntool_offset = {{ rpy = {rpy} }}")
        with pytest.raises(AssetError, match=f"closes along the tool frame's {axis} axis, not along y"):
            RobotDescription.parse(turned).check(urdf)
    one_side = re.sub(r'"l_gripper_r_finger\w*",?', "", PR2)
    with pytest.raises(AssetError, match="all fingers close from the same side"):
        RobotDescription.parse(one_side).check(urdf)
    swapped = PR2.replace("closed = 0.0\nopen = 0.548", "closed = 0.0\nopen = 0.0", 1)
    with pytest.raises(AssetError, match="don't move the fingers"):
        RobotDescription.parse(swapped).check(urdf)


def test_a_plan_names_one_of_several_grippers() -> None:
    robot(PR2)
    with pytest.raises(DesignatorError, match="missing slot gripper: one of left, right"):
        perform(type="opening-gripper")


def test_a_shoulder_may_obstruct_the_other_hand() -> None:
    """Whichever of the two arms is the one that moves, and if both do."""
    made = robot(PR2)
    left, right = (made.description.arm(side) for side in ("left", "right"))
    shoulder = made.get_link_position("r_upper_arm_link")
    reached = Solver(made, left.tool_frame).search([(shoulder, None, None)])[0][0]
    assert reached.reaches()
    made.set_joint_positions(reached.positions)
    now = made.get_joint_positions()
    for joints in (left.joints, right.joints, left.joints + right.joints):
        with CollisionChecker(made, joints) as checker:
            (candidate,) = checker.predict([{name: now[name] for name in joints}])
            links = {link for pair in checker.self_collisions(candidate) for link in (pair.link, pair.body_link)}
        assert "r_upper_arm_link" in links, joints


def test_pairs_of_links_that_may_touch_do_not_collide() -> None:
    folded = [-0.31, 1.1, 2.18, -1.73, -0.03, -1.15, 0.94]

    def overlaps(text: str) -> set[frozenset[str]]:
        made = robot(text)
        arm = made.description.arm("left")
        with CollisionChecker(made, arm.joints) as checker:
            (candidate,) = checker.predict([dict(zip(arm.joints, folded, strict=True))])
            pairs = checker.self_collisions(candidate)
        made.remove()
        return {frozenset((pair.link, pair.body_link)) for pair in pairs}

    found = overlaps(PR2)
    assert found
    allowed = min(found, key=sorted)
    tolerant = PR2.replace('robot = "pr2"', f'robot = "pr2"\nmay_touch = [{sorted(allowed)}]')
    assert overlaps(tolerant) == found - {allowed}
    with pytest.raises(AssetError, match="two different links"):
        RobotDescription.parse(tolerant.replace(str(sorted(allowed)), '["torso_lift_link"]'))
    with pytest.raises(AssetError, match="torso_lyft_link"):
        robot(tolerant.replace(str(sorted(allowed)), '["torso_lyft_link", "base_link"]'))


def test_a_suction_cup_picks_up_flat_objects_from_above(world: BulletWorld, tmp_path: Path) -> None:
    world.set_gravity([0, 0, -9.8])
    made = Object("gantry", "robot", gantry.write(tmp_path), description=RobotDescription.parse(gantry.DESCRIPTION))
    world.robot = made
    box, spoon = (
        Object(kind, kind, f"{kind}.stl", at)
        for kind, at in (("breakfast_cereal", [0.4, 0.3, 0.13]), ("spoon", [-0.3, -0.3, 0.05]))
    )
    world.simulate(1.0)
    with pytest.raises(GraspFailed):
        perform(type="pick-up", object=spoon)
    perform(type="pick-up", object=box, grasp="top")
    cup = made.get_link_position("cup")
    top = box.get_AABB()[1][2]
    assert cup[2] - 0.04 == pytest.approx(top, abs=0.005), "its rim is on the carton"
    perform(type="move-arm-joints", **{"z-axis-arm": "park"})
    assert box.get_position()[2] > 1.0
    perform(type="place", object=box, target=[-0.2, 0.4, 0.13])
    perform(type="move-arm-joints", **{"z-axis-arm": "park"})
    assert math.dist(box.get_position()[:2], [-0.2, 0.4]) < 0.01
    assert btr.stable(box)


def test_another_robot_with_a_known_name_says_why_its_description_does_not_fit(
    world: BulletWorld, tmp_path: Path
) -> None:
    (tmp_path / "other.urdf").write_text('<robot name="panda"><link name="base"/></robot>')
    with pytest.warns(
        Misfitting, match=r"other has no description: .*no link 'panda_link0'.*pycram describe"
    ) as warned:
        world.robot = made = Object("other", "robot", tmp_path / "other.urdf")
    assert warned[0].filename == __file__
    assert made.description is None
    with pytest.raises(NoProcessModule, match=r"of panda doesn't match the URDF: .*no link 'panda_link0'") as raised:
        perform(type="looking", target=[1, 0, 1])
    assert "pycram describe" in raised.value.undescribed


@pytest.mark.parametrize(
    ("edit", "part", "reason"),
    [
        ((r'(name="torso_lift_joint" type=")prismatic', r"\1fixed"), "torso", "moves the fixed joint torso_lift_joint"),
        ((r"wide_stereo_optical_frame", "eye"), "camera", "no link 'wide_stereo_optical_frame'"),
        ((r"l_gripper_palm_link", "palm"), "left gripper", "no link 'l_gripper_palm_link'"),
        ((r"r_elbow_flex_joint", "r_elbow"), "right arm", "no joint 'r_elbow_flex_joint'"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_parts_that_do_not_fit_are_left_out_and_named_when_the_robot_is_loaded(
    world: BulletWorld, tmp_path: Path, edit: tuple[str, str], part: str, reason: str
) -> None:
    original = next(file for file in metadata.files("example-robot-data") or [] if file.name == "pr2.urdf")
    text = Path(str(original.locate())).read_text()
    (tmp_path / "mine.urdf").write_text(re.sub(*edit, text))
    packages = [Path(str(original.locate())).resolve().parents[3]]
    with pytest.warns(
        Misfitting, match=rf"mine has a description without .*: {part} \(.*{reason}.*\); 'pycram describe' writes"
    ) as warned:
        world.robot = made = Object("mine", "robot", tmp_path / "mine.urdf", packages=packages)
    assert warned[0].filename == __file__
    assert made.description is not None
    left = made.description
    assert (left.torso is None) == (part == "torso")
    assert (left.camera is None) == (part == "camera")
    assert ("right" not in left.arms) == (part == "right arm")
    assert (left.arms["left"].hand is None) == (part == "left gripper")
    perform(type="move-arm-joints", **{"left-arm": "park"})
    recorded = RobotDescription.parse(left.text)  # a restored robot has the same parts
    assert (recorded.arms, recorded.torso, recorded.camera) == (left.arms, left.torso, left.camera)
