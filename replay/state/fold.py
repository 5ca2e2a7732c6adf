"""Folds records into states: each world's last keyframe, then the effects up to a step. No physics runs.

Effects hold the values that were read back from the engine, with all bits. So a state is exact, and the fold from the
start equals the fold from any keyframe.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from typing import TYPE_CHECKING, Final

from recorder.records import STEPS_PER_SECOND, Belief, Following, Keyframe, Mutation, Query, argument_values, beliefs
from recorder.records.motion import has_ended
from replay.errors import Damaged
from replay.file.lifetimes import closes_world
from replay.file.repair import range_text
from replay.state.state import Attachment, Body, RecordedBelief, Sampled, State, World

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from recorder import records
    from recorder.geometry import Quaternion, Vector
    from replay.file.lifetimes import Lifetime
    from replay.file.record_reader import RecordReader

FAR: Final = 1e9
"""The largest number in a state, m, rad, m/s or rad/s: an object at 1e6 m may fall for hours."""

CHANGES: Final = (Mutation, Keyframe, Query)
"""The records that change a state. A query changes the state if it updates a robot's beliefs."""

_NOWHERE: Final = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))  # the pose of a body whose loading is lost
_AT_REST: Final = (0.0,) * 6
_SHORTEST, _LONGEST = 0.99, 1.01  # squared lengths of a unit quaternion


def fold(all_records: Iterable[records.Record], step: int = -1) -> State:
    """Return the state after records that begin with the opening or a keyframe of each world.

    The state's step is at least the step of the last record; other records only count as steps.
    """
    worlds: dict[str, WorldBuilder] = {}
    for record in all_records:
        step = max(step, record.seq)
        apply(worlds, record)
    return State(step, {name: world.build() for name, world in worlds.items()})


def state_at(log: RecordReader, step: int, moment: float | None = None) -> State:
    """Return the state after a step of a recording.

    If the next record is a simulation and contains the moment (s of simulated time), return the state at that moment
    by the record's samples.

    Raises:
        Damaged: a record is inconsistent.
    """
    worlds: dict[str, WorldBuilder] = {}
    first = step
    for lifetime in log.lifetimes:
        if lifetime.has(step):  # otherwise it isn't open yet, or its name was reused
            first = min(first, _fold_lifetime(log, lifetime, step, worlds))
    lost = ", ".join(range_text(gap) for gap in log.lost() if first < gap.stop and gap.start <= step)
    uncertainty = f"the changes of steps {lost} are lost" if lost else ""
    sampled = _apply_samples(log, step + 1, worlds, moment) if moment is not None else None
    return State(step, {name: world.build() for name, world in worlds.items()}, uncertainty, log.assets, sampled)


def _apply_samples(log: RecordReader, step: int, worlds: dict[str, WorldBuilder], moment: float) -> Sampled | None:
    """Bring a world to a moment within a record's stretch of simulation; return None if the record lacks the moment."""
    record = next(iter(log.records(Mutation, step, step + 1)), None)
    if record is None or not record.HasField("simulate") or record.world not in worlds:
        return None
    world, limit = worlds[record.world], moment * STEPS_PER_SECOND
    start = at = world.sim_step
    if not start < limit < record.sim_step:
        return None
    for sample in record.effect.samples:
        if sample.sim_step <= limit:
            world.apply_sample(sample)
            at = sample.sim_step
    begin, end, last = (steps / STEPS_PER_SECOND for steps in (start, record.sim_step, at))
    return Sampled(step, record.world, begin, end, moment, last)


def _fold_lifetime(log: RecordReader, lifetime: Lifetime, step: int, worlds: dict[str, WorldBuilder]) -> int:
    """Fold a world's records from its last keyframe up to a step; return the first step that was needed."""
    end = log.chunk_of(step)
    base = _last_keyframe(log, lifetime, step)
    begin = lifetime.changes[0] if base is None else log.chunk_of(base.seq)
    start = lifetime.start if base is None else base.seq
    numbers = lifetime.changes, lifetime.looks
    chunks = sorted({number for each in numbers for number in each[bisect_left(each, begin) : bisect_right(each, end)]})
    for record in log.records_of(lifetime, CHANGES, chunks):
        if start <= record.seq <= step:
            try:
                apply(worlds, record)
            except (ValueError, IndexError) as error:
                raise Damaged(log.path, f"step {record.seq}", str(error)) from error
    if lifetime.world in worlds:
        worlds[lifetime.world].lifetime = lifetime.number
    return start if chunks else step


def _last_keyframe(log: RecordReader, lifetime: Lifetime, step: int) -> Keyframe | None:
    for at in range(bisect_right(lifetime.keyframes, log.chunk_of(step)) - 1, -1, -1):
        frames = [frame for frame in log.records_of(lifetime, Keyframe, [lifetime.keyframes[at]]) if frame.seq <= step]
        if frames:
            return frames[-1]
    return None


