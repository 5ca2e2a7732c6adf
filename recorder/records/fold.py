"""Fold records into worlds: each world is its last keyframe, changed by the effects that follow.

Effects have the exact values of the engine, so folded worlds are exact. No physics runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder import records
from recorder.records import Following, Keyframe, Mutation, Query, argument_values, beliefs
from recorder.records.motion import has_ended

if TYPE_CHECKING:
    from recorder.geometry import Quaternion, Vector

FAR: Final = 1e9  # largest number in a state (m, rad, m/s or rad/s), more than after hours of falling

_NOWHERE: Final = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))  # pose of a body if the record of its loading is missing
_AT_REST: Final = (0.0,) * 6
_SHORTEST, _LONGEST = 0.99, 1.01  # range for the squared length of a unit quaternion


@dataclass(frozen=True, slots=True)
class Attachment:
    """The attachment of a body to its carrier."""

    carrier: str
    carrier_link: str  # link of the carrier; "" for the base
    body: str
    body_link: str  # link of the body; "" for the base
    position: Vector  # position of the carried body's base in the carrier's link, m
    orientation: Quaternion  # orientation of the carried body's base in the carrier's link, xyzw
    loose: bool = False  # whether the body only lies in or on the carrier, and is released with it


def apply(worlds: dict[str, FoldedWorld], record: records.Record) -> None:
    """Apply a record to worlds by name. Records that don't change worlds are ignored."""
    name, before = record.world, worlds.get(record.world)
    if isinstance(record, Query) and before is not None and beliefs.is_look(record):
        before.look(record)
    if not isinstance(record, Mutation | Keyframe):
        return
    lifetime = before.lifetime if before is not None else 1
    if isinstance(record, Keyframe):
        worlds[name] = FoldedWorld.of_keyframe(record)
    elif record.HasField("open_world"):
        worlds.pop(name, None)  # if a name is reused, worlds must stay in the order of opening
        worlds[name] = FoldedWorld(name, record.open_world.mode)
        lifetime += before is not None
    elif before is None:
        worlds[name] = FoldedWorld(name)
    worlds[name].lifetime = lifetime
    if isinstance(record, Mutation):
        worlds[name].apply(record)


class FoldedWorld:
    """The state of a world, changed record by record."""

    def __init__(self, name: str, mode: str = "DIRECT") -> None:
        self.name = name
        self.mode = mode
        self.lifetime = 1
        self.open = True
        self.sim_step = 0
        self.gravity: Vector = (0.0, 0.0, 0.0)
        self.realtime = False
        self.robot = ""
        self.bodies: dict[str, FoldedBody] = {}
        self.attachments: dict[tuple[str, str], Attachment] = {}
        self.following: dict[int, Following] = {}
        self.beliefs: beliefs.Beliefs = {}

    @classmethod
    def of_keyframe(cls, frame: Keyframe) -> FoldedWorld:
        """Return the world of a keyframe."""
        world = cls(frame.world, frame.mode)
        world.sim_step = frame.sim_step
        if frame.gravity:
            world.gravity = vector(frame.gravity)
        world.realtime = frame.realtime
        world.robot = frame.robot
        world.bodies = {loaded.body: FoldedBody(loaded) for loaded in frame.loaded}
        world._set_states(frame.bodies)
        world._attach(frame.attachments)
        world.following = {each.begin.number: each for each in frame.following}
        beliefs.restore(world.beliefs, frame.beliefs)
        return world

    def look(self, record: Query) -> None:
        """Apply a query that updates the beliefs of a robot."""
        beliefs.look(self.beliefs, argument_values(record.evidence), record.sim_step, record.seq)

    def apply(self, record: Mutation) -> None:
        """Apply the command of a mutation, and then its effect. For some changes, only the command has the data."""
        self.sim_step = record.sim_step
        command = record.WhichOneof("command")
        if command == "load_body":
            self.bodies[record.load_body.body] = FoldedBody(record.load_body)
        elif command == "set_gravity":
            self.gravity = vector(record.set_gravity.gravity)
        elif command == "set_realtime":
            self.realtime = record.set_realtime.enabled
        elif command == "set_robot":
            self.robot = record.set_robot.body
        elif command == "restore":
            self.gravity, self.robot = vector(record.restore.gravity), record.restore.robot
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
            # a trajectory without a recorded beginning stays unknown; a trajectory whose body hasn't moved yet ends
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
            pose = vector(held.position), quaternion(held.orientation)
            attachment = Attachment(held.carrier, held.carrier_link, held.body, held.body_link, *pose, held.loose)
            self.attachments[held.carrier, held.body] = attachment

    def _set_states(self, states: Iterable[records.BodyState]) -> None:
        """Set the states of bodies. Bodies without the record of their loading are skipped."""
        for state in states:
            if state.body in self.bodies:
                self.bodies[state.body].set_state(state)


