"""Driving: bodies follow trajectories in simulated time, and plans wait until the trajectories have ended.

Before each step, a motor gets the joint's planned position as its target, and the velocity to the next planned
position. A base is set to its pose in each step, with all attached objects. Physics determines everything else: pushed
objects move, and obstacles stop joints. Bodies coast during 1/30 s if all other bodies rest, and nothing is near the
moving links at the beginning and at the end: the bodies are then set to their positions at the end. The engine's steps
would take ten times as long.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from pycram.foundation.errors import FollowsTrajectory
from pycram.foundation.failures import BadArgument, CollisionPair, TrackingLost, TrajectoryEnded, UnknownName
from pycram.foundation.refusals import refusing
from pycram.physics.body import LoadedBody, MovableJoint
from pycram.scheduling.cancellation import raise_if_cancelled, shielded, uninterruptible
from pycram.world import attachment, simulation
from pycram.world.joints import with_followers
from pycram.world.object import Object
from pycram.world.trajectory import BaseFrame, Trajectory
from pycram.world.transaction import Transaction
from recorder import geometry, records
from recorder.geometry import Pose
from recorder.records.motion import has_ended, time_of
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

    Array = NDArray[np.float64]


LOST: Final = {"revolute": 0.1, "prismatic": 0.05}
"""Largest deviation of a joint from its trajectory, rad or m; without contacts, joints deviate by less than 1e-3."""
_MAX_SECONDS: Final = 3600.0
_MAX_NUMBERS: Final = 200_000  # maximum number of values of a trajectory: 30 joints for a minute, at 100 rows a second
_FARTHEST: Final = 1e6  # largest position of a trajectory, m or rad
_FASTEST: Final = 1e3  # largest velocity of a trajectory, m/s or rad/s
_START: Final = 0.2  # allowed deviation of a joint at the start of a trajectory, as a share of ``LOST``
_BASE_START: Final = (0.01, 0.01, 0.02)  # allowed deviations of a base from the start of a trajectory: m, m, rad


class Followed:
    """A trajectory that a body follows or has followed; :func:`with_followers` describes the errors."""

    def __init__(self, body: Object, following: records.Following, sim_step: int) -> None:
        self.body = body
        self.following = following  # the trajectory's record; ``stopped`` is set when the trajectory is stopped
        #: The trajectory of all moving joints, also of joints that mimic others.
        self.trajectory = with_followers(body, Trajectory.of_record(following.begin.trajectory))
        #: The moving joints; empty for the base.
        self.joints: tuple[MovableJoint, ...] = tuple(body.handle.joints[name] for name in self.trajectory.joints)
        self.time = time_of(following, sim_step)  # time in s up to which the body has followed the trajectory
        self.lost: tuple[str, float] | None = None  # the first joint that deviated by more than LOST, and its deviation
        self.ended = False
        self._targets: Sequence[float] = self.trajectory.at(self.time)[0]
        self._base = BaseFrame.of(body.world.engine.pose(body.handle))
        self.begin_stretch()

    @property
    def number(self) -> int:
        """Number of the trajectory in its world."""
        return self.following.begin.number

    def begin_stretch(self) -> None:
        """Reset the largest deviation at the start of a transaction."""
        self.error = 0.0  # largest deviation of a joint, rad or m
        self.worst = ""  # the joint with the largest deviation; "" for the base

    def drive(self, sim_step: int, transaction: Transaction) -> None:
        """Command the engine to move the body to its target at the next simulated step."""
        self.time = min(time_of(self.following, sim_step), self.trajectory.duration)
        before, self._targets = self._targets, self.trajectory.at(self.time)[0]
        engine = self.body.world.engine
        if self.joints:
            engine.drive(self.body.handle, self.joints, before, self._targets)
            return
        engine.set_pose(self.body.handle, self._base.pose(self._targets))
        attachment.move_attached(self.body, transaction)

    def coast(self, sim_step: int, transaction: Transaction) -> None:
        """Move the body to its target at a simulated step, without the engine's simulation."""
        self.time = min(time_of(self.following, sim_step), self.trajectory.duration)
        self._targets = self.trajectory.at(self.time)[0]
        engine = self.body.world.engine
        if self.joints:
            earlier = min(time_of(self.following, sim_step - 1), self.trajectory.duration)
            before = self.trajectory.at(max(earlier, 0.0))[0]
            speeds = [(b - a) * records.STEPS_PER_SECOND for a, b in zip(before, self._targets, strict=True)]
            engine.pose_joints(self.body.handle, dict(zip(self.trajectory.joints, self._targets, strict=True)), speeds)
        else:
            engine.set_pose(self.body.handle, self._base.pose(self._targets))
        attachment.move_attached(self.body, transaction)

    def measure(self) -> None:
        """Measure the deviations of the joints from their targets."""
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
        """Make the motors hold the joints at their targets, or, after a lost track, at their present positions."""
        if self.joints and self.body.alive:
            engine, handle = self.body.world.engine, self.body.handle
            targets = engine.positions(handle, self.joints) if self.lost else self._targets
            engine.set_targets(handle, {joint.name: at for joint, at in zip(self.joints, targets, strict=True)})

    def driven(self) -> records.Driven:
        """Return the record of the trajectory's progress in a simulation."""
        return records.Driven(
            number=self.number,
            body=self.body.name,
            time=self.time,
            error=self.error,
            joint=self.worst,
            ended=self.ended,
        )


