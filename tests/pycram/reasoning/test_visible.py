"""What is seen, and what hides it: scenes whose truth is known."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings, strategies as st

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import BadArgument, PerceptionError
from pycram.process_module import ProcessModule
from pycram.reasoning.queries import visibility
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

EYE = [-1.0, 0.0, 1.0]
MILK = [0.0, 0.0, 1.0]
ACROSS = list(geometry.from_rpy(0, 0, math.pi / 2))  # the cereal's broad side to the eye


@pytest.fixture
def milk(world: BulletWorld) -> Object:
    """In the air, a metre before the eye."""
    return Object("milk", "milk", "milk.stl", MILK)


def camera(eye: Sequence[float], at: Sequence[float], roll: float = 0.0) -> tuple[list[float], list[float]]:
    turn = geometry.product(geometry.look_at(eye, at), geometry.from_rpy(0, 0, roll))
    return list(eye), list(turn)


def share(body: Object, view: object) -> float:
    return float(btr.visible(body, view).evidence["share"])


@pytest.mark.parametrize(
    ("view", "expected", "reason"),
    [
        (EYE, 1.0, ""),
        ([0, 0, 2.5], 1.0, ""),  # straight above: no up vector there
        ([0, 0, -1.5], 1.0, ""),
        ([0, -9, 1], 1.0, ""),
        (camera(EYE, MILK), 1.0, ""),
        (camera(EYE, MILK, math.pi), 1.0, ""),  # upside down
        (camera(EYE, [0, 0.3, 1]), 1.0, ""),  # not in the middle
        (camera(EYE, [-2, 0, 1]), 0.0, "behind"),
        (camera(EYE, [-1, 1, 1]), 0.0, "out of view"),
        (camera(EYE, [-1, 0, 5]), 0.0, "out of view"),
        (camera(EYE, [-1.0, 0.3, 1.0]), 0.0, "out of view"),
        ([0, 0, 1], 0.0, "around"),
        ([0.01, 0, 1.02], 0.0, "around"),
        ([-30, 0, 1], 0.0, "too far"),
    ],
)
def test_the_camera_decides(milk: Object, view: object, expected: float, reason: str) -> None:
    verdict = btr.visible(milk, view)
    assert verdict.evidence["share"] == pytest.approx(expected, abs=0.02)
    assert bool(verdict) is (expected > 0.8)
    assert reason in verdict.evidence.get("reason", "")
    assert btr.occluding(milk, view) == []


def test_an_object_half_out_of_the_image_is_half_seen(milk: Object) -> None:
    edge = math.radians(30)  # half of the field of view where only a pose is given
    eye = [-5.0, 0.0, 1.0]
    for offset, expected in ((0.0, 0.5), (-0.0175, 0.25), (0.0175, 0.75)):
        direction = edge - offset / 5
        at = [eye[0] + math.cos(direction), eye[1] + math.sin(direction), 1.0]
        assert share(milk, camera(eye, at)) == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("step", [4, *(pytest.param(step, marks=pytest.mark.slow) for step in range(10) if step != 4)])
def test_shares_agree_with_an_image_of_fifty_times_the_pixels(
    milk: Object, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    """Milk behind cereal, from hardly to wholly hidden."""
    cereal = Object("cereal", "cereal", "breakfast_cereal.stl", [-0.4, 0.095 - 0.004 * step, 1.0], ACROSS)
    fast = share(milk, EYE)
    monkeypatch.setattr(visibility, "_PIXELS", 50 * visibility._PIXELS)
    true = share(milk, EYE)
    assert fast == pytest.approx(true, abs=0.02)
    assert 0.0 < true < 1.0
    assert (btr.occluding(milk, EYE) == [cereal]) is (true < 1.0)


def test_the_object_that_hides_most_comes_first_and_objects_behind_hide_nothing(milk: Object) -> None:
    little = Object("little", "spoon", "spoon.stl", [-0.3, 0, 1.07])
    much = Object("much", "cereal", "breakfast_cereal.stl", [-0.5, 0, 0.93], ACROSS)
    Object("behind", "cereal", "breakfast_cereal.stl", [0.3, 0, 1], ACROSS)
    Object("beside", "cereal", "breakfast_cereal.stl", [-0.3, 0.4, 1], ACROSS)
    Object("back", "cereal", "breakfast_cereal.stl", [-1.5, 0, 1], ACROSS)
    found = btr.occluding(milk, EYE)
    assert found == [much, little]
    shares = found.evidence["hidden_by"]
    assert shares["much"] > shares["little"] > 0
    assert sum(shares.values()) + found.evidence["share"] == pytest.approx(1.0)


def test_a_bowl_hides_its_contents_only_from_the_side(world: BulletWorld) -> None:
    bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 1])
    apple = Object("apple", "apple", "apple.stl", [0, 0, 0.99])
    assert share(apple, [-0.8, 0, 1.0]) < 0.2
    assert btr.occluding(apple, [-0.8, 0, 1.0]) == [bowl]
    assert share(apple, [0, 0, 1.8]) > 0.9


def test_a_closed_drawer_hides_its_contents(scene: BulletWorld) -> None:
    kitchen, spoon = scene.get_object("kitchen"), scene.get_object("spoon")
    scene.robot.set_position([0, -1, 0])
    eye = [0.9, 0.89, 1.6]
    assert not btr.visible(spoon, eye)
    assert btr.occluding(spoon, eye) == [kitchen]
    kitchen.set_joint_position("sink_area_left_upper_drawer_main_joint", 0.4)
    assert btr.visible(spoon, eye)


def test_a_robots_camera_sees_in_the_direction_of_the_head(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    frame = "wide_stereo_optical_frame"
    assert not btr.visible(milk, frame)
    robot.set_joint_positions({"head_tilt_joint": 0.5, "head_pan_joint": 0.4})
    assert btr.visible(milk, frame)
    assert btr.visible(milk, frame, robot=robot).evidence == btr.visible(milk, frame).evidence
    robot.set_joint_position("head_pan_joint", -2.0)
    assert not btr.visible(milk, frame)


def test_small_and_far_objects_are_seen_as_well(world: BulletWorld) -> None:
    spoon = Object("spoon", "spoon", "spoon.stl", [0, 0, 1])
    assert btr.visible(spoon, [-19, 0, 1.0])
    assert btr.visible(spoon, [0, 0, 1.3])
    assert not btr.visible(spoon, [0, 0, 1.05]), "most of it is out of the image"


def test_objects_before_the_near_plane_are_not_seen(world: BulletWorld) -> None:
    knife = Object("knife", "knife", "knife.stl", [0, 0, 1])
    verdict = btr.visible(knife, camera([0, 0, 0.985], [0, 0, 2]))
    assert not verdict
    assert verdict.evidence["share"] == 0.0
    assert "near" in verdict.evidence["reason"]


@pytest.fixture(scope="module")
def milk_and_plate() -> Iterator[tuple[Object, Object]]:
    with BulletWorld() as world:
        milk = Object("milk", "milk", "milk.stl", MILK)
        wall = Object("wall", "environment", "plate.stl", [5, 0, 0])
        yield milk, wall
        assert world.robot is None


@pytest.mark.costly
@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-0.95, -0.06), min_size=2, max_size=4, unique=True).map(sorted),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
)
def test_shares_are_from_0_to_1_and_fall_as_the_occluder_grows(
    milk_and_plate: tuple[Object, Object], distances: list[float], y: float, z: float
) -> None:
    """A plate grows in the picture as it comes nearer to the eye along the same line of sight."""
    milk, wall = milk_and_plate
    shares = []
    for x in sorted(distances, reverse=True):  # ever nearer to the eye
        scale = (x - EYE[0]) / (MILK[0] - EYE[0])
        wall.set_position_and_orientation([x, y * scale, 1 + z * scale], geometry.from_rpy(0, math.pi / 2, 0))
        verdict = btr.visible(milk, EYE)
        assert 0.0 <= verdict.evidence["share"] <= 1.0
        shares.append(verdict.evidence["share"])
    assert all(near <= far + 0.03 for far, near in itertools.pairwise(shares)), shares


@pytest.mark.parametrize("link", ["wide_stereo_optical_frame", "narrow_stereo_optical_frame", "high_def_optical_frame"])
def test_a_camera_sees_out_of_its_housing_even_with_corners_in_its_plane(world: BulletWorld, link: str) -> None:
    """From here, corners of the head's own mesh lie in the very plane of the camera."""
    Object("floor", "environment", "plane.urdf")
    world.robot = Object("pr2", "robot", "pr2.urdf")
    milk = Object("milk", "milk", "milk.stl", [1.5, 0.1, 1.0])
    ProcessModule.perform(MotionDesignator({"type": "looking", "object": milk}))
    assert btr.visible(milk, link)
    assert btr.visible(milk, world.robot.get_link_position(link))
    assert btr.occluding(milk, link) == []
    ProcessModule.perform(MotionDesignator({"type": "detecting", "object-type": "milk"}))


