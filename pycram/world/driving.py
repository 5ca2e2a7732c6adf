"""Driving: bodies begin to follow trajectories, and are stopped, as transactions; plans wait until they have ended."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Protocol

from pycram.foundation.collision_pair import CollisionPair
from pycram.foundation.failures import BadArgument, TrackingLost, TrajectoryEnded, UnknownName
from pycram.foundation.refusals import refusing
from pycram.scheduling.cancellation import raise_if_cancelled, shielded, uninterruptible
from pycram.world import carried, passing_time
from pycram.world.followed import LOST, Followed
from pycram.world.trajectory import Trajectory
from recorder import geometry, records
from recorder.records.motion import has_ended
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

_MAX_SECONDS: Final = 3600.0
_MAX_NUMBERS: Final = 200_000  # a minute of 100 rows a second for 30 joints
_FARTHEST: Final = 1e6  # m or rad, as of any pose
_FASTEST: Final = 1e3  # m/s or rad/s
_START: Final = 0.2  # of what loses the track: how far from its begin a body may be
_BASE_START: Final = (0.01, 0.01, 0.02)  # the same of x and y in m, and of yaw in rad


class Planned(Protocol):
    """A motion that was planned."""

    @property
    def trajectory(self) -> Trajectory:
        """What is to be followed."""

    @property
    def search(self) -> records.PathSearch | None:
        """How its path was found; None if it was given."""


@refusing(name="follow")
def follow(world: BulletWorld, motions: Sequence[tuple[Object, Planned]]) -> None:
    """Have bodies follow trajectories, all from this moment on, and wait in simulated time until all have ended.

    What ends the wait early stops them: they slow down along their paths, at most 0.2 s of simulated time, and stand
    when the error is raised.

    Args:
        world: Their world.
        motions: Bodies, each with what it is to follow.

    Raises:
        TrackingLost: A joint got too far from its trajectory.
        TrajectoryEnded: Somebody else stopped one, or the world was reset or restored.
        BadArgument: A body can't follow its trajectory, or isn't where that begins; none has moved then.
        FollowsTrajectory: A body follows another trajectory with the same joints; none has moved then.
        Cancelled: The branch is cancelled.
    """
    raise_if_cancelled()
    begun: list[Followed] = []
    try:
        with uninterruptible(), Uninterrupted():  # what belongs together begins together
            for body, planned in motions:
                begun.append(begin(world, body, planned.trajectory, planned.search))
        passing_time.wait(world, lambda: all(each.ended for each in begun) or any(each.lost for each in begun))
        _raise_lost(begun)
    except BaseException:
        _stop_all(world, begun)
        raise
    for each in begun:
        if each.time < each.trajectory.duration:
            raise TrajectoryEnded(each.body.name, each.number, each.time, each.trajectory.duration)


def _stop_all(world: BulletWorld, begun: Sequence[Followed]) -> None:
    """Stop trajectories together, and let time pass until they stand, whatever is cancelled."""
    with shielded(), uninterruptible():
        with world.lock:
            for each in begun:
                if not (each.ended or each.following.stopped or world.closed):
                    stop(world, each.number)
        if not world.closed:
            passing_time.wait(world, lambda: all(each.ended for each in begun))


def begin(
    world: BulletWorld,
    body: Object,
    trajectory: Trajectory,
    search: records.PathSearch | None = None,
    number: int | None = None,
) -> Followed:
    """Have a body follow a trajectory; see :meth:`pycram.world.world.BulletWorld.begin_trajectory`.

    Its number is that of its record where it is begun again.
    """
    if not isinstance(trajectory, Trajectory):
        raise BadArgument("trajectory", trajectory, "a Trajectory")
    if getattr(body, "world", None) is not world:
        raise BadArgument("body", body, f"an object in {world.name}")
    _check(body, trajectory)
    command = records.BeginTrajectory(body=body.name, trajectory=trajectory.record(), search=search)
    mutation = records.Mutation(begin_trajectory=command)
    with world.transactions.begin(mutation):
        last = world.trajectories.last
        if number is not None and number <= last:
            raise BadArgument("number", number, f"a number after {last}")
        mutation.begin_trajectory.number = command.number = last + 1 if number is None else number
        followed = Followed(body, records.Following(begin=command, began=world.sim_step), world.sim_step)
        world.trajectories.refuse("follow a trajectory", body, followed.trajectory.joints)
        _check_start(body, trajectory)
        world.trajectories.add(followed)
    return followed


def stop(world: BulletWorld, number: int) -> None:
    """Stop a trajectory; see :meth:`pycram.world.world.BulletWorld.stop_trajectory`."""
    mutation = records.Mutation(stop_trajectory=records.StopTrajectory(number=number))
    with world.transactions.begin(mutation):
        followed = world.trajectories.active.get(number)
        if followed is None:
            raise UnknownName("trajectory", number, world.name, map(str, world.trajectories.active))
        mutation.stop_trajectory.body = followed.body.name
        if followed.following.began == world.sim_step:  # it hasn't moved yet
            world.trajectories.end(followed)
        elif not followed.following.stopped:
            followed.following.stopped = world.sim_step


def resume(body: Object, following: records.Following) -> None:
    """Have a body go on with a trajectory that it followed when the recorded state was taken.

    This is no transaction and leaves no record: it serves to build worlds in isolation from recordings.

    Raises:
        BadArgument: The body can't follow it, or it doesn't fit the world's clock.
    """
    world = body.world
    if not following.began <= world.sim_step >= following.stopped >= 0 or has_ended(following, world.sim_step):
        raise BadArgument("following", following.begin.number, f"a trajectory that is followed at {world.sim_step}")
    _check(body, Trajectory.of_record(following.begin.trajectory))
    world.trajectories.add(Followed(body, following, world.sim_step))


def _check(body: Object, trajectory: Trajectory) -> None:
    """Refuse a trajectory that no such body could follow; one that was recorded may say anything.

    Raises:
        BadArgument: It is too long, or for a base that physics moves, or leads too far away, or too fast.
    """
    if trajectory.duration > _MAX_SECONDS:
        raise BadArgument("times", trajectory.duration, f"an end after at most {_MAX_SECONDS:g} s")
    if len(trajectory.times) * len(trajectory.coordinates) > _MAX_NUMBERS:
        size = f"{len(trajectory.times)} rows of {len(trajectory.coordinates)}"
        raise BadArgument("positions", size, f"at most {_MAX_NUMBERS} numbers")
    if not trajectory.joints and not body.fixed:
        raise BadArgument("body", body, "a robot, or an object of the environment: physics moves the base of others")
    for name, table, most in (
        ("position", trajectory.positions, _FARTHEST),
        ("velocity", trajectory.velocities, _FASTEST),
    ):
        farthest = max((at for row in table for at in row), key=abs)
        if abs(farthest) > most:
            raise BadArgument(name, farthest, f"a number up to {most:g}")


def displacement(body: Object, trajectory: Trajectory) -> tuple[str, float, float] | None:
    """Return a coordinate of a body that isn't where a trajectory begins, where it is to be and where it is (rad or m).

    None if all are there, near enough for motors to follow.
    """
    engine, joints = body.world.engine, body.handle.joints
    if trajectory.joints:
        now = [engine.joint(body.handle, name) for name in trajectory.joints]
        near = [LOST[joints[name].kind] * _START for name in trajectory.joints]
        off = [abs(a - b) for a, b in zip(now, trajectory.positions[0], strict=True)]
    else:
        (x, y, _), orientation = engine.pose(body.handle)
        now, near = [x, y, geometry.to_rpy(orientation)[2]], list(_BASE_START)
        off = [abs(a - b) for a, b in zip(now, trajectory.positions[0], strict=True)]
        off[2] = abs(math.remainder(off[2], math.tau))
    for name, at, start, distance, limit in zip(
        trajectory.coordinates, now, trajectory.positions[0], off, near, strict=True
    ):
        if distance > limit:
            return name, start, at
    return None


def _check_start(body: Object, trajectory: Trajectory) -> None:
    displaced = displacement(body, trajectory)
    if displaced is not None:
        name, start, at = displaced
        raise BadArgument(f"start of {name}", start, f"about {at:.4f}, where {name} of {body.name} is")


def _raise_lost(begun: Sequence[Followed]) -> None:
    """Raise the failure of a trajectory whose track is lost."""
    for each in begun:
        if each.lost is not None and each.body.alive:
            joint, error = each.lost
            raise TrackingLost(each.body.name, each.number, joint, error, each.time, _touching(each.body, joint))


def _touching(body: Object, joint: str) -> list[CollisionPair]:
    """Return what the links that a joint moves, and what they carry, touched in the last step, hardest first."""
    moved = set(carried.moved_links(body.urdf, [joint]))
    movers: dict[Object, set[str]] = {body: moved}
    for mover in movers.copy():
        movers |= {held.body: set(held.body.links) for held in mover.carried if held.carrier_link in movers[mover]}
    bodies = {other.handle.id: other for other in body.world.objects}
    found: dict[CollisionPair, float] = {}
    for mover, links in movers.items():
        names = {index: name for name, index in mover.handle.links.items()}
        for contact in body.world.engine.contacts(mover.handle):
            other = bodies.get(contact.other)
            if other is None or other in movers or names[contact.link] not in links or contact.force <= 0:
                continue
            other_link = next(name for name, index in other.handle.links.items() if index == contact.other_link)
            pair = CollisionPair(mover.name, names[contact.link], other.name, other_link)
            found[pair] = max(found.get(pair, 0.0), contact.force)
    return sorted(found, key=found.__getitem__, reverse=True)