class FoldedBody:
    """The state of a body, with the fields of :class:`replay.state.state.Body`."""

    __slots__ = ("color", "joint_velocities", "joints", "loaded", "orientation", "position", "velocity", "version")

    def __init__(self, loaded: records.LoadBody) -> None:
        self.loaded = loaded
        self.position: Vector = vector(loaded.position) if loaded.position else (0.0, 0.0, 0.0)
        self.orientation: Quaternion = quaternion(loaded.orientation) if loaded.orientation else (0.0, 0.0, 0.0, 1.0)
        self.velocity: tuple[float, ...] = _AT_REST
        self.joints = dict.fromkeys(loaded.joints, 0.0)
        self.joint_velocities = dict.fromkeys(loaded.joints, 0.0)
        self.color = tuple(loaded.color)
        self.version = 0  # number of changes of the body's state

    def set_state(self, state: records.BodyState) -> None:
        """Set those fields of the body that a record contains."""
        self.version += 1
        if state.position:
            self.position, self.velocity = vector(state.position), _AT_REST
        if state.orientation:
            self.orientation = quaternion(state.orientation)
        if state.velocity:
            self.velocity = tuple(_checked_numbers(state.velocity))
            if len(self.velocity) != len(_AT_REST):
                raise ValueError(f"a velocity has {len(self.velocity)} numbers")
        if state.joints:
            names = state.joints[:]
            speeds = _checked_numbers(state.joint_velocities) or [0.0] * len(names)
            self.joints.update(zip(names, _checked_numbers(state.joint_positions), strict=True))
            self.joint_velocities.update(zip(names, speeds, strict=True))


def vector(values: Sequence[float]) -> Vector:
    """Return three numbers. Numbers beyond ``FAR`` raise ValueError."""
    x, y, z = numbers = values[:]
    if not (-FAR <= x <= FAR and -FAR <= y <= FAR and -FAR <= z <= FAR):
        raise _beyond(numbers)
    return x, y, z


def quaternion(values: Sequence[float]) -> Quaternion:
    """Return a unit quaternion. Numbers that aren't a unit quaternion raise ValueError."""
    x, y, z, w = values[:]
    if not _SHORTEST <= x * x + y * y + z * z + w * w <= _LONGEST:
        raise ValueError(f"{[x, y, z, w]} isn't a unit quaternion")
    return x, y, z, w


def _checked_numbers(values: Sequence[float]) -> Sequence[float]:
    """Return finite numbers within ``FAR``. Other lengths raise ValueError, because the engine would loop forever."""
    numbers = values[:]
    if numbers and not (min(numbers) >= -FAR and max(numbers) <= FAR and math.isfinite(sum(numbers))):
        raise _beyond(numbers)
    return numbers


def _beyond(numbers: Sequence[float]) -> ValueError:
    return ValueError(f"the numbers {numbers[:4]} are infinite, undefined or beyond {FAR:g}")
