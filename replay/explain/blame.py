"""Who did it: the record that last changed a body or a joint, and why that record is there.

What is carried moves with its carrier: then the record is the carrier's, and the one that attached it is told too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple

from recorder.records import Keyframe, Mutation
from replay.errors import Damaged, NoSuchName
from replay.explain.causes import Causes, causes
from replay.explain.step_names import step_of
from replay.explain.summary import final_of
from replay.state.diff import turn
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.geometry import Pose
    from replay.file.log import Log
    from replay.state.state import Attachment, State, World


#: In simulation, less than this is a body coming to rest: m (or a joint's rad), rad.
_SETTLING: Final = 5e-3, math.radians(5)
#: Less than this is arithmetic, as above: what a resting hand holds moves by it when the head turns.
_ROUNDING: Final = 1e-6, 1e-6


@dataclass(frozen=True, slots=True)
class Carried:
    """That something was carried by what moved.

    Attributes:
        held: how, just before.
        step: the record that attached it; None if that was before the recording began.
        causes: why it was attached; None as well.
    """

    held: Attachment
    step: int | None
    causes: Causes | None


@dataclass(frozen=True, slots=True)
class Blame:
    """What last changed a body or joint.

    Attributes:
        world: name of the world.
        others: names of other open worlds that have a body of that name.
        without: name of the world that is meant where none is named, if that is another one: it has no such body.
        body: name of the body.
        joint: name of the joint; "" for the body's pose.
        record: the record that changed it; a keyframe if nothing did since the recording began.
        how: "command" (it was moved itself), "load", "carried" (with what holds it), "along" (with what it lies on or
            in), "physics", "reset", "removed", or "before" (the recording began later).
        before: its pose or value before; None if it wasn't there.
        after: its pose or value after; None if it was removed.
        distance: how far it moved: m, or of a revolute joint rad.
        angle: by how much it turned, rad; 0 for joints.
        carried: the attachments that made it move with the commanded body, the body's own first.
        causes: why the record is there.
        earlier: of a change in simulation, what happened to it before: another one that is more than coming to rest, or
            what brought it there; of its removal, what last changed it until then; None of any other.
    """

    world: str
    others: tuple[str, ...]
    without: str
    body: str
    joint: str
    record: Mutation | Keyframe
    how: str
    before: Pose | float | None
    after: Pose | float | None
    distance: float
    angle: float
    carried: tuple[Carried, ...]
    causes: Causes
    earlier: Blame | None = None


def blame(log: Log, target: str, at: int | str | None = None, world: str | None = None) -> Blame:
    """What last changed a body or a joint.

    Args:
        log: the recording.
        target: name of a body, or ``BODY.JOINT``.
        at: the step until which to look; by default the last one before worlds were closed.
        world: name of the world; by default, of those that have the body, the one that was opened last.

    Raises:
        NoSuchStep: there is no such step.
        NoSuchName: the body or joint wasn't there then, nor was it removed before.
    """
    step = final_of(log) if at is None else step_of(log, at)
    state = state_at(log, step)
    try:
        place, body, joint = _find(state, target, world)
    except NoSuchName as missing:
        gone = _removal(log, state, target, world, missing)
        until = blame(log, target, gone.seq - 1, gone.world)
        return replace(_removed(log, gone, until), without=_without(state, gone.world, world))
    others = tuple(other.name for other in state.worlds.values() if other is not place and body in other.bodies)
    about = _About(place.name, others, _without(state, place.name, world), body, joint)
    return _Search(log, about).run(step)


def _without(state: State, found: str, named: str | None) -> str:
    """The world that one would think of, if it isn't the one that has the body."""
    default = state.world().name
    return default if named is None and default != found else ""