class Trajectories:
    """The trajectories that bodies of one world follow."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self.active: dict[int, Followed] = {}  # trajectories by number, oldest first
        self.last = 0  # number of the latest trajectory
        self._coasting = Coasting(world)

    def add(self, followed: Followed) -> None:
        """Make a body follow a trajectory from the next step on, in a transaction or a world that is rebuilt."""
        self.active[followed.number] = followed
        self.last = followed.number

    def step(self, steps: int, transaction: Transaction) -> None:
        """Simulate steps of 1/240 s while bodies follow their trajectories, then measure their deviations."""
        engine, start = self._world.engine, self._world.sim_step
        coasts = all(followed.following.begin.coasts for followed in self.active.values())
        if coasts and self._coast(start, steps, transaction):
            return
        for sim_step in range(start + 1, start + steps + 1):
            for followed in self.active.values():
                followed.drive(sim_step, transaction)
            engine.step(1)
            for followed in [each for each in self.active.values() if has_ended(each.following, sim_step)]:
                followed.measure()
                self.end(followed)
        for followed in self.active.values():
            followed.measure()
        if coasts:
            self._coasting.simulated()

    def _coast(self, start: int, steps: int, transaction: Transaction) -> bool:
        """Move the bodies without the engine's simulation; return False if the engine must simulate the steps."""
        end, moved = start + steps, list(self.active.values())
        if not self._coasting.may_begin([(each.body, each.trajectory.joints) for each in moved]):
            return False
        for each in moved:
            each.coast(end, transaction)
        if not self._coasting.may_end():
            for each in moved:
                each.coast(start, transaction)
            return False
        for each in moved:
            if has_ended(each.following, end):
                self.end(each)
        return True

    def end(self, followed: Followed) -> None:
        """End a trajectory; motors hold the body's joints."""
        del self.active[followed.number]
        followed.ended = True
        followed.hold()

    def end_all(self, body: Object | None = None) -> None:
        """End all trajectories, or all trajectories of a body, in a transaction that moves or removes the body."""
        for followed in list(self.active.values()):
            if body in (None, followed.body):
                self.end(followed)

    def refuse(self, action: str, body: Object, joints: Collection[str] = ()) -> None:
        """Raise FollowsTrajectory if a joint follows a trajectory; without joints, if the base follows a trajectory."""
        for number, followed in self.active.items():
            moved = followed.trajectory.joints
            both = [name for name in moved if name in joints]
            if followed.body is body and (both or not (moved or joints)):
                raise FollowsTrajectory(action, body.name, number, both)

    def refuse_any(self, action: str) -> None:
        """Raise FollowsTrajectory if any body follows a trajectory."""
        for number, followed in self.active.items():
            raise FollowsTrajectory(action, followed.body.name, number, followed.trajectory.joints)


class FollowableMotion(Protocol):
    """A planned motion."""

    @property
    def trajectory(self) -> Trajectory:
        """The trajectory to follow."""

    @property
    def search(self) -> records.PathSearch | None:
        """The search for the trajectory's path; None if the plan has given the path."""


