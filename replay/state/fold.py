"""Fold records into states: each world is its last keyframe, changed by the effects of later records up to a step.

Effects have the exact values of the engine. States are therefore exact, and a fold from the start gives the same state
as a fold from any keyframe. No physics runs.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping
from typing import Final

from recorder import records
from recorder.records import STEPS_PER_SECOND, Belief, Keyframe, Mutation, Query, beliefs
from recorder.records.fold import FoldedBody, FoldedWorld, apply, quaternion, vector
from replay.errors import Damaged
from replay.file.lifetimes import Lifetime, closes_world
from replay.file.record_reader import RecordReader
from replay.file.repair import range_text
from replay.state.state import Body, RecordedBelief, Sampled, State, World

CHANGES: Final = (Mutation, Keyframe, Query)
"""The kinds of records that change a state. A query changes the state if it updates a robot's beliefs."""


def fold(all_records: Iterable[records.Record], step: int = -1) -> State:
    """Return the state after some records. The first record of each world must be its opening or a keyframe.

    The step of the state is ``step``, or the step of the last record if that step is larger.
    """
    worlds: dict[str, FoldedWorld] = {}
    for record in all_records:
        step = max(step, record.seq)
        apply(worlds, record)
    return State(step, {name: world_of(world) for name, world in worlds.items()})


def state_at(log: RecordReader, step: int, moment: float | None = None) -> State:
    """Return the state after a step of a recording.

    A moment is a simulated time in s. If the next record is a simulation that contains the moment, return the state of
    the last sample before the moment. If a record is inconsistent, Damaged is raised.
    """
    worlds: dict[str, FoldedWorld] = {}
    first = step
    for lifetime in log.lifetimes:
        if lifetime.has(step):  # the world is still open, and its name has not been used again
            first = min(first, _fold_lifetime(log, lifetime, step, worlds))
    lost = ", ".join(range_text(gap) for gap in log.lost() if first < gap.stop and gap.start <= step)
    uncertainty = f"the changes of steps {lost} are lost" if lost else ""
    sampled = _apply_samples(log, step + 1, worlds, moment) if moment is not None else None
    return State(step, {name: world_of(world) for name, world in worlds.items()}, uncertainty, log.assets, sampled)


def _apply_samples(log: RecordReader, step: int, worlds: dict[str, FoldedWorld], moment: float) -> Sampled | None:
    """Bring a world to a moment within a simulation; return None if the simulation doesn't contain the moment."""
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


def _fold_lifetime(log: RecordReader, lifetime: Lifetime, step: int, worlds: dict[str, FoldedWorld]) -> int:
    """Fold the records of a world from its last keyframe up to a step. Return the first step that was read."""
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


def world_of(folded: FoldedWorld) -> World:
    """Return the present state of a folded world."""
    bodies = {name: _body(body) for name, body in folded.bodies.items()}
    return World(
        folded.name,
        folded.open,
        folded.mode,
        folded.sim_step,
        folded.gravity,
        folded.realtime,
        folded.robot,
        folded.lifetime,
        bodies,
        dict(folded.attachments),
        dict(folded.following),
        {key: _belief(belief, bodies) for key, belief in folded.beliefs.items() if key[1] in bodies},
    )


def _body(body: FoldedBody) -> Body:
    return Body(
        body.loaded.body,
        body.loaded.type,
        body.loaded,
        body.position,
        body.orientation,
        body.velocity,
        dict(body.joints),
        dict(body.joint_velocities),
        body.color,
    )


def _belief(belief: Belief, bodies: Mapping[str, Body]) -> RecordedBelief:
    """Return a belief as data. A belief about a held object has the object's true pose."""
    body = bodies[belief.object]
    pose = body.pose if belief.source == Belief.HELD else (vector(belief.position), quaternion(belief.orientation))
    return RecordedBelief(belief.robot, belief.object, *pose, beliefs.word(belief.source), belief.sim_step, belief.step)


def last_open_step(log: RecordReader, step: int, name: str | None = None) -> int:
    """Return the last step up to ``step`` at which a world is open; with a ``name``, at which this world is open."""
    if any(world.open for world in state_at(log, step).worlds.values() if name in (None, world.name)):
        return step
    lives = [lifetime for lifetime in log.lifetimes if name in (None, lifetime.world)]
    ends = {record.seq for record in map(log.end_of, lives) if record is not None and closes_world(record)}
    end = max((seq for seq in ends if seq <= step), default=step + 1)
    while end - 1 in ends:  # at its end, a plan closes all worlds one after another
        end -= 1
    return end - 1
