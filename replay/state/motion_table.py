"""The trajectories of a recording as a table: planned and driven, a row for each moment of a joint.

Driven positions are known 30 times a simulated second, from the samples of simulations. Velocities of joints are those
read from the engine; a base has none, as it is moved from pose to pose.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from recorder import geometry
from recorder.records import STEPS_PER_SECOND, Keyframe, Mutation
from recorder.records.motion import BASE_COORDINATES, has_ended, time_of
from replay.errors import Damaged
from replay.state.fold import apply

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.records import BeginTrajectory, BodyState
    from replay.file.record_reader import RecordReader
    from replay.state.fold import WorldBuilder
    from replay.state.state import Body, World


class MotionRow(NamedTuple):
    """A planned or driven position of a joint, or of a coordinate of a base."""

    world: str
    trajectory: int  # its number in the world
    body: str
    joint: str  # a joint, or x, y or yaw of the base in the world frame
    source: str  # "planned" or "driven"
    time: float  # s since the trajectory began, of its own time: it slows down when the trajectory is stopped
    seconds: float  # s of the world's simulated time; of a planned position, if nothing stops the trajectory
    position: float  # rad or m
    velocity: float | None  # rad/s or m/s; None if it isn't known


def rows(log: RecordReader) -> Iterator[MotionRow]:
    """Yield all rows of a recording: of each trajectory the planned rows when it begins, then the driven ones.

    Raises:
        Damaged: a record makes no sense.
    """
    worlds: dict[str, WorldBuilder] = {}
    for record in log.records((Mutation, Keyframe)):
        try:
            if isinstance(record, Mutation) and record.simulate.driven and record.world in worlds:
                yield from _driven(worlds[record.world].build(), record)
            apply(worlds, record)
            if isinstance(record, Mutation) and record.HasField("begin_trajectory"):
                yield from _planned(record)
        except (ValueError, IndexError) as error:
            raise Damaged(log.path, f"step {record.seq}", str(error)) from error


def _planned(record: Mutation) -> Iterator[MotionRow]:
    begin, start = record.begin_trajectory, record.sim_step / STEPS_PER_SECOND
    trajectory = begin.trajectory
    moments = [(time, name) for time in trajectory.times for name in _names(begin)]
    for (time, name), position, velocity in zip(moments, trajectory.positions, trajectory.velocities, strict=True):
        where = record.world, begin.number, begin.body, name
        yield MotionRow(*where, "planned", time, start + time, position, velocity)


def _driven(world: World, record: Mutation) -> Iterator[MotionRow]:
    """Yield the rows of a stretch of simulation; the world is the one before it."""
    ends = {each.number: each.time for each in record.simulate.driven}
    followed = {number: each for number, each in world.following.items() if number in ends}
    values = {each.begin.body: _values(world.bodies.get(each.begin.body)) for each in followed.values()}
    moments = [(sample.sim_step, sample.bodies) for sample in record.effect.samples]
    for sim_step, states in [*moments, (record.sim_step, record.effect.bodies)]:
        for state in states:
            if state.body in values:
                values[state.body].update(_read(state))
        for number, following in list(followed.items()):
            time = min(time_of(following, sim_step), ends[number])
            body = following.begin.body
            for name in _names(following.begin):
                if name in values[body]:
                    where = record.world, number, body, name
                    yield MotionRow(*where, "driven", time, sim_step / STEPS_PER_SECOND, *values[body][name])
            if has_ended(following, sim_step):
                del followed[number]


def _names(begin: BeginTrajectory) -> Sequence[str]:
    return begin.trajectory.joints or BASE_COORDINATES


def _values(body: Body | None) -> dict[str, tuple[float, float | None]]:
    """Return position and velocity of a body's joints and base coordinates, by name."""
    if body is None:  # its loading is lost
        return {}
    joints = {name: (position, body.joint_velocities[name]) for name, position in body.joints.items()}
    return joints | _place(body.position) | _heading(body.orientation)


def _read(state: BodyState) -> dict[str, tuple[float, float | None]]:
    """Return those positions and velocities that a record has."""
    speeds = state.joint_velocities or [0.0] * len(state.joints)
    joints = zip(state.joint_positions, speeds, strict=True)
    found: dict[str, tuple[float, float | None]] = dict(zip(state.joints, joints, strict=True))
    return found | _place(state.position) | _heading(state.orientation)


def _place(position: Sequence[float]) -> dict[str, tuple[float, float | None]]:
    return {"x": (position[0], None), "y": (position[1], None)} if position else {}


def _heading(orientation: Sequence[float]) -> dict[str, tuple[float, float | None]]:
    if not orientation:
        return {}
    return {"yaw": (geometry.to_rpy(orientation)[2], None)}