@refusing(name="follow")
def follow(world: BulletWorld, motions: Sequence[tuple[Object, FollowableMotion]]) -> None:
    """Make bodies follow trajectories that start together, and wait in simulated time until all have ended.

    If an error ends the wait early, all trajectories are stopped before the error is raised. Then bodies slow down
    along their paths for at most 0.2 s of simulated time.

    Raises:
        TrackingLost: A joint deviated too far from its trajectory.
        TrajectoryEnded: Another call stopped a trajectory, or the world was reset or restored.
        BadArgument: A body can't follow its trajectory, or isn't at the trajectory's start; no body has moved.
        FollowsTrajectory: A joint follows another trajectory; no body has moved.
        Cancelled: The branch is cancelled.
    """
    raise_if_cancelled()
    begun: list[Followed] = []
    try:
        with uninterruptible(), Uninterrupted():  # either all motions start, or none
            for body, planned in motions:
                begun.append(begin(world, body, planned.trajectory, planned.search))
        simulation.wait(world, lambda: all(each.ended for each in begun) or any(each.lost for each in begun))
        for each in begun:
            if each.lost is not None and each.body.alive:
                joint, error = each.lost
                raise TrackingLost(each.body.name, each.number, joint, error, each.time, _touching(each.body, joint))
    finally:
        with shielded(), uninterruptible():  # all trajectories end, even if the branch is cancelled
            with world.lock:
                for each in begun:
                    if not (each.ended or each.following.stopped or world.closed):
                        stop(world, each.number)
            if not world.closed:
                simulation.wait(world, lambda: all(each.ended for each in begun))
    for each in begun:
        if each.time < each.trajectory.duration:
            raise TrajectoryEnded(each.body.name, each.number, each.time, each.trajectory.duration)


def begin(
    world: BulletWorld,
    body: Object,
    trajectory: Trajectory,
    search: records.PathSearch | None = None,
    number: int | None = None,
    *,
    coasts: bool | None = None,
) -> Followed:
    """Make a body follow a trajectory; see :meth:`pycram.world.world.BulletWorld.begin_trajectory`.

    ``number`` and ``coasts`` are recorded values if a recorded trajectory begins again.
    """
    if not isinstance(trajectory, Trajectory):
        raise BadArgument("trajectory", trajectory, "a Trajectory")
    if getattr(body, "world", None) is not world:
        raise BadArgument("body", body, f"an object in {world.name}")
    _check(body, trajectory)
    coasts = not world.engine.has_window if coasts is None else coasts
    command = records.BeginTrajectory(body=body.name, trajectory=trajectory.record(), search=search, coasts=coasts)
    mutation = records.Mutation(begin_trajectory=command)
    with world.transactions.begin(mutation):
        last = world.trajectories.last
        if number is not None and number <= last:
            raise BadArgument("number", number, f"a number after {last}")
        mutation.begin_trajectory.number = command.number = last + 1 if number is None else number
        followed = Followed(body, records.Following(begin=command, began=world.sim_step), world.sim_step)
        world.trajectories.refuse("follow a trajectory", body, followed.trajectory.joints)
        displaced = displacement(body, trajectory)
        if displaced is not None:
            name, start, at = displaced
            raise BadArgument(f"start of {name}", start, f"about {at:.4f}, where {name} of {body.name} is")
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
        if followed.following.began == world.sim_step:  # the body hasn't moved since then
            world.trajectories.end(followed)
        elif not followed.following.stopped:
            followed.following.stopped = world.sim_step


def resume(body: Object, following: records.Following) -> None:
    """Make a body continue a recorded trajectory, in a world that is rebuilt from a recording, without a record.

    BadArgument is raised if the body can't follow the trajectory, or if its steps contradict the world's time.
    """
    world = body.world
    if not following.began <= world.sim_step >= following.stopped >= 0 or has_ended(following, world.sim_step):
        raise BadArgument(
            "following", following.begin.number, f"a trajectory in progress at simulated step {world.sim_step}"
        )
    _check(body, Trajectory.of_record(following.begin.trajectory))
    world.trajectories.add(Followed(body, following, world.sim_step))