def apply(worlds: dict[str, WorldBuilder], record: records.Record) -> None:
    """Apply a record to worlds, by name; records that don't change worlds are ignored."""
    name, before = record.world, worlds.get(record.world)
    if isinstance(record, Query) and before is not None and beliefs.is_look(record):
        before.look(record)
    if not isinstance(record, Mutation | Keyframe):
        return
    lifetime = before.lifetime if before is not None else 1
    if isinstance(record, Keyframe):
        worlds[name] = WorldBuilder.of_keyframe(record)
    elif record.HasField("open_world"):
        worlds.pop(name, None)  # keeps the order of opening if a name is reused
        worlds[name] = WorldBuilder(name, record.open_world.mode)
        lifetime += before is not None
    elif before is None:
        worlds[name] = WorldBuilder(name)
    worlds[name].lifetime = lifetime
    if isinstance(record, Mutation):
        worlds[name].apply(record)


class WorldBuilder:
    """A mutable :class:`replay.state.state.World`, built record by record."""

    def __init__(self, name: str, mode: str = "DIRECT") -> None:
        self.name = name
        self.mode = mode
        self.lifetime = 1
        self.open = True
        self.sim_step = 0
        self.gravity: Vector = (0.0, 0.0, 0.0)
        self.realtime = False
        self.robot = ""
        self.bodies: dict[str, _BodyBuilder] = {}
        self.attachments: dict[tuple[str, str], Attachment] = {}
        self.following: dict[int, Following] = {}
        self.beliefs: beliefs.Beliefs = {}

    @classmethod
    def of_keyframe(cls, frame: Keyframe) -> WorldBuilder:
        """Return the world of a keyframe."""
        world = cls(frame.world, frame.mode)
        world.sim_step = frame.sim_step
        if frame.gravity:
            world.gravity = _vector(frame.gravity)
        world.realtime = frame.realtime
        world.robot = frame.robot
        world.bodies = {loaded.body: _BodyBuilder(loaded) for loaded in frame.loaded}
        world._set_states(frame.bodies)
        world._attach(frame.attachments)
        world.following = {each.begin.number: each for each in frame.following}
        beliefs.restore(world.beliefs, frame.beliefs)
        return world

    def build(self) -> World:
        """Return its current state."""
        bodies = {name: body.build() for name, body in self.bodies.items()}
        return World(
            self.name,
            self.open,
            self.mode,
            self.sim_step,
            self.gravity,
            self.realtime,
            self.robot,
            self.lifetime,
            bodies,
            dict(self.attachments),
            dict(self.following),
            {key: _belief(belief, bodies) for key, belief in self.beliefs.items() if key[1] in bodies},
        )

    def look(self, record: Query) -> None:
        """Apply a query that updates a robot's beliefs."""
        beliefs.look(self.beliefs, argument_values(record.evidence), record.sim_step, record.seq)

    def apply(self, record: Mutation) -> None:
        """Apply a mutation: its command, as far as the effect lacks the change, then its effect."""
        self.sim_step = record.sim_step
        command = record.WhichOneof("command")
        if command == "load_body":
            self.bodies[record.load_body.body] = _BodyBuilder(record.load_body)
        elif command == "set_gravity":
            self.gravity = _vector(record.set_gravity.gravity)
        elif command == "set_realtime":
            self.realtime = record.set_realtime.enabled
        elif command == "set_robot":
            self.robot = record.set_robot.body
        elif command == "restore":
            self.gravity, self.robot = _vector(record.restore.gravity), record.restore.robot
        elif command == "set_color":
            painted = self.bodies.get(record.set_color.body)
            if painted is not None:
                painted.color = tuple(record.set_color.color)
        elif command == "close_world":
            self.bodies.clear()
            self.attachments.clear()
            self.open, self.realtime, self.robot = False, False, ""
        self._follow(command, record)
        self._apply_effect(record.effect)
        self._believe(record)

    def _believe(self, record: Mutation) -> None:
        effect = record.effect
        carriers = None
        if effect.attached or effect.detached:
            carriers = {body: carrier for carrier, body in self.attachments}
        beliefs.follow(
            self.beliefs,
            record,
            record.sim_step,
            record.seq,
            removed=effect.removed,
            carriers=carriers,
            robots=[name for name, body in self.bodies.items() if body.loaded.type == "robot"] if carriers else (),
            pose_of=lambda name: (known.position, known.orientation) if (known := self.bodies.get(name)) else _NOWHERE,
        )

    def _follow(self, command: str | None, record: Mutation) -> None:
        if command == "begin_trajectory":
            begin = record.begin_trajectory
            self.following[begin.number] = Following(begin=begin, began=record.sim_step)
        elif command == "stop_trajectory":
            number = record.stop_trajectory.number
            known = self.following.pop(number, None)
            # a trajectory whose beginning is lost stays unknown; a trajectory that hasn't moved yet ends
            if known is not None and known.began < self.sim_step:
                self.following[number] = stopped = Following(begin=known.begin, began=known.began)
                stopped.stopped = known.stopped or self.sim_step
        elif command == "simulate":
            for driven in record.simulate.driven:
                if driven.ended:
                    self.following.pop(driven.number, None)
        elif command in ("reset", "restore", "close_world"):
            self.following.clear()

    def apply_sample(self, sample: records.Sample) -> None:
        """Apply a sample of a simulation."""
        self.sim_step = sample.sim_step
        self._set_states(sample.bodies)
        self.following = {at: each for at, each in self.following.items() if not has_ended(each, sample.sim_step)}

    def _apply_effect(self, effect: records.Effect) -> None:
        for ended in effect.detached:
            self.attachments.pop((ended.carrier, ended.body), None)
        for name in effect.removed:
            self.bodies.pop(name, None)
            for pair in [pair for pair in self.attachments if name in pair]:
                del self.attachments[pair]
            if self.robot == name:
                self.robot = ""
            self.following = {at: each for at, each in self.following.items() if each.begin.body != name}
        self._attach(effect.attached)
        self._set_states(effect.bodies)

    def _attach(self, attachments: Iterable[records.Attachment]) -> None:
        for held in attachments:
            pose = _vector(held.position), _quaternion(held.orientation)
            attachment = Attachment(held.carrier, held.carrier_link, held.body, held.body_link, *pose)
            self.attachments[held.carrier, held.body] = attachment

    def _set_states(self, states: Iterable[records.BodyState]) -> None:
        """Set the states of bodies; a body whose loading is lost stays unknown."""
        for state in states:
            if state.body in self.bodies:
                self.bodies[state.body].set_state(state)


