"""Snapshots of bodies: their state as the engine has it, how it is restored, and how its changes are recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder import records
from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pycram.physics.body import Snapshot
    from pycram.world.object import Object

_AT_REST: Final = (0.0,) * 6


def take_snapshot(body: Object) -> Snapshot:
    """Return the state that an object has in the engine."""
    return body.world.engine.snapshot(body.handle)


def restore_snapshot(body: Object, snapshot: Snapshot) -> None:
    """Set the state of an object to a snapshot of it, or of the same model elsewhere; motors hold its joints there.

    This is no world transaction and leaves no record: it serves to build worlds in isolation from recordings.

    Raises:
        RuntimeError: A recording runs, which would miss the change.
    """
    if journal.recording():
        raise RuntimeError(f"the state of {body.name} can only be restored while nothing is recorded")
    engine, handle = body.world.engine, body.handle
    engine.set_pose(handle, snapshot.pose)
    if not body.fixed and snapshot.velocity != _AT_REST:
        engine.set_velocity(handle, snapshot.velocity)
    positions = dict(zip(body.joints, snapshot.positions, strict=True))
    engine.set_joints(handle, positions, dict(zip(body.joints, snapshot.velocities, strict=True)))


def state_delta(body: Object, now: Snapshot, last: Snapshot | None, tolerance: float = 0.0) -> records.BodyState | None:
    """Return what has changed of an object since its last record; None if nothing has.

    Args:
        body: The object.
        now: Its state.
        last: The state of its last record; None for a record of the whole state.
        tolerance: Differences of poses and joints (m, rad, parts of a quaternion) up to this one don't count, nor do
            those of velocities alone if it isn't 0.
    """
    state = records.BodyState(body=body.name)
    changed = False
    if last is None or _differs((*now.pose[0], *now.pose[1]), (*last.pose[0], *last.pose[1]), tolerance):
        state.position[:], state.orientation[:] = now.pose
        changed = True
    moving = now.velocity != _AT_REST
    if (moving and changed) or (not tolerance and last is not None and now.velocity != last.velocity):
        state.velocity[:] = now.velocity
        changed = True
    joints = _changed_joints(now, last, tolerance)
    if joints:
        names = body.joints
        state.joints[:] = [names[i] for i in joints]
        state.joint_positions[:] = [now.positions[i] for i in joints]
        if any(now.velocities[i] for i in joints):
            state.joint_velocities[:] = [now.velocities[i] for i in joints]
        changed = True
    return state if changed else None


def _changed_joints(now: Snapshot, last: Snapshot | None, tolerance: float) -> Sequence[int]:
    if last is None:
        return range(len(now.positions))
    if tolerance:
        return [i for i, position in enumerate(now.positions) if abs(position - last.positions[i]) > tolerance]
    before = zip(last.positions, last.velocities, strict=True)
    after = zip(now.positions, now.velocities, strict=True)
    return [i for i, (old, new) in enumerate(zip(before, after, strict=True)) if old != new]


def _differs(a: Iterable[float], b: Iterable[float], tolerance: float) -> bool:
    return any(abs(x - y) > tolerance for x, y in zip(a, b, strict=True))