def _check(body: Object, trajectory: Trajectory) -> None:
    """Raise BadArgument for a trajectory that the body could never follow; recorded values may be impossible."""
    if trajectory.duration > _MAX_SECONDS:
        raise BadArgument("times", trajectory.duration, f"a duration of at most {_MAX_SECONDS:g} s")
    if len(trajectory.times) * len(trajectory.coordinates) > _MAX_NUMBERS:
        size = f"{len(trajectory.times)} rows of {len(trajectory.coordinates)}"
        raise BadArgument("positions", size, f"at most {_MAX_NUMBERS} numbers")
    if not trajectory.joints and not body.fixed:
        raise BadArgument("body", body, "a robot or environment object: physics moves the base of other objects")
    for name, table, most in (
        ("position", trajectory.positions, _FARTHEST),
        ("velocity", trajectory.velocities, _FASTEST),
    ):
        farthest = max((at for row in table for at in row), key=abs)
        if abs(farthest) > most:
            raise BadArgument(name, farthest, f"a number up to {most:g}")


def displacement(body: Object, trajectory: Trajectory) -> tuple[str, float, float] | None:
    """Return a coordinate that isn't at its trajectory's start, with the start and the present position.

    Start and position are in rad or m. The result is None if all coordinates are near enough for motors to follow.
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
    rows = zip(trajectory.coordinates, trajectory.positions[0], now, off, near, strict=True)
    return next(((name, start, at) for name, start, at, distance, limit in rows if distance > limit), None)


def _touching(body: Object, joint: str) -> list[CollisionPair]:
    """Return the contacts of a joint's moving links, with loads in the last step, the strongest first."""
    movers: dict[Object, set[str]] = {body: set(attachment.moved_links(body.urdf, [joint]))}
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


_NEAR: Final = 0.001  # minimum distance in m between coasting and other bodies, apart from the way in the interval
_ALONG: Final = 0.05  # maximum distance in m between the boxes of two moving links that may move together
_RIGID: Final = (5e-3, 5e-2)  # largest relative motion in m and rad of links that move together


