"""An object fell, tipped or moved in simulation; the cause lists those changes by the plan that let the object move.

The motion of an object is measured from the plan's last change of the object or the last success with the object. If
the object wasn't at rest after the change, the change let the object move. Otherwise, later changes near the resting
object let it move.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from recorder import geometry
from recorder.geometry import Pose
from recorder.records import STEPS_PER_SECOND, Mutation
from replay.errors import NoSuchName
from replay.explain.causes import trials
from replay.explain.causes.case import Cause, CausingChange, FailureCase, about, objects_in, result
from replay.explain.causes.raised import compared
from replay.history.blame import commanded, is_physics
from replay.history.source import Line
from replay.report import phrases
from replay.state.fold import state_at
from replay.state.state import Body, State

if TYPE_CHECKING:
    from replay.explain.causes.trials import Trial

_MOVED: Final = 0.05  # distance in m below which a moved object only settles
_TILTED: Final = math.radians(15)
_FELL: Final = 0.05  # minimum downward distance in m of an object that fell
_PART: Final = 0.3  # share of an object's displacement after which it has begun to fall or move
_NEAR: Final = 0.6  # maximum distance in m between the bases of an object and its possible support
_ABOVE: Final = 0.15  # maximum distance in m between the bases of stacked objects on the ground
_PUSHED: Final = 0.35  # maximum distance in m between an object and the frame of a link that may push it
_QUIET: Final = STEPS_PER_SECOND // 10  # number of steps without motion after which an object is at rest
_WANTED: Final = ("pick-up", "place", "detecting", "world-state-detecting", "looking")
_MAX_LETS: Final = 3
#: Verbs for the effects of commands on the object. Other commands move the object itself.
_HOW: Final = {
    "load_body": "load",
    "detach_body": "detached",
    "attach_body": "attached",
    "remove_body": "detached",
    "move_joints": "along",
}
_FAST: Final = 0.1  # speed in m/s below which a release doesn't mention it
_SPINNING: Final = 1.0  # angular speed in rad/s below which a release doesn't mention it


@dataclass(frozen=True, slots=True)
class Physics(Cause):
    """An object fell, tipped or moved in simulation."""

    kind = "physics"
    explained_by = ("written",)  # the plan compares a part of the pose that the motion didn't change
    body: str
    how: str  # the object's motion: "fell", "tipped" or "moved"
    distance: float  # length of the motion in m
    fall: float  # downward part of the motion in m
    tilt: float  # increase in rad of the object's lean
    moved_at: int  # step of the simulation in which the motion began
    line: Line | None  # the plan's line of the simulation
    since: int  # step of the last success with the object, or of its last change, before it moved
    stood_on: str = ""  # support of the object that was moved; "" if none was
    lets: tuple[CausingChange, ...] = ()  # changes that may have let the object move; empty if only time passed
    speed: float | None = None  # speed in m/s at the release; None if it wasn't released
    spin: float | None = None  # angular speed in rad/s at the release; None if it wasn't released
    hand: str = ""  # arm that released the object; "" if none did

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Physics]:
        """Yield the objects of the failure that physics moved."""
        for name in dict.fromkeys((*case.mentioned, *(name for name, _ in compared(case)))):
            if case.free_body(name) is not None and case.world is not None and case.world.carrier(name) is None:
                fate = _Fate(case, name)
                if fate.base is not None:
                    yield from fate.explained()

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials without those changes that let the object move, and with the object at its earlier place."""
        if self.moved_at >= case.began:  # a fork can't change the world within the failed motion
            for name in case.mentioned:
                yield from trials.away(case, name) if name not in case.subjects else ()
            return
        for change in self.lets:
            yield from trials.put_back(case, change)
        for trial in trials.restored(case, [self.body], self.since, case.began):
            yield replace(trial, decisive=not self.lets)  # an earlier change may already have tilted the object

    def _words(self) -> Iterator[str]:
        size = f"by {phrases.length(self.fall if self.how == 'fell' else self.distance)}"
        if self.tilt >= math.radians(1):
            size += f" and tilted by {math.degrees(self.tilt):.0f} degrees"
        at = f" at {phrases.place(self.line)}" if self.line is not None else ""
        yield f"{self.body} {self.how} {size} in the simulation of step {self.moved_at}{at}{self._let()}"
        if len(self.lets) > 1 and not self.stood_on:
            yield "possible causes:"
        yield from (change.row for change in self.lets)

    def _let(self) -> str:
        released = next((change for change in self.lets if change.how == "detached"), None)
        if self.stood_on:
            fate = "removed" if any(change.how == "removed" for change in self.lets) else "moved away"
            return f": its support {self.stood_on} was {fate}"
        if released is None:
            return f", after {self.lets[0]}" if len(self.lets) == 1 else ""
        hand = f"the {self.hand} gripper's hold" if self.hand and " " not in self.hand else "its hold"
        motion = []
        if self.spin is not None and self.spin >= _SPINNING:
            motion.append(f"turning at {self.spin:.0f} rad/s")
        if self.speed is not None and self.speed >= _FAST:
            motion.append(f"moving at {self.speed:.1f} m/s")
        return f": it left {hand} at step {released.step}" + (f" while {' and '.join(motion)}" if motion else "")


