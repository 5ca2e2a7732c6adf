"""Inverse kinematics of arms of any make: in closed form where axes meet, searched for elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from pycram.reasoning.kinematics import closed_form
from pycram.reasoning.kinematics.forward import Chain
from pycram.reasoning.kinematics.inverse import (
    POSITION_TOLERANCE,
    TURN_TOLERANCE,
    ArmKinematics,
    Posture,
    search_postures,
)
from recorder import geometry
from recorder.urdf import Urdf

numbers = st.floats(-1, 1)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
units = vectors.filter(lambda v: np.linalg.norm(v) > 0.2).map(lambda v: v / np.linalg.norm(v))
angles = st.floats(-3.1, 3.1)


def robot(axes: list[str], lengths: list[float], limit: float = 2.5) -> Urdf:
    """An arm of joints with given axes, each so many metres from the one before along x."""
    links = "".join(f'<link name="l{i}"/>' for i in range(len(axes) + 2))
    joints = "".join(
        f'<joint name="j{i}" type="{"prismatic" if axis.startswith("slide") else "revolute"}">'
        f'<parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="{lengths[i]} 0 0"/>'
        f'<axis xyz="{axis.removeprefix("slide ")}"/><limit lower="{-limit}" upper="{limit}" effort="1" velocity="1"/>'
        "</joint>"
        for i, axis in enumerate(axes)
    )
    last = len(axes)
    tool = f'<joint name="tool" type="fixed"><parent link="l{last}"/><child link="l{last + 1}"/><origin xyz="{lengths[last]} 0 0"/></joint>'
    return Urdf.parse(f'<robot name="arm">{links}{joints}{tool}</robot>')


def chain(axes: list[str], lengths: list[float], limit: float = 2.5) -> ArmKinematics:
    """The kinematics of such an arm."""
    urdf = robot(axes, lengths, limit)
    return ArmKinematics(Chain(urdf, "l0", urdf.links[-1], [f"j{i}" for i in range(len(axes))]))


X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
IIWA = ([Z, Y, Z, Y, Z, Y, Z], [0.0, 0.0, 0.0, 0.42, 0.4, 0.0, 0.0, 0.15])
PR2 = ([Z, Y, X, Y, X, Y, X], [0.0, 0.1, 0.0, 0.4, 0.0, 0.32, 0.0, 0.18])
SKEWED = (["0.6 0 0.8", Y, "1 0 0", "0 0.8 0.6", X, "0 0.6 0.8", X], [0.0, 0.1, 0.0, 0.4, 0.0, 0.3, 0.0, 0.2])
PLANAR = ([Z, Z, Z], [0.0, 0.4, 0.3, 0.2])
SIX = ([Z, Y, Y, X, Y, X], [0.0, 0.1, 0.4, 0.1, 0.3, 0.0, 0.15])
SLIDING = (["slide 0 0 1", Z, Y, Y, X, Y, X], [0.0, 0.1, 0.0, 0.4, 0.1, 0.3, 0.0, 0.15])


def is_solved(posture: Posture) -> bool:
    """Whether the tool is as near to the target as the solver promises, which is nearer than queries ask for."""
    return posture.position_error < POSITION_TOLERANCE and posture.turn_error < TURN_TOLERANCE


@pytest.mark.parametrize(
    "arm", [PR2, IIWA, SKEWED, SIX, SLIDING, PLANAR], ids=["pr2", "iiwa", "skewed", "six", "sliding", "planar"]
)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_a_pose_of_a_random_posture_is_reached_within_limits(
    arm: tuple[list[str], list[float]], data: st.DataObject
) -> None:
    solver = chain(*arm)
    limit = 1.0 if arm is SLIDING else 2.3
    posture = np.array(data.draw(st.lists(st.floats(-limit, limit), min_size=len(arm[0]), max_size=len(arm[0]))))
    pose = solver.chain.poses(posture[None])[0]
    turn = None if arm is PLANAR else geometry.from_matrix(pose[:3, :3])
    (found,) = solver.solve([(pose[:3, 3], turn)])
    if arm in (PR2, IIWA, SKEWED):
        assert is_solved(found[0])
    for posture in found:
        values = np.array([[posture.positions[name] for name in solver.chain.joints]])
        assert (np.abs(values) <= 2.5 + 1e-9).all()
        there = solver.chain.poses(values)[0]
        assert np.linalg.norm(there[:3, 3] - pose[:3, 3]) == pytest.approx(posture.position_error, abs=1e-6)


@pytest.mark.parametrize("arm", [PR2, SKEWED, SLIDING], ids=["pr2", "skewed", "sliding"])
def test_tools_are_at_their_described_poses(arm: tuple[list[str], list[float]]) -> None:
    kinematics = chain(*arm).chain
    urdf = robot(*arm)
    for posture in np.random.default_rng(7).uniform(-2.0, 2.0, (20, len(arm[0]))):
        position, turn = urdf.forward_kinematics(dict(zip(kinematics.joints, posture, strict=True)), urdf.links[-1])
        pose = kinematics.poses(posture[None])[0]
        assert pose[:3, 3] == pytest.approx(position, abs=1e-12)
        assert np.allclose(pose[:3, :3], geometry.to_matrix(turn), atol=1e-12)


@pytest.mark.slow
def test_a_search_reaches_almost_all_poses_of_arms_without_closed_form() -> None:
    for arm in (SIX, SLIDING, PLANAR):
        solver = chain(*arm)
        postures = np.random.default_rng(4).uniform(-1.5, 1.5, (25, len(arm[0])))
        reached = 0
        for pose in solver.chain.poses(postures):
            turn = None if arm is PLANAR else geometry.from_matrix(pose[:3, :3])
            reached += is_solved(solver.solve([(pose[:3, 3], turn)])[0][0])
        assert reached >= 23, arm


def has_closed_form(axes: list[str], lengths: list[float]) -> bool:
    """Whether a pose that some posture has is reached without searching."""
    solver = chain(axes, lengths)
    posture = dict.fromkeys(solver.chain.joints, 0.3)
    pose = solver.chain.poses(np.array([[*posture.values()]]))[0]
    (found,) = solver.closed_form([(pose[:3, 3], geometry.from_matrix(pose[:3, :3]))], posture)
    return bool(found)


def test_arms_with_a_spherical_shoulder_and_wrist_have_a_closed_form() -> None:
    assert has_closed_form(*PR2)
    assert has_closed_form(*SKEWED)
    for arm in (SIX, SLIDING, PLANAR):
        assert not has_closed_form(*arm)
    assert has_closed_form(PR2[0], [0.0, 0.1, 0.05, 0.4, 0.0, 0.32, 0.0, 0.18])  # axis 3 along x still meets axis 2
    assert has_closed_form(PR2[0], [0.0, 0.1, 0.0, 0.4, 0.0, 0.32, 0.02, 0.18])  # axis 7 along x still meets the wrist
    assert has_closed_form([Z, Y, X, Y, X, Y, Z], PR2[1])
    assert not has_closed_form([Z, Y, X, Y, X, Y, Y], PR2[1])  # axes 6 and 7 are one


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(units, units, vectors, angles, angles)
def test_two_turns_bring_a_vector_to_the_result_of_two_known_turns(
    first: np.ndarray, second: np.ndarray, start: np.ndarray, outer: float, inner: float
) -> None:
    assume(np.linalg.norm(np.cross(first, second)) > 0.1)
    assume(np.linalg.norm(start) > 0.05)
    column = start[:, None]
    end = closed_form.turned(first, np.array([outer]), closed_form.turned(second, np.array([inner]), column))
    outers, inners, strain = closed_form.two_turns(first, second, column, end)
    assert strain == pytest.approx(0.0, abs=1e-3)
    for outer_turn, inner_turn in zip(outers, inners, strict=True):
        again = closed_form.turned(first, outer_turn, closed_form.turned(second, inner_turn, column))
        assert np.allclose(again, end, atol=1e-4)


@settings(max_examples=60, deadline=None)
@given(units, vectors, vectors, angles)
def test_a_turn_to_a_distance(axis: np.ndarray, start: np.ndarray, end: np.ndarray, angle: float) -> None:
    assume(np.linalg.norm(np.cross(axis, start)) > 0.05)
    assume(np.linalg.norm(np.cross(axis, end)) > 0.05)
    moved = closed_form.turned(axis, np.array([angle]), start[:, None])
    distance = np.linalg.norm(moved - end[:, None], axis=0)
    assume(distance > 1e-3)
    found, strain = closed_form.opened(closed_form.hinge(axis, start[:, None], end[:, None]), distance)
    assert strain == pytest.approx(0.0, abs=1e-3)
    for turn in found:
        again = closed_form.turned(axis, turn, start[:, None])
        assert np.linalg.norm(again - end[:, None], axis=0) == pytest.approx(distance, abs=1e-5)


def test_the_arm_points_to_targets_out_of_reach() -> None:
    solver = chain(*PR2)
    ((found,),) = solver.solve([([1.3, 0.0, 0.0], None)])
    assert not found.reaches()
    assert found.position_error == pytest.approx(0.3, abs=0.01)
    ((turned,),) = solver.solve([([0.0, 0.0, 5.0], geometry.from_rpy(0, math.pi, 0))])
    assert not turned.reaches()


def test_many_targets_get_the_same_postures_as_single_ones() -> None:
    """Near, at the edge and far beyond; with orientations and without."""
    solver = chain(*PR2)
    rng = np.random.default_rng(3)
    positions = [[float(x) for x in rng.uniform(-1.2, 1.2, 3)] for _ in range(20)]
    turn = geometry.from_rpy(0.3, 0.8, -0.4)
    for targets in ([(position, turn) for position in positions], [(position, None) for position in positions]):
        many = solver.solve(targets)
        reached = [is_solved(postures[0]) for postures in many]
        assert 0 < sum(reached) < len(reached)
        for target, postures in zip(targets, many, strict=True):
            alone = solver.solve([target])[0][0]
            assert is_solved(alone) is is_solved(postures[0])
            assert alone.position_error == pytest.approx(postures[0].position_error, abs=1e-6)
        exact = solver.closed_form(targets, {})
        assert all(is_solved(posture) for postures in exact for posture in postures)
        assert all(there for postures, there in zip(exact, reached, strict=True) if postures)


def test_a_long_search_continues_from_the_results_of_a_quick_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The starts that a quick search tries in vain aren't tried again; what is found is as without it."""
    out_of_reach = [([0.9, 0.1, 0.2], (0.0, 0.0, 0.0, 1.0)), ([0.0, 0.9, 0.2], (0.0, 0.0, 1.0, 0.0))]
    searched: list[int] = []

    def counted(chain: Chain, start: np.ndarray, *rest: np.ndarray, stop_early: bool) -> tuple[np.ndarray, np.ndarray]:
        searched.append(len(start))
        return search_postures(chain, start, *rest, stop_early=stop_early)

    monkeypatch.setattr("pycram.reasoning.kinematics.inverse.search_postures", counted)
    alone = chain(*SIX).solve(out_of_reach)
    few, many = searched
    searched.clear()
    solver = chain(*SIX)
    solver.solve(out_of_reach, quick=True)
    assert solver.solve(out_of_reach) == alone
    assert searched == [few, many]


def test_arms_with_any_number_of_joints_are_searched() -> None:
    solver = chain([Z, Y] * 7, [0.1] * 15)
    assert is_solved(solver.solve([([0.7, 0.3, 0.4], None)])[0][0])
