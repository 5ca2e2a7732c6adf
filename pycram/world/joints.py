"""Joints of an object: checked positions, joints that mimic other joints, and bodies that move with them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, JointLimitError
from pycram.world import attachment
from pycram.world.trajectory import Trajectory
from recorder import records
from recorder.urdf import Urdf

if TYPE_CHECKING:
    from pycram.world.object import Object

_LIMIT_TOLERANCE: Final = 1e-3  # tolerance in rad or m of limits; motors and splines exceed limits a little
_MIMIC_TOLERANCE: Final = 1e-3  # tolerance in rad or m of joints that mimic each other; files contain rounded values


def set_positions(body: Object, positions: Mapping[str, float]) -> None:
    """Set joints to positions (rad or m) by name; see :meth:`pycram.world.object.Object.set_joint_positions`."""
    checked = checked_positions(body, positions)
    command = records.MoveJoints(body=body.name, joints=list(checked), positions=list(checked.values()))
    checked = coupled(body, checked)
    engine = body.world.engine
    with body.world.transactions.begin(records.Mutation(move_joints=command)) as transaction:
        body.world.trajectories.refuse("set joints", body, checked)
        links = [] if body.is_robot else attachment.moved_links(body.urdf, checked)
        supported = attachment.supported_bodies(body, links) if links else {}
        before = {link: engine.link_pose(body.handle, link) for link in set(supported.values())}
        engine.set_joints(body.handle, checked)
        transaction.mark_modified(body)
        attachment.move_supported(body, before, supported, transaction)
        attachment.move_attached(body, transaction)
        if body.is_environment:
            transaction.fire(body.world.get_manipulation_event(), body)


def checked_positions(body: Object, positions: Mapping[str, float]) -> dict[str, float]:
    """Return given positions (rad or m) as floats by joint name; raise BadArgument, UnknownName or JointLimitError."""
    if not isinstance(positions, Mapping):
        raise BadArgument("positions", positions, "values by joint name, such as {'torso_lift_joint': 0.2}")
    return {name: _checked(body, name, position) for name, position in positions.items()}


def coupled(body: Object, given: dict[str, float]) -> dict[str, float]:
    """Return given positions (rad or m) by name, extended by the positions of joints in the same mimic groups.

    Positions of a group that contradict each other, or a joint that can't be moved, raise BadArgument.
    """
    urdf = body.urdf
    if not (body.model.loading.mimic and urdf.mimics):
        return given
    leaders = {name: position for name, position in given.items() if name not in urdf.mimics}
    for name, position in given.items():
        mimic = urdf.mimics.get(name)
        if mimic is None or mimic.leader in leaders:
            continue
        if urdf.joints[mimic.leader].movable and mimic.multiplier:
            leaders[mimic.leader] = _checked(body, mimic.leader, (position - mimic.offset) / mimic.multiplier)
        else:
            leaders[mimic.leader] = 0.0
    followers = urdf.followers(leaders)
    for name, position in followers.items():
        wanted = given.get(name, position)
        if abs(wanted - position) > _MIMIC_TOLERANCE:
            leader = urdf.mimics[name].leader
            cause = (
                f"{position:g}, because {name} mimics {leader}, which moves to {leaders[leader]:g}; set only {leader}"
            )
            raise BadArgument(name, wanted, cause)
    return {name: position for name, position in (leaders | followers | given).items() if urdf.joints[name].movable}


def with_followers(body: Object, trajectory: Trajectory) -> Trajectory:
    """Return a trajectory, extended by the joints in the mimic groups of its joints.

    Raises:
        UnknownName: The object has no such joint.
        BadArgument: A joint is named twice, or positions of a mimic group contradict each other.
        JointLimitError: A position is outside the joint's limits.
    """
    names = trajectory.joints
    if not names:  # the base moves
        return trajectory
    if len(set(names)) < len(names):
        raise BadArgument("joints", names, "each joint once")
    rows = [
        coupled(body, {name: _checked(body, name, at) for name, at in zip(names, row, strict=True)})
        for row in trajectory.positions
    ]
    if tuple(rows[0]) == names:
        return trajectory
    moved = tuple(rows[0])
    return Trajectory(
        moved,
        trajectory.times,
        tuple(tuple(row[name] for name in moved) for row in rows),
        tuple(_speeds(body.urdf, dict(zip(names, row, strict=True)), moved) for row in trajectory.velocities),
    )


def _speeds(urdf: Urdf, given: Mapping[str, float], moved: Iterable[str]) -> tuple[float, ...]:
    """Return speeds of joints (rad/s or m/s): the given speeds, or speeds that follow from mimicked joints."""
    speeds = dict(given)
    for name, speed in given.items():
        mimic = urdf.mimics.get(name)
        if mimic is not None and mimic.multiplier:
            speeds.setdefault(mimic.leader, speed / mimic.multiplier)
    for name in moved:
        mimic = urdf.mimics.get(name)
        if mimic is not None and name not in given:
            speeds[name] = speeds.get(mimic.leader, 0.0) * mimic.multiplier
    return tuple(speeds.get(name, 0.0) for name in moved)


def _checked(body: Object, name: str, position: float) -> float:
    lower, upper = body.joint_limits(name)
    checked = checks.number(f"joint {name}", position)
    if not lower - _LIMIT_TOLERANCE <= checked <= upper + _LIMIT_TOLERANCE:
        raise JointLimitError(body.name, name, checked, lower, upper)
    return checked