def test_corners_in_the_plane_of_the_camera_change_nothing(world: BulletWorld) -> None:
    Object("kitchen", "environment", "kitchen.urdf")
    cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
    for wall in (-0.5, 0.0, 0.5):  # faces of boxes that lie in the plane through the eye
        Object(f"box {wall}", "environment", "milk.stl", [wall, 2.0, 1.0])
    for eye in ([-1.0, 0.0, 1.0], [0.0, -1.0, 1.0], [0.0, 0.0, 2.0]):
        assert btr.visible(cup, eye).evidence["share"] == 1.0


def test_a_camera_of_another_worlds_robot_sees_nothing_here(world: BulletWorld) -> None:
    milk = Object("milk", "milk", "milk.stl", [1.5, 0, 1])
    with BulletWorld():
        robot = Object("pr2", "robot", "pr2.urdf")
        for query in (btr.visible, btr.occluding):
            with pytest.raises(BadArgument, match="pr2 is in"):
                query(milk, "wide_stereo_optical_frame", robot=robot)
            with pytest.raises(BadArgument, match="robot"):
                query(milk, "wide_stereo_optical_frame", robot=milk)


def test_objects_without_a_shape_are_never_seen_and_hide_nothing(world: BulletWorld, tmp_path: Path) -> None:
    file = tmp_path / "frame.urdf"
    file.write_text('<robot name="frame"><link name="nothing"/></robot>')
    frame = Object("frame", "frame", file)
    cup = Object("cup", "cup", "cup.stl", [1, 0, 1])
    assert btr.visible(cup, [0, 0, 1])
    assert not btr.visible(frame, [1, 0, 0])