class _BodyBuilder:
    __slots__ = ("color", "joint_velocities", "joints", "loaded", "orientation", "position", "velocity")

    def __init__(self, loaded: records.LoadBody) -> None:
        self.loaded = loaded
        self.position: Vector = _vector(loaded.position) if loaded.position else (0.0, 0.0, 0.0)
        self.orientation: Quaternion = _quaternion(loaded.orientation) if loaded.orientation else (0.0, 0.0, 0.0, 1.0)
        self.velocity: tuple[float, ...] = _AT_REST
        self.joints = dict.fromkeys(loaded.joints, 0.0)
        self.joint_velocities = dict.fromkeys(loaded.joints, 0.0)
        self.color = tuple(loaded.color)

    def set_state(self, state: records.BodyState) -> None:
        if state.position:
            self.position, self.velocity = _vector(state.position), _AT_REST
        if state.orientation:
            self.orientation = _quaternion(state.orientation)
        if state.velocity:
            self.velocity = tuple(_checked_numbers(state.velocity))
            if len(self.velocity) != len(_AT_REST):
                raise ValueError(f"a velocity has {len(self.velocity)} numbers")
        if state.joints:
            names = state.joints[:]
            speeds = _checked_numbers(state.joint_velocities) or [0.0] * len(names)
            self.joints.update(zip(names, _checked_numbers(state.joint_positions), strict=True))
            self.joint_velocities.update(zip(names, speeds, strict=True))

    def build(self) -> Body:
        return Body(
            self.loaded.body,
            self.loaded.type,
            self.loaded,
            self.position,
            self.orientation,
            self.velocity,
            dict(self.joints),
            dict(self.joint_velocities),
            self.color,
        )


def _belief(belief: Belief, bodies: Mapping[str, Body]) -> RecordedBelief:
    """Return a belief as data; the pose of a held object is its true pose."""
    body = bodies[belief.object]
    held = belief.source == Belief.HELD
    pose = body.pose if held else (_vector(belief.position), _quaternion(belief.orientation))
    return RecordedBelief(belief.robot, belief.object, *pose, beliefs.word(belief.source), belief.sim_step, belief.step)


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = numbers = values[:]
    if not (-FAR <= x <= FAR and -FAR <= y <= FAR and -FAR <= z <= FAR):
        raise _beyond(numbers)
    return x, y, z


def _quaternion(values: Sequence[float]) -> Quaternion:
    x, y, z, w = values[:]
    if not _SHORTEST <= x * x + y * y + z * z + w * w <= _LONGEST:
        raise ValueError(f"{[x, y, z, w]} isn't a unit quaternion")
    return x, y, z, w


def _checked_numbers(values: Sequence[float]) -> Sequence[float]:
    """Return finite numbers within ``FAR``; with other numbers the engine would loop."""
    numbers = values[:]
    if numbers and not (min(numbers) >= -FAR and max(numbers) <= FAR and math.isfinite(sum(numbers))):
        raise _beyond(numbers)
    return numbers


def _beyond(numbers: Sequence[float]) -> ValueError:
    return ValueError(f"the numbers {numbers[:4]} are not finite, or beyond {FAR:g}")


def last_open_step(log: RecordReader, step: int, name: str | None = None) -> int:
    """Return the last step, up to a step, at which a world was open; with a name, the world of that name."""
    worlds = state_at(log, step).worlds
    if any(world.open for world in worlds.values() if name in (None, world.name)):
        return step
    lives = [lifetime for lifetime in log.lifetimes if name in (None, lifetime.world)]
    ends = {record.seq for record in map(log.end_of, lives) if record is not None and closes_world(record)}
    end = max((seq for seq in ends if seq <= step), default=step + 1)
    while end - 1 in ends:  # the end of a plan closes all worlds one after another
        end -= 1
    return end - 1
