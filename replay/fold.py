"""Folds records into states: the nearest keyframe of each world, then the effects up to a step. No physics runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.records import Keyframe, Mutation
from replay.errors import NoSuchStep
from replay.state import Attachment, Body, State, World

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder import records
    from recorder.geometry import Quaternion, Vector
    from replay.log import Log


def state_at(log: Log, step: int) -> State:
    """What is true after a step.

    Args:
        log: the recording.
        step: negative steps count from the end.

    Raises:
        NoSuchStep: there is no such step.
    """
    last = step + len(log) if step < 0 else step
    if not 0 <= last < len(log):
        raise NoSuchStep(step, len(log))
    worlds: dict[str, World] = {}
    for record in _since_keyframes(log, last):
        apply(worlds, record)
    return State(last, worlds, log.asset)


def _since_keyframes(log: Log, last: int) -> list[Keyframe | Mutation]:
    """The records that make up the state, in order: of each world its last keyframe or opening, and what follows it."""
    found: list[Keyframe | Mutation] = []
    settled: set[str] = set()
    opened = {world for world, first in log.first_steps.items() if first <= last}
    for record in log.backwards(last):
        if not isinstance(record, Keyframe | Mutation) or record.world in settled or record.world not in opened:
            continue
        found.append(record)
        if isinstance(record, Keyframe) or record.WhichOneof("command") in ("open_world", "close_world"):
            settled.add(record.world)
            if settled >= opened:
                break
    found.reverse()
    return found


def apply(worlds: dict[str, World], record: Keyframe | Mutation) -> None:
    """Brings worlds from before a record to after it.

    Args:
        worlds: the open worlds; changed.
        record: the next record.
    """
    if isinstance(record, Keyframe):
        worlds[record.world] = _from_keyframe(record)
        return
    command = record.WhichOneof("command")
    if command == "open_world":
        worlds[record.world] = World(record.world, record.open_world.mode)
        return
    if command == "close_world":
        worlds.pop(record.world, None)
        return
    world = worlds.setdefault(record.world, World(record.world))
    world.sim_step = record.sim_step
    if command == "load_body":
        _load(world, record.load_body)
    elif command == "set_gravity":
        world.gravity = _vector(record.set_gravity.gravity)
    elif command == "set_realtime":
        world.realtime = record.set_realtime.enabled
    elif command == "set_robot":
        world.robot = record.set_robot.body
    elif command == "set_color":
        world.bodies[record.set_color.body].color = tuple(record.set_color.color)
    _take_effect(world, record.effect)


def _take_effect(world: World, effect: records.Effect) -> None:
    for gone in effect.detached:
        world.attachments.pop((gone.carrier, gone.body), None)
    for made in effect.attached:
        world.attachments[made.carrier, made.body] = _attachment(made)
    for name in effect.removed:
        world.bodies.pop(name, None)
        if world.robot == name:
            world.robot = ""
    for state in effect.bodies:
        _take_state(world.bodies[state.body], state)


def _from_keyframe(frame: Keyframe) -> World:
    world = World(
        frame.world, frame.mode, frame.sim_step, _vector(frame.gravity or (0.0, 0.0, 0.0)), frame.realtime, frame.robot
    )
    for loaded in frame.loaded:
        _load(world, loaded)
    for state in frame.bodies:
        _take_state(world.bodies[state.body], state)
    for made in frame.attachments:
        world.attachments[made.carrier, made.body] = _attachment(made)
    return world


def _load(world: World, loaded: records.LoadBody) -> None:
    body = Body(loaded.body, loaded.type, loaded, color=tuple(loaded.color))
    body.position, body.orientation = _vector(loaded.position), _quaternion(loaded.orientation)
    body.joints = dict.fromkeys(loaded.joints, 0.0)
    body.joint_velocities = dict.fromkeys(loaded.joints, 0.0)
    world.bodies[loaded.body] = body


def _take_state(body: Body, state: records.BodyState) -> None:
    if state.position:
        body.position, body.orientation = _vector(state.position), _quaternion(state.orientation)
        body.velocity = (0.0,) * 6
    if state.velocity:
        body.velocity = tuple(state.velocity)
    for index, joint in enumerate(state.joints):
        body.joints[joint] = state.joint_positions[index]
        body.joint_velocities[joint] = state.joint_velocities[index] if state.joint_velocities else 0.0


def _attachment(made: records.Attachment) -> Attachment:
    return Attachment(
        made.carrier,
        made.carrier_link,
        made.body,
        made.body_link,
        _vector(made.position),
        _quaternion(made.orientation),
    )


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = values
    return x, y, z


def _quaternion(values: Sequence[float]) -> Quaternion:
    x, y, z, w = values
    return x, y, z, w