class Coasting:
    """Decides whether those bodies of a world that follow trajectories may coast."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._detector: simulation.RestDetector | None = None
        self._state: tuple[object, ...] = ()  # state of the world after the last interval
        self._following: Sequence[tuple[Object, Sequence[str]]] = ()
        self._furniture: Sequence[Object] = ()  # furniture that follows trajectories
        self._rows: list[tuple[Object, str]] = []  # the moving links
        self._moving: list[tuple[LoadedBody, str]] = []  # the moving links with the bodies in the engine
        self._columns: list[tuple[Object, str]] = []  # all links
        self._numbers: list[int] = []  # indices of the moving links among all links
        self._possible: NDArray[np.bool_] = np.zeros((0, 0), bool)  # pairs (moving link, link) that may collide
        self._boxes = np.zeros((0, 2, 3))  # bounds of all links, m
        self._before = np.zeros((0, 2, 3))  # bounds of the moving links at the start of the interval, m
        self._along: dict[tuple[int, int], Pose] = {}  # relative poses at the start of hands, handles and so on
        self._clear = np.zeros(0)  # distances in m between moving and other links at the end of the last interval
        self._is_clear = False  # whether the moving links had a free space at the end of the last interval

    def may_begin(self, following: Sequence[tuple[Object, Sequence[str]]]) -> bool:
        """Return whether all other bodies rest, and nothing is near the moving links at the start of an interval.

        ``following`` has the bodies that follow trajectories, with the moving joints of each; no joints for a base.
        """
        furniture = [body for body, _ in following if not body.is_robot]
        if list(following) != self._following:
            self._following, self._rows = list(following), []
        if self._detector is None or self._state != self._present():
            self._detector, self._rows = simulation.RestDetector(self._world, furniture), []
        elif furniture != self._furniture:  # a body that has coasted to the end of its trajectory is at rest
            self._detector.ignore(furniture, stopped=self._is_clear)
        self._furniture = furniture
        if not self._detector.sample():
            self._rows = []
            return False
        if not self._rows:
            self._find_pairs()
            self._is_clear = False
        if not self._is_clear:
            self._before = self._moving_boxes()
            near = self._overlap(self._before, np.full(len(self._rows), _ALONG))[:, self._numbers]
            pairs = [(row, self._numbers[moving]) for row, moving in np.argwhere(near).tolist()]
            self._along = {pair: self._relative(*pair) for pair in pairs}
            self._clear = np.full(len(self._rows), _NEAR)
            self._is_clear = not self._is_near(self._before, self._clear)
        return self._is_clear

    def may_end(self) -> bool:
        """Return whether nothing is near the moving links at the end of an interval, after they were moved there."""
        after = self._moving_boxes()
        way = np.abs(after - self._before).max(axis=(1, 2), initial=0.0)
        if len({body for body, _ in self._following}) == 1:  # the sum of both distances is larger than the way
            way = np.maximum(way / 2, way - self._clear)
        self._clear = way + _NEAR
        self._is_clear = not self._is_near(after, self._clear)
        self._before = after
        if self._is_clear:
            self._state = self._present()
        return self._is_clear

    def simulated(self) -> None:
        """Store the state of the world after an interval that the engine simulated."""
        self._state, self._rows = self._present(), []

    def _present(self) -> tuple[object, ...]:
        """Return the state of the world, without the poses of carried objects."""
        world = self._world
        return (
            *world.gravity,
            *(
                (body, *body.attachments.values(), None if body.carrier else world.engine.snapshot(body.handle))
                for body in world.objects
            ),
        )

    def _find_pairs(self) -> None:
        objects = self._world.objects
        self._columns = [(body, link) for body in objects for link in body.links]
        boxes = self._world.engine.boxes((body.handle, link) for body, link in self._columns)
        self._boxes = np.array(boxes).reshape(-1, 2, 3)
        has_shape = np.ptp(self._boxes, axis=1).max(axis=1) > 0.0
        moved: dict[tuple[Object, str], bool] = {}  # moving links, and whether a base moves each of them
        for body, joints in self._following:
            moved |= dict.fromkeys(_moving(body, joints), not joints)
        self._rows = [each for each, shaped in zip(self._columns, has_shape, strict=True) if shaped and each in moved]
        self._moving = [(body.handle, link) for body, link in self._rows]
        numbers = {each: number for number, each in enumerate(self._columns)}
        self._numbers = [numbers[each] for each in self._rows]
        roots = {body: attachment.root_of(body) for body in objects}
        turning = {body: {*attachment.moved_links(body.urdf, body.urdf.movable)} for body in objects}
        still = [body.is_environment and link not in turning[body] for body, link in self._columns]
        others = np.array([[roots[body] is not roots[other] for other, _ in self._columns] for body, _ in self._rows])
        driving = np.array([moved[each] for each in self._rows])  # paths of bases were checked before
        self._possible = others.reshape(-1, len(self._columns)) & has_shape & ~(driving[:, None] & np.array(still))

    def _moving_boxes(self) -> Array:
        boxes = np.array(self._world.engine.boxes(self._moving)).reshape(-1, 2, 3)
        self._boxes[self._numbers] = boxes
        return boxes

    def _overlap(self, rows: Array, distances: Array) -> NDArray[np.bool_]:
        """Return which pairs of a moving link and a link have boxes nearer to each other than a distance in m."""
        overlap = self._possible.copy()
        low, high = rows[:, 0] - distances[:, None], rows[:, 1] + distances[:, None]
        for axis in range(3):
            overlap &= low[:, axis, None] <= self._boxes[:, 1, axis]
            overlap &= self._boxes[:, 0, axis] <= high[:, axis, None]
        return overlap

    def _is_near(self, rows: Array, distances: Array) -> bool:
        """Return whether a link is nearer to a moving link than a distance in m, unless both links move together."""
        for row, column in zip(*np.nonzero(self._overlap(rows, distances)), strict=True):
            (body, link), (other, other_link) = self._rows[row], self._columns[column]
            if self._world.engine.link_closest_points(
                body.handle, link, other.handle, float(distances[row]), link_b=other_link
            ) and not self._is_rigid(row, column):
                return True
        return False

    def _relative(self, row: int, column: int) -> Pose:
        links = self._rows[row], self._columns[column]
        moving, other = (self._world.engine.link_pose(body.handle, link) for body, link in links)
        return geometry.multiply(geometry.invert(moving), other)

    def _is_rigid(self, row: int, column: int) -> bool:
        """Return whether two moving links have the same relative pose as at the start."""
        was = self._along.get((row, column))
        if was is None:
            return False
        now = self._relative(row, column)
        return math.dist(was[0], now[0]) < _RIGID[0] and geometry.angle(was[1], now[1]) < _RIGID[1]


def _moving(body: Object, joints: Sequence[str]) -> Iterator[tuple[Object, str]]:
    """Yield the links that a trajectory moves, also of carried objects."""
    links = attachment.moved_links(body.urdf, joints) if joints else body.links
    yield from ((body, link) for link in links)
    for held in body.carried:
        if held.carrier_link in links:
            yield from _moving(held.body, ())