def _removal(log: Log, state: State, target: str, world: str | None, missing: NoSuchName) -> Mutation:
    """The record that removed a body, or the one with that joint, from a world that is still open.

    Raises:
        NoSuchName: there is none; it says so if the body was in a world that had been closed by then.
    """
    opened = {name: log.lifetime_at(name, state.step) for name, place in state.worlds.items() if place.open}
    meant = {name: lifetime for name, lifetime in opened.items() if world in (None, name)}
    some_closed = bool(opened) and len(log.lifetimes) > len(opened)  # where none is open, the error tells that itself
    found, error = [], missing
    for body in _bodies(target) if meant or some_closed else ():
        for record in log.backwards(state.step, Mutation, naming=body):
            lifetime = log.lifetime_at(record.world, record.seq)
            if not isinstance(record, Mutation) or lifetime is None:
                continue
            if body in record.effect.removed and lifetime == meant.get(record.world):
                found.append(record)
                break
            told = some_closed and error is missing and lifetime != opened.get(record.world)
            if told and any(one.body == body for one in record.effect.bodies[:]):
                hint = f"it was in {lifetime.title}, which was closed later: --at {record.seq}, or an earlier step"
                error = NoSuchName("object", body, missing.known, hint)
    if not found:
        raise error from None
    return max(found, key=lambda record: record.seq)


def _bodies(target: str) -> list[str]:
    """The names that a target can begin with, the longest first: names may have dots in them."""
    return [target, *(target[:at] for at in range(len(target) - 1, 0, -1) if target[at] == ".")]


def _removed(log: Log, record: Mutation, until: Blame) -> Blame:
    return replace(
        until,
        record=record,
        how="removed",
        before=until.after,
        after=None,
        distance=math.inf,
        angle=0.0,
        carried=(),
        causes=causes(log, record),
        earlier=until,
    )


def _find(state: State, target: str, name: str | None) -> tuple[World, str, str]:
    worlds = [state.world(name)] if name is not None else list(state.worlds.values())
    for body in _bodies(target):
        joint = target[len(body) + 1 :]
        for world in reversed(worlds):
            if body in world.bodies:
                if body != target:
                    world.bodies[body].joint(joint)
                return world, body, joint
    raise state.no_body(target.partition(".")[0], worlds)


class _About(NamedTuple):
    """What is looked for, as :class:`Blame` tells it."""

    world: str
    others: tuple[str, ...]
    without: str
    body: str
    joint: str