class _Fate:
    """The motion of an object in simulation since the plan's last change of the object.

    ``base`` is the record of that change. ``since`` is the step of that change, or of a later success with the object.
    ``moves`` are the later simulations that moved the object.
    """

    def __init__(self, case: FailureCase, name: str) -> None:
        self._case, self._name = case, name
        self._world = case.world.name if case.world is not None else ""
        self.base: Mutation | None = None
        self.moves: list[Mutation] = []
        for record in case.log.backwards(case.step, Mutation, naming=name):
            if record.world != self._world:
                continue
            if name in record.effect.removed:
                break
            gripped = [*record.effect.attached, *record.effect.detached]
            grips = record.HasField("attach_body") or record.HasField("detach_body") or record.HasField("remove_body")
            touches = self._pose_in(record) or (grips and any(each.body == name for each in gripped))
            if not is_physics(record) and touches:
                self.base = record
                break
            if is_physics(record) and self._pose_in(record):
                self.moves.insert(0, record)
        successes = (
            motion.last_step
            for motion in case.failed.motions
            if motion.name in _WANTED and not motion.failed and motion.last_step < case.began
            if about(motion, body=name) or name in objects_in(result(motion))
        )
        base = self.base.seq if self.base is not None else 0
        self.since = max(base, max(successes, default=0))
        self.moves = [record for record in self.moves if record.seq > self.since]

    def explained(self) -> Iterator[Physics]:
        """Yield a motion larger than settling, with the changes that let the object move."""
        before, after = self._pose(self.since), self._pose(self._case.step)
        if before is None or after is None or not self.moves:
            return
        distance, fall = math.dist(before[0], after[0]), before[0][2] - after[0][2]
        tilt = geometry.lean(after[1], before[1])
        # a motion that placed the object has let it settle
        is_outcome = self._name in self._case.subjects and self._case.data.get("rest") is not None
        if distance < _MOVED and tilt < _TILTED and not is_outcome:
            return
        shifts = [_shift(self._pose(record.seq - 1), self._pose(record.seq)) for record in self.moves]
        first = next(record for record, shift in zip(self.moves, shifts, strict=True) if shift >= _PART * max(shifts))
        lets, support = self._lets(first), self._support(first)
        if support:
            lets = tuple(change for change in lets if change.body == support)
        released = next((change for change in lets if change.how == "detached"), None)
        speed, spin = self._velocity(released.step, first) if released is not None else (None, None)
        hand = self._case.holder(self._name, released.step - 1) if released is not None else ""
        how = "fell" if fall > _FELL else "tipped" if tilt >= _TILTED else "moved"
        steps, line = self._case.steps(self.since, first.seq, *lets), self._case.line_of(first)
        yield Physics(
            steps, self._name, how, distance, fall, tilt, first.seq, line, self.since, support, lets, speed, spin, hand
        )

    def _lets(self, first: Mutation) -> tuple[CausingChange, ...]:
        """Return the changes that may have let the object move in a simulation."""
        assert self.base is not None  # noqa: S101  for mypy
        case, start, candidates = self._case, self.base.seq, []
        for record in case.log.backwards(first.seq - 1, Mutation):
            if record.seq < start:
                break
            if record.world != self._world:
                continue
            if record.seq == start:
                candidates.append(case.change(record, self._name, _HOW.get(record.WhichOneof("command"), "command")))
            elif record.simulate.steps >= _QUIET and not (record in self.moves and self._is_moving(record)):
                break  # after the change, the object was at rest
            elif (change := self._change_near(record)) is not None:
                candidates.append(change)
        if any(each.how == "detached" for each in candidates):
            candidates = [each for each in candidates if each.how == "detached"]
        return tuple(candidates[:_MAX_LETS][::-1])

    def _support(self, first: Mutation) -> str:
        """Return the support that was moved or removed after the object was at rest; "" if there is none."""
        own = self._pose(self.since)
        world = state_at(self._case.log, self.since).worlds.get(self._world)
        if own is None or world is None:
            return ""
        names = {change.body for change in self._lets(first)} & world.bodies.keys() - {self._name, world.robot}
        bodies = (world.bodies[name] for name in names)
        near = (each for each in bodies if math.dist(own[0][:2], each.position[:2]) < _ABOVE)
        heights = {each.name: own[0][2] - each.position[2] for each in near}
        below = (name for name, height in heights.items() if 0 < height < _NEAR)
        return min(below, key=heights.__getitem__, default="")

    def _is_moving(self, record: Mutation) -> bool:
        """Return whether the object moves at the end of a simulation."""
        state = next((each for each in record.effect.bodies if each.body == self._name), None)
        return state is not None and math.hypot(*state.velocity) > _MOVED

    def _change_near(self, record: Mutation) -> CausingChange | None:
        """Return a change of a nearby body that may have supported or pushed the object."""
        case, command = self._case, record.WhichOneof("command")
        if command == "set_gravity":
            return case.change(record, "", "gravity")
        own = self._pose(record.seq - 1)
        names = {state.body for state in record.effect.bodies} | set(record.effect.removed)
        if own is None or command not in ("move_body", "remove_body", "move_joints", "load_body", "detach_body"):
            return None
        states = [state_at(case.log, step) for step in (record.seq - 1, record.seq)]
        for name in sorted(names - {self._name}):
            bodies = [(state, body) for state in states if (body := self._body(state, name)) is not None]
            if len(bodies) == 2 and bodies[0][1].joints:
                near = self._moved_link_near(bodies, own)
            else:
                near = any(math.dist(body.position, own[0]) < _NEAR for _, body in bodies)
            if near:
                own_joints = "joints" if command == "move_joints" else "command"
                how = "removed" if command == "remove_body" else own_joints if commanded(record) == name else "carried"
                return case.change(record, name, how)
        return None

    def _moved_link_near(self, bodies: Sequence[tuple[State, Body]], own: Pose) -> bool:
        try:
            poses = [
                {link: geometry.multiply(body.pose, pose) for link, pose in links.items()}
                for state, body in bodies
                for links in [state.urdf(body).link_poses(body.joints)]
            ]
        except NoSuchName:
            return False
        moved = [link for link, pose in poses[1].items() if math.dist(pose[0], poses[0][link][0]) > 1e-3]
        return any(math.dist(each[link][0], own[0]) < _PUSHED for link in moved for each in poses)

    def _velocity(self, released: int, first: Mutation) -> tuple[float, float]:
        """Return speed and spin of the object at its release or soon after."""
        body = self._body(state_at(self._case.log, released), self._name)
        velocities = [body.velocity] if body is not None else []
        for sample in first.effect.samples[:1]:
            velocities += [tuple(state.velocity) for state in sample.bodies if state.body == self._name]
        spins = [math.hypot(*velocity[3:]) for velocity in velocities if len(velocity) == 6]
        return math.hypot(*velocities[0][:3]) if velocities else 0.0, max(spins, default=0.0)

    def _pose_in(self, record: Mutation) -> bool:
        state = next((each for each in record.effect.bodies if each.body == self._name), None)
        return state is not None and bool(state.position or state.orientation)

    def _body(self, state: State, name: str) -> Body | None:
        world = state.worlds.get(self._world)
        return world.bodies.get(name) if world is not None else None

    def _pose(self, step: int) -> Pose | None:
        body = self._body(state_at(self._case.log, step), self._name)
        return body.pose if body is not None else None


def _shift(before: Pose | None, after: Pose | None) -> float:
    """Return the size of the change of a pose in m. An angle of 1 rad counts as 0.1 m."""
    if before is None or after is None:
        return 0.0
    return math.dist(before[0], after[0]) + 0.1 * geometry.angle(before[1], after[1])
