"""Folds records into states: of each world its last keyframe, then the effects up to a step. No physics runs.

Effects are what was read back when it happened, with all bits; so a state is exact, and folding the records from the
start or from any keyframe gives the same.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation
from replay.errors import Damaged
from replay.state.state import Attachment, Body, State, World

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from recorder import records
    from recorder.geometry import Quaternion, Vector
    from replay.file.lifetimes import Lifetime
    from replay.file.log import Log

_AT_REST: Final = (0.0,) * 6
_OF_WORLDS: Final = (Mutation, Keyframe)


def fold(all_records: Iterable[records.Record], step: int = -1) -> State:
    """The state after records that begin with the opening of each world, or a keyframe of it.

    Args:
        all_records: in order; those that don't change worlds count as steps only.
        step: the step that the state is told to be of; by default that of the last record.
    """
    worlds: dict[str, WorldBuilder] = {}
    for record in all_records:
        step = max(step, record.seq)
        if isinstance(record, Mutation | Keyframe):
            take(worlds, record)
    return State(step, {name: world.frozen() for name, world in worlds.items()})


def state_at(log: Log, step: int) -> State:
    """What is true after a step.

    Args:
        log: the recording.
        step: from 0; names are resolved before (:meth:`replay.recording.Recording.state_at`).

    Raises:
        Damaged: a record makes no sense.
    """
    here = log.chunk_of(step)
    worlds: dict[str, WorldBuilder] = {}
    since = step
    for lifetime in log.lifetimes:
        if not lifetime.has(step):  # it came later, or another one has taken its name since
            continue
        base = _base(log, lifetime, here, step)
        begin = lifetime.changes[0] if base is None else log.chunk_of(base.seq)
        start = lifetime.start if base is None else base.seq
        chunks = lifetime.changes[bisect_left(lifetime.changes, begin) : bisect_right(lifetime.changes, here)]
        if chunks:
            since = min(since, start)
        for record in log.records_of(lifetime, _OF_WORLDS, chunks):
            if start <= record.seq <= step:
                try:
                    take(worlds, record)
                except (ValueError, IndexError) as error:
                    raise Damaged(log.path, f"step {record.seq}", str(error)) from error
        if lifetime.world in worlds:
            worlds[lifetime.world].told["lifetime"] = lifetime.number
    doubt = ", ".join(_range(gap) for gap in log.lost() if since < gap.stop and gap.start <= step)
    return State(
        step,
        {name: world.frozen() for name, world in worlds.items()},
        f"what steps {doubt} changed is lost" if doubt else "",
        log.assets,
    )


def _range(gap: range) -> str:
    return str(gap.start) if len(gap) == 1 else f"{gap.start}-{gap.stop - 1}"


def _base(log: Log, lifetime: Lifetime, here: int, last: int) -> records.Record | None:
    """The last keyframe of a world at or before a step."""
    for at in range(bisect_right(lifetime.keyframes, here) - 1, -1, -1):
        frames = [frame for frame in log.records_of(lifetime, Keyframe, [lifetime.keyframes[at]]) if frame.seq <= last]
        if frames:
            return frames[-1]
    return None


class WorldBuilder:
    """A world in the making; what it holds changes until it is frozen."""

    def __init__(self, name: str, mode: str = "DIRECT") -> None:
        self.told: dict[str, object] = {"name": name, "lifetime": 1, "mode": mode}
        self.bodies: dict[str, _Body] = {}
        self.attachments: dict[tuple[str, str], Attachment] = {}

    def frozen(self) -> World:
        """What it is now."""
        bodies = {name: body.frozen() for name, body in self.bodies.items()}
        return World(**self.told, bodies=bodies, attachments=dict(self.attachments))  # type: ignore[arg-type]

    def attach(self, made: records.Attachment) -> None:
        """Adds an attachment, or changes its relative pose."""
        position, orientation = _vector(made.position), _quaternion(made.orientation)
        self.attachments[made.carrier, made.body] = Attachment(
            made.carrier, made.carrier_link, made.body, made.body_link, position, orientation
        )

    def change(self, state: records.BodyState) -> None:
        """Changes a body; one whose loading is lost stays unknown."""
        body = self.bodies.get(state.body)
        if body is not None:
            body.change(state)

    def take_effect(self, effect: records.Effect) -> None:
        """Makes true what was read back."""
        for ended in effect.detached:
            self.attachments.pop((ended.carrier, ended.body), None)
        for name in effect.removed:
            self.bodies.pop(name, None)
            for pair in [pair for pair in self.attachments if name in pair]:
                del self.attachments[pair]
            if self.told.get("robot") == name:
                self.told["robot"] = ""
        for made in effect.attached:
            self.attach(made)
        for state in effect.bodies:
            self.change(state)


class _Body:
    """A body in the making."""

    __slots__ = ("color", "joint_velocities", "joints", "loaded", "orientation", "position", "velocity")

    def __init__(self, loaded: records.LoadBody) -> None:
        self.loaded = loaded
        self.position: Vector = _vector(loaded.position) if loaded.position else (0.0, 0.0, 0.0)
        self.orientation: Quaternion = _quaternion(loaded.orientation) if loaded.orientation else (0.0, 0.0, 0.0, 1.0)
        self.velocity: tuple[float, ...] = _AT_REST
        self.joints = dict.fromkeys(loaded.joints, 0.0)
        self.joint_velocities = dict.fromkeys(loaded.joints, 0.0)
        self.color = tuple(loaded.color)

    def change(self, state: records.BodyState) -> None:
        """Makes true what was read back of it."""
        if state.position:
            self.position, self.velocity = _vector(state.position), _AT_REST
        if state.orientation:
            self.orientation = _quaternion(state.orientation)
        if state.velocity:
            self.velocity = tuple(state.velocity)
        if state.joints:
            speeds = state.joint_velocities or [0.0] * len(state.joints)
            self.joints.update(zip(state.joints, state.joint_positions, strict=True))
            self.joint_velocities.update(zip(state.joints, speeds, strict=True))

    def frozen(self) -> Body:
        """What it is now."""
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


def take(worlds: dict[str, WorldBuilder], record: records.Record) -> None:
    """Brings worlds from before a record to after it.

    Args:
        worlds: by name; none before the first record.
        record: any; those that don't change worlds are passed over.
    """
    if isinstance(record, Keyframe):
        before = worlds.get(record.world)
        worlds[record.world] = _of_keyframe(record)
        if before is not None:
            worlds[record.world].told["lifetime"] = before.told["lifetime"]
    elif isinstance(record, Mutation):
        command = record.WhichOneof("command")
        if command == "open_world":
            ended = worlds.pop(record.world, None)  # in the order of opening, also when a name is taken again
            world = worlds[record.world] = WorldBuilder(record.world, record.open_world.mode)
            if ended is not None:
                world.told["lifetime"] = int(str(ended.told["lifetime"])) + 1
        if record.world not in worlds:
            worlds[record.world] = WorldBuilder(record.world)
        world = worlds[record.world]
        world.told["sim_step"] = record.sim_step
        _obey(world, record, command or "")
        world.take_effect(record.effect)


def _obey(world: WorldBuilder, record: Mutation, command: str) -> None:
    """Makes true what a command says by itself, beside its effect on bodies."""
    if command == "load_body":
        world.bodies[record.load_body.body] = _Body(record.load_body)
    elif command == "set_gravity":
        world.told["gravity"] = _vector(record.set_gravity.gravity)
    elif command == "set_realtime":
        world.told["realtime"] = record.set_realtime.enabled
    elif command == "set_robot":
        world.told["robot"] = record.set_robot.body
    elif command == "set_color":
        painted = world.bodies.get(record.set_color.body)
        if painted is not None:
            painted.color = tuple(record.set_color.color)
    elif command == "close_world":
        world.bodies.clear()
        world.attachments.clear()
        world.told |= {"open": False, "realtime": False, "robot": ""}


def _of_keyframe(frame: Keyframe) -> WorldBuilder:
    world = WorldBuilder(frame.world, frame.mode)
    world.told |= {
        "sim_step": frame.sim_step,
        "gravity": _vector(frame.gravity) if frame.gravity else (0.0, 0.0, 0.0),
        "realtime": frame.realtime,
        "robot": frame.robot,
    }
    for loaded in frame.loaded:
        world.bodies[loaded.body] = _Body(loaded)
    for state in frame.bodies:
        world.change(state)
    for made in frame.attachments:
        world.attach(made)
    return world


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = values
    return x, y, z


def _quaternion(values: Sequence[float]) -> Quaternion:
    x, y, z, w = values
    return x, y, z, w