class _Search:
    """Goes back through a world's changes."""

    def __init__(self, log: Log, about: _About) -> None:
        self._log = log
        self._about = about
        self._world = about.world
        self._body = about.body
        self._joint = about.joint

    def run(self, step: int) -> Blame:
        """The last change; and if that was physics, what happened to it before."""
        records = self._changes(step)
        for last in records:
            found = self._told(last)
            if found.how != "command" and found.distance < _ROUNDING[0] and found.angle < _ROUNDING[1]:
                continue
            if found.how != "physics":
                return found
            return replace(found, earlier=self._told(self._before(last, records)))
        raise Damaged(self._log.path, f"what moved {self._body}", "it was lost")

    def _before(self, last: Mutation | Keyframe, older: Iterator[Mutation | Keyframe]) -> Mutation | Keyframe:
        """The last record before one that did more than let it come to rest; told without folding states."""
        newer: dict[str, Mutation | Keyframe] = {}
        values: dict[str, Sequence[float]] = {}
        record = last
        for record in older:
            for part, value in self._parts(record).items():
                changed = newer.get(part)
                if changed is not None and self._counts(changed, part, values[part], value):
                    return changed
                newer[part], values[part] = record, value
        return record

    def _counts(self, record: Mutation | Keyframe, part: str, after: Sequence[float], before: Sequence[float]) -> bool:
        """Whether a change is more than coming to rest, or than arithmetic."""
        if commanded(record) == self._body:
            return True
        return _is_far(part, after, before, _SETTLING if _is_physics(record) else _ROUNDING)

    def _parts(self, record: Mutation | Keyframe) -> dict[str, Sequence[float]]:
        """What a record says of it: position and orientation, or the joint's value."""
        states = record.effect.bodies if isinstance(record, Mutation) else record.bodies
        state = next((state for state in states if state.body == self._body), None)
        if state is None:
            return {}
        if self._joint:
            values = dict(zip(state.joints, state.joint_positions, strict=False))
            return {"joint": [values[self._joint]]} if self._joint in values else {}
        told = {"position": state.position, "orientation": state.orientation}
        return {part: list(values) for part, values in told.items() if values}

    def _changes(self, step: int) -> Iterator[Mutation | Keyframe]:
        """Records that changed it, the last one first, down to its loading or the first record that knows it."""
        lifetime = self._log.lifetime_at(self._world, step)
        if lifetime is None:
            return
        start = lifetime.start
        for record in self._log.backwards(step, Mutation, naming=self._body):
            if not lifetime.has(record.seq):  # what was before is another world's
                break
            if not isinstance(record, Mutation) or record.world != self._world:
                continue
            if self._body in record.effect.removed:  # how it came back is lost
                start = record.seq
                break
            if self._is_loading(record):
                yield record
                return
            if self._is_change(record):
                yield record
        for frame in self._log.records_of(lifetime, Keyframe, lifetime.keyframes):
            if frame.seq >= start and isinstance(frame, Keyframe) and self._is_in(frame):
                yield frame
                return

    def _is_in(self, frame: Keyframe) -> bool:
        return any(loaded.body == self._body for loaded in frame.loaded)

    def _is_loading(self, record: Mutation) -> bool:
        return record.HasField("load_body") and record.load_body.body == self._body

    def _is_change(self, record: Mutation) -> bool:
        for state in record.effect.bodies:
            if state.body == self._body:
                return self._joint in state.joints if self._joint else bool(state.position or state.orientation)
        return False

    def _told(self, record: Mutation | Keyframe) -> Blame:
        after = self._value(state_at(self._log, record.seq))
        why = causes(self._log, record)
        if after is None:
            raise NoSuchName("object", self._body, ())
        if isinstance(record, Keyframe) or self._is_loading(record):
            how = "before" if isinstance(record, Keyframe) else "load"
            return self._blame(record, how, (None, after), (math.inf, 0.0), (), why)
        state = state_at(self._log, record.seq - 1)
        before = self._value(state)
        how, chain = _how(record, state.world(self._world), self._body)
        carried = tuple(self._carried(held, record.seq) for held in chain)
        return self._blame(record, how, (before, after), _size(before, after), carried, why)

    def _blame(
        self,
        record: Mutation | Keyframe,
        how: str,
        values: tuple[Pose | float | None, Pose | float],
        size: tuple[float, float],
        carried: tuple[Carried, ...],
        why: Causes,
    ) -> Blame:
        return Blame(*self._about, record, how, *values, *size, carried, why)

    def _value(self, state: State) -> Pose | float | None:
        world = state.worlds.get(self._world)
        body = world.bodies.get(self._body) if world is not None else None
        if body is None:
            return None
        return body.joints.get(self._joint) if self._joint else body.pose

    def _carried(self, held: Attachment, step: int) -> Carried:
        for record in self._log.backwards(step, Mutation, naming=held.body):
            if isinstance(record, Mutation) and record.world == self._world and record.HasField("attach_body"):
                command = record.attach_body
                if (command.carrier, command.body) == (held.carrier, held.body):
                    return Carried(held, record.seq, causes(self._log, record))
        return Carried(held, None, None)


def _is_physics(record: Mutation | Keyframe) -> bool:
    return isinstance(record, Mutation) and record.WhichOneof("command") in ("simulate", "set_realtime")


def commanded(record: Mutation | Keyframe) -> str:
    """The body that a record's command is about; empty if it is about none.

    Args:
        record: what changed a world, or told all of it.
    """
    command = record.WhichOneof("command") if isinstance(record, Mutation) else None
    return str(getattr(getattr(record, command), "body", "")) if command else ""


def _is_far(part: str, after: Sequence[float], before: Sequence[float], limits: tuple[float, float]) -> bool:
    if part == "orientation":
        return turn(before, after) >= limits[1]
    return math.dist(before, after) >= limits[0]


def _size(before: Pose | float | None, after: Pose | float) -> tuple[float, float]:
    if isinstance(before, float) and isinstance(after, float):
        return abs(after - before), 0.0
    if isinstance(before, tuple) and isinstance(after, tuple):
        return math.dist(before[0], after[0]), turn(before[1], after[1])
    return math.inf, 0.0


def _how(record: Mutation, world: World, body: str) -> tuple[str, list[Attachment]]:
    """How a command made a body move, by the state before it."""
    if _is_physics(record):
        return "physics", []
    if record.HasField("reset"):
        return "reset", []
    cause = commanded(record)
    if cause == body:
        return "command", []
    chain: list[Attachment] = []
    seen = {body}
    at = body
    while at != cause:
        held = world.carrier(at)
        if held is None or held.carrier in seen:
            return "along", []
        chain.append(held)
        seen.add(held.carrier)
        at = held.carrier
    return "carried", chain
