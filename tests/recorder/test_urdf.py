"""Forward kinematics from the URDF equal the physics engine's, for the PR2 and the kitchen; laws of poses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings, strategies as st

from pycram.bullet_world import BulletWorld, Object
from recorder import geometry
from recorder.urdf import Urdf, UrdfError

if TYPE_CHECKING:
    from collections.abc import Iterator

angles = st.floats(-math.pi, math.pi)
numbers = st.floats(-10, 10)
vectors = st.tuples(numbers, numbers, numbers)
rotations = st.builds(geometry.from_rpy, angles, angles, angles)
poses = st.tuples(vectors, rotations)


@pytest.fixture(scope="module")
def bodies() -> Iterator[dict[str, Object]]:
    with BulletWorld():
        yield {
            "pr2": Object("pr2", "robot", "pr2.urdf", [0.3, -0.2, 0], [0, 0, 0.6, 0.8]),
            "kitchen": Object("kitchen", "environment", "kitchen.urdf"),
        }


@pytest.mark.parametrize("name", ["pr2", "kitchen"])
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_forward_kinematics_equal_the_engine_s(bodies: dict[str, Object], name: str, data: st.DataObject) -> None:
    body = bodies[name]
    values = {}
    for joint in set(body.joints) - set(body.urdf.mimics):
        lower, upper = body.joint_limits(joint)
        values[joint] = data.draw(st.floats(max(lower, -math.pi), min(upper, math.pi)))
    body.set_joint_positions(values)
    base = body.get_position_and_orientation()
    for link in body.links:
        position, orientation = geometry.multiply(base, body.urdf.forward_kinematics(values, link))
        engine_position, engine_orientation = body.get_link_position_and_orientation(link)
        assert math.dist(position, engine_position) < 1e-6, link
        assert geometry.angle(orientation, engine_orientation) < 1e-5, link


@given(poses, poses, vectors)
def test_poses_are_a_group_acting_on_points(a: geometry.Pose, b: geometry.Pose, point: geometry.Vector) -> None:
    assert geometry.transform(geometry.multiply(a, b), point) == pytest.approx(
        geometry.transform(a, geometry.transform(b, point)), abs=1e-9
    )
    position, orientation = geometry.multiply(a, geometry.invert(a))
    assert math.dist(position, (0, 0, 0)) < 1e-9
    assert geometry.angle(orientation, (0, 0, 0, 1)) < 1e-6


@given(rotations)
def test_rotations_survive_conversion_to_matrices(rotation: geometry.Quaternion) -> None:
    again = geometry.from_matrix(geometry.to_matrix(rotation))
    assert geometry.angle(again, rotation) < 1e-6
    assert again[3] >= 0


@given(angles, st.one_of(angles, st.sampled_from([-math.pi / 2, math.pi / 2])), angles)
def test_rotations_survive_conversion_to_roll_pitch_and_yaw(roll: float, pitch: float, yaw: float) -> None:
    rotation = geometry.from_rpy(roll, pitch, yaw)
    assert geometry.angle(geometry.from_rpy(*geometry.to_rpy(rotation)), rotation) < 1e-7


@given(vectors, vectors)
def test_look_at_puts_the_point_on_the_optical_axis(eye: geometry.Vector, target: geometry.Vector) -> None:
    distance = math.dist(eye, target)
    if distance < 1e-3:
        return
    seen = geometry.transform(geometry.invert((eye, geometry.look_at(eye, target))), target)
    assert seen == pytest.approx((0, 0, distance), abs=1e-6)


def robot(*elements: str, name: str = "r") -> str:
    return f'<robot name="{name}">{"".join(elements)}</robot>'


A, B = '<link name="a"/>', '<link name="b"/>'
ENDS = '<parent link="a"/><child link="b"/>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not well-formed"),
        ("<model/>", "not <robot>"),
        (robot(), "no links"),
        (robot(A, A), "two links named a"),
        (robot(A, B), "2 root links"),
        (robot(A, B, f'<joint name="j" type="ball">{ENDS}</joint>'), "'ball'"),
        (robot(A, B, '<joint name="j" type="fixed"><parent link="a"/></joint>'), "no child link"),
        (robot(A, B, f'<joint name="j" type="revolute">{ENDS}</joint>'), "no limits"),
        (robot(A, B, f'<joint name="j" type="revolute">{ENDS}<limit lower="1" upper="0"/></joint>'), "above"),
        (robot(A, B, f'<joint name="j" type="continuous">{ENDS}<axis xyz="0 0 0"/></joint>'), "zero"),
        (robot(A, B, f'<joint name="j" type="fixed">{ENDS}<origin xyz="1 2"/></joint>'), "three numbers"),
        (robot(A, B, f'<joint name="j" type="fixed">{ENDS}<origin xyz="1 2 nan"/></joint>'), "not a number"),
        (robot(A, '<joint name="j" type="fixed"><parent link="a"/><child link="x"/></joint>'), "isn't a link"),
    ],
)
def test_invalid_documents_are_refused_with_the_reason(text: str, message: str) -> None:
    with pytest.raises(UrdfError, match=message):
        Urdf.parse(text)


def test_a_cycle_of_joints_is_refused() -> None:
    back = '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'
    with pytest.raises(UrdfError, match="cycle"):
        Urdf.parse(robot(A, B, f'<joint name="j" type="fixed">{ENDS}</joint>', back))
