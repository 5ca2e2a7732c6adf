"""Trajectories that bodies follow: in each step of a simulation the motors of their joints get where to be next.

A motor's target is where its joint is to be before the step, its velocity what brings the joint from there to where it
is to be after it; so motors of any gain follow without lagging. The base of a body is fixed to the world for the
engine: it is put to its pose step by step, and what is attached goes along. All else is physics: what is pushed moves,
and what doesn't give way keeps joints from following.

A trajectory that is stopped slows down along its path (:mod:`recorder.records.motion`), so nothing is touched that
wouldn't have been anyway, and trajectories that are stopped together stay together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.foundation.errors import FollowsTrajectory
from pycram.world import carried
from pycram.world.joints import with_followers
from pycram.world.trajectory import BaseFrame, Trajectory
from recorder import records
from recorder.records.motion import has_ended, time_of

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pycram.physics.body import Joint
    from pycram.world.object import Object
    from pycram.world.transaction import Transaction
    from pycram.world.world import BulletWorld

LOST: Final = {"revolute": 0.1, "prismatic": 0.05}
"""rad or m that a joint may be off its trajectory; without contacts it is less than 1e-3."""


class Followed:
    """A trajectory that a body follows, or has followed.

    Args:
        body: The body.
        following: Its record.
        sim_step: That of the world now.

    Raises:
        UnknownName: The body lacks one of its joints.
        BadArgument: Its numbers aren't a trajectory's, or positions of joints that mimic others contradict each other.
        JointLimitError: A position is outside of its joint's limits.

    Attributes:
        body: The body.
        following: Its record; ``stopped`` is set when it is.
        trajectory: Of all joints that move: those that mimic others, too.
        joints: These joints; empty for the base.
        time: Of the trajectory in s, up to which it was driven.
        error: The largest distance in rad or m that a joint had from where it was to be, in this transaction.
        worst: That joint; "" for the base.
        lost: The joint that was first further off than LOST, and how far; None if none was.
        ended: Whether it isn't followed any more.
    """

    def __init__(self, body: Object, following: records.Following, sim_step: int) -> None:
        self.body = body
        self.following = following
        self.trajectory = with_followers(body, Trajectory.of_record(following.begin.trajectory))
        self.joints: tuple[Joint, ...] = tuple(body.handle.joints[name] for name in self.trajectory.joints)
        self.time = time_of(following, sim_step)
        self.lost: tuple[str, float] | None = None
        self.ended = False
        self._targets: Sequence[float] = self.trajectory.at(self.time)[0]
        self._base = BaseFrame.of(body.world.engine.pose(body.handle))
        self.begin_stretch()

    @property
    def number(self) -> int:
        """Its number in its world."""
        return self.following.begin.number

    def begin_stretch(self) -> None:
        """Forget the largest error."""
        self.error, self.worst = 0.0, ""

    def drive(self, sim_step: int, transaction: Transaction) -> None:
        """Have the engine bring the body to where it is to be at a simulated step, which is the next."""
        self.time = min(time_of(self.following, sim_step), self.trajectory.duration)
        before, self._targets = self._targets, self.trajectory.at(self.time)[0]
        engine = self.body.world.engine
        if self.joints:
            engine.drive(self.body.handle, self.joints, before, self._targets)
            return
        engine.set_pose(self.body.handle, self._base.pose(self._targets))
        carried.move_attached(self.body, transaction)

    def measure(self) -> None:
        """Take note of how far the joints are from where they are to be."""
        if not self.joints:
            return
        positions = self.body.world.engine.positions(self.body.handle, self.joints)
        for joint, position, target in zip(self.joints, positions, self._targets, strict=True):
            error = abs(position - target)
            if error > self.error:
                self.error, self.worst = error, joint.name
            if error > LOST[joint.kind] and self.lost is None:
                self.lost = joint.name, error

    def hold(self) -> None:
        """Have the motors keep where the joints are to be; where they are, if that is far from there."""
        if self.joints and self.body.alive:
            engine, handle = self.body.world.engine, self.body.handle
            targets = engine.positions(handle, self.joints) if self.lost else self._targets
            engine.set_targets(handle, {joint.name: at for joint, at in zip(self.joints, targets, strict=True)})

    def driven(self) -> records.Driven:
        """Return its part of the record of a simulation."""
        return records.Driven(
            number=self.number,
            body=self.body.name,
            time=self.time,
            error=self.error,
            joint=self.worst,
            ended=self.ended,
        )


class Trajectories:
    """The trajectories that bodies of one world follow.

    Attributes:
        active: By number, in the order in which they began.
        last: The number of the latest.
    """

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self.active: dict[int, Followed] = {}
        self.last = 0

    def add(self, followed: Followed) -> None:
        """Have a body follow a trajectory from the next step on; part of a transaction, or of building a world."""
        self.active[followed.number] = followed
        self.last = followed.number

    def step(self, steps: int, transaction: Transaction) -> None:
        """Simulate steps of 1/240 s in which bodies follow their trajectories; how near is seen at their end."""
        engine, start = self._world.engine, self._world.sim_step
        for sim_step in range(start + 1, start + steps + 1):
            for followed in self.active.values():
                followed.drive(sim_step, transaction)
            engine.step(1)
            for followed in [each for each in self.active.values() if has_ended(each.following, sim_step)]:
                followed.measure()
                self.end(followed)
        for followed in self.active.values():
            followed.measure()

    def end(self, followed: Followed) -> None:
        """Have a body follow a trajectory no more; its motors keep where it has got."""
        del self.active[followed.number]
        followed.ended = True
        followed.hold()

    def end_all(self, body: Object | None = None) -> None:
        """End those of a body, or all, in a transaction that puts it elsewhere or removes it."""
        for followed in list(self.active.values()):
            if body in (None, followed.body):
                self.end(followed)

    def refuse(self, action: str, body: Object, joints: Collection[str] = ()) -> None:
        """Refuse to set what follows a trajectory: joints by name, or the base.

        Raises:
            FollowsTrajectory: One of them does.
        """
        for number, followed in self.active.items():
            moved = followed.trajectory.joints
            both = [name for name in moved if name in joints]
            if followed.body is body and (both or not (moved or joints)):
                raise FollowsTrajectory(action, body.name, number, both)

    def refuse_any(self, action: str) -> None:
        """Refuse what can't be done while anything follows a trajectory.

        Raises:
            FollowsTrajectory: Something does.
        """
        for number, followed in self.active.items():
            raise FollowsTrajectory(action, followed.body.name, number, followed.trajectory.joints)