def test_the_share_outside_of_the_picture_and_the_hiding_link_of_a_robot_are_evidence(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    eye = camera([-5.0, 0.0, 1.0], [-5.0 + math.cos(math.radians(30)), math.sin(math.radians(30)), 1.0])
    milk.set_position([0, 0, 1])
    evidence = btr.visible(milk, eye).evidence
    assert evidence["outside"] == pytest.approx(0.5, abs=0.06)
    assert evidence["outside"] + evidence["share"] == pytest.approx(1.0)
    hand = robot.get_link_position("r_gripper_palm_link")
    milk.set_position([hand[0], hand[1] + 0.25, hand[2]])
    evidence = btr.visible(milk, [hand[0], hand[1] - 1.0, hand[2]]).evidence
    assert "r_" in evidence["hiding_links"]["pr2"], "its right hand or arm"
    assert "outside" not in evidence
    frame = robot.get_link_position_and_orientation("wide_stereo_optical_frame")
    eye_of_robot, depth = robot.description.camera, 0.8
    edge = depth * math.tan(eye_of_robot.horizontal_fov / 2)
    milk.set_position(geometry.transform(frame, (-edge - 0.02, 0.0, depth)))
    with pytest.raises(PerceptionError, match=r"milk is only \d+% visible.*; \d+% of it is outside of the picture"):
        ProcessModule.perform(MotionDesignator(type="detecting", object_type="milk"))
