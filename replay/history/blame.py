"""Find the last change of a body or a joint, with its tasks and lines of the plan.

A carried body moves with its carrier. In this case the change is a record of the carrier, and the record of the
attachment is also returned.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from recorder import html
from recorder.records import Keyframe, Mutation
from replay.errors import Damaged, NoSuchName
from replay.history.tasks import CausingTasks, causing_tasks
from replay.state.fold import state_at
from replay.state.state import Attachment, State, World, turn

if TYPE_CHECKING:
    from recorder.geometry import Pose
    from replay.file.record_reader import RecordReader

#: Changes in simulation (m or rad for positions, rad for turns) below which an object only settles.
SETTLING: Final = 5e-3, math.radians(5)
#: Smaller changes (m, rad) are rounding, such as the changes of an object in a resting hand while the head turns.
_ROUNDING: Final = 1e-6, 1e-6


@dataclass(frozen=True, slots=True)
class Carried:
    """An attachment through which a body was moved."""

    held: Attachment  # the attachment before the move
    step: int | None  # step of the record that attached the body; None if the recording began later
    causes: CausingTasks | None  # causes of the record that attached the body


@dataclass(frozen=True, slots=True, repr=False)
class Blame:
    """The last change of a body or joint."""

    world: str
    other_worlds: tuple[str, ...]  # other open worlds that have a body with this name
    default_world: str  # the world that was opened last, if the body is in another world; otherwise ""
    body: str
    joint: str  # name of the joint; "" for the body's pose
    #: How the body changed: "command" (on this body), "load", "carried" (by a holder), "along" (with the body below or
    #: around it), "hand" (dragged in the window), "driven" (on a trajectory), "physics", "reset", "restored" (a saved
    #: state), "removed", or "before" (the recording began)
    how: str
    before: Pose | float | None  # value before the change; None if the body didn't exist
    after: Pose | float | None  # value after the change; None if the body no longer exists
    distance: float  # length of the motion in m, or angle of a revolute joint in rad
    angle: float  # angle of the body's turn in rad; 0 for joints
    record: Mutation | Keyframe  # the record of the change; a keyframe if no change is on record
    causes: CausingTasks  # causes of that record
    carried: tuple[Carried, ...]  # attachments from the body up to the commanded body; the body's own is first
    #: The previous change before a removal, or before a change in simulation. Changes of objects that only settle don't
    #: count.
    earlier: Blame | None = None

    def __repr__(self) -> str:
        name = f"{self.body}.{self.joint}" if self.joint else self.body
        return f"<Blame {name} in {self.world}: {self.how} at step {self.record.seq}>"

    def _repr_html_(self) -> str:
        return html.rendered(self)


def blame(log: RecordReader, target: str, at: int | None = None, world: str | None = None) -> Blame:
    """Return the last change of a body or a joint (``BODY.JOINT``) up to a step.

    By default, the step is the last one before worlds were closed. By default, the world is the last opened world with
    the body.

    Raises:
        NoSuchStep: There is no such step.
        NoSuchName: The body or joint doesn't exist at the step or before.
    """
    step = log.final_step() if at is None else at
    state = state_at(log, step)
    try:
        owner, body, joint = _find(state, target, world)
    except NoSuchName as error:
        removal = _removal(log, state, target, world, error)
        earlier = blame(log, target, removal.seq - 1, removal.world)
        return replace(
            earlier,
            default_world=_default_world(state, removal.world, world),
            record=removal,
            how="removed",
            before=earlier.after,
            after=None,
            distance=math.inf,
            angle=0.0,
            carried=(),
            causes=causing_tasks(log, removal),
            earlier=earlier,
        )
    others = tuple(each.name for each in state.worlds.values() if each is not owner and body in each.bodies)
    return _Search(log, owner.name, others, _default_world(state, owner.name, world), body, joint).run(step)


def _default_world(state: State, world: str, requested: str | None) -> str:
    default = state.world().name
    return default if requested is None and default != world else ""


def _removal(log: RecordReader, state: State, target: str, world: str | None, error: NoSuchName) -> Mutation:
    """Return the record by which a body, or a joint's body, was removed from an open world.

    If there is no such record, raise the error, with a hint if a closed world had the body.
    """
    opened = {name: log.lifetime_at(name, state.step) for name, each in state.worlds.items() if each.open}
    candidates = {name: lifetime for name, lifetime in opened.items() if world in (None, name)}
    some_closed = bool(opened) and len(log.lifetimes) > len(opened)  # if no world is open, the error contains a hint
    removals: list[Mutation] = []
    closed: NoSuchName | None = None
    for body in _possible_bodies(target) if candidates or some_closed else ():
        for record in log.backwards(state.step, Mutation, naming=body):
            lifetime = log.lifetime_at(record.world, record.seq)
            if lifetime is None:
                continue
            if body in record.effect.removed and lifetime == candidates.get(record.world):
                removals.append(record)
                break
            in_closed = some_closed and closed is None and lifetime != opened.get(record.world)
            if in_closed and any(changed.body == body for changed in record.effect.bodies[:]):
                hint = f"{lifetime.title} contained it and was closed later: use --at {record.seq}, or an earlier step"
                closed = NoSuchName("object", body, error.known, hint)
    if not removals:
        raise (closed or error) from None
    return max(removals, key=lambda record: record.seq)


def _possible_bodies(target: str) -> list[str]:
    """Return the possible names of the body, longest first. The names of bodies may contain dots."""
    return [target, *(target[:at] for at in range(len(target) - 1, 0, -1) if target[at] == ".")]


def _find(state: State, target: str, name: str | None) -> tuple[World, str, str]:
    worlds = [state.world(name)] if name is not None else list(state.worlds.values())
    for body in _possible_bodies(target):
        joint = target[len(body) + 1 :]
        for world in reversed(worlds):
            if body in world.bodies:
                if body != target:
                    world.bodies[body].joint(joint)
                return world, body, joint
    raise state.no_body(target.partition(".")[0], worlds)


@dataclass(frozen=True, slots=True)
class _Search:
    """A search backwards through the changes of a body or joint (:class:`Blame`)."""

    _log: RecordReader
    _world: str
    _other_worlds: tuple[str, ...]
    _default_world: str
    _body: str
    _joint: str

    def run(self, step: int) -> Blame:
        """Return the last change. The result for a change by physics also contains the previous change."""
        records = self._changes(step)
        for last in records:
            change = self._explained(last)
            if change.how != "command" and change.distance < _ROUNDING[0] and change.angle < _ROUNDING[1]:
                continue
            if change.how != "physics":
                return change
            return replace(change, earlier=self._explained(self._before(last, records)))
        raise Damaged(self._log.path, f"the last change of {self._body}", "its record was lost")

    def _before(self, last: Mutation | Keyframe, older: Iterator[Mutation | Keyframe]) -> Mutation | Keyframe:
        """Return the last earlier record whose change is larger than that of a settling object. No state is folded."""
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
        """Return whether a change is larger than the changes of settling objects and of rounding."""
        if commanded(record) == self._body:
            return True
        limits = SETTLING if is_physics(record) else _ROUNDING
        if part == "orientation":
            return turn(before, after) >= limits[1]
        return math.dist(before, after) >= limits[0]

    def _parts(self, record: Mutation | Keyframe) -> dict[str, Sequence[float]]:
        """Return the body's values in a record: position and orientation, or the position of a joint."""
        states = record.effect.bodies if isinstance(record, Mutation) else record.bodies
        state = next((state for state in states if state.body == self._body), None)
        if state is None:
            return {}
        if self._joint:
            values = dict(zip(state.joints, state.joint_positions, strict=False))
            return {"joint": [values[self._joint]]} if self._joint in values else {}
        pose = {"position": state.position, "orientation": state.orientation}
        return {part: list(values) for part, values in pose.items() if values}

    def _changes(self, step: int) -> Iterator[Mutation | Keyframe]:
        """Yield the records that changed the body, from the last one back to its loading or to the first keyframe."""
        lifetime = self._log.lifetime_at(self._world, step)
        if lifetime is None:
            return
        start = lifetime.start
        for record in self._log.backwards(step, Mutation, naming=self._body):
            if not lifetime.has(record.seq):  # earlier records belong to another world
                break
            if record.world != self._world:
                continue
            if self._body in record.effect.removed:  # the record of the body's next loading is lost
                start = record.seq
                break
            if self._is_loading(record):
                yield record
                return
            if self._parts(record):
                yield record
        for frame in self._log.records_of(lifetime, Keyframe, lifetime.keyframes):
            if frame.seq >= start and any(loaded.body == self._body for loaded in frame.loaded):
                yield frame
                return

    def _is_loading(self, record: Mutation) -> bool:
        return record.HasField("load_body") and record.load_body.body == self._body

    def _explained(self, record: Mutation | Keyframe) -> Blame:
        after = self._value(state_at(self._log, record.seq))
        if after is None:
            raise NoSuchName("object", self._body, ())
        before: Pose | float | None = None
        chain: list[Attachment] = []
        if isinstance(record, Keyframe):
            how = "before"
        elif self._is_loading(record):
            how = "load"
        else:
            state = state_at(self._log, record.seq - 1)
            before = self._value(state)
            how, chain = _how(record, state.world(self._world), self._body, self._joint)
        carried = tuple(self._carried(held, record.seq) for held in chain)
        because = causing_tasks(self._log, record)
        subject = self._world, self._other_worlds, self._default_world, self._body, self._joint
        return Blame(*subject, how, before, after, *_size(before, after), record, because, carried)

    def _value(self, state: State) -> Pose | float | None:
        world = state.worlds.get(self._world)
        body = world.bodies.get(self._body) if world is not None else None
        if body is None:
            return None
        return body.joints.get(self._joint) if self._joint else body.pose

    def _carried(self, held: Attachment, step: int) -> Carried:
        for record in self._log.backwards(step, Mutation, naming=held.body):
            made = [(each.carrier, each.body) for each in record.effect.attached]
            if record.world == self._world and record.HasField("attach_body") and (held.carrier, held.body) in made:
                return Carried(held, record.seq, causing_tasks(self._log, record))
        return Carried(held, None, None)


def is_physics(record: Mutation | Keyframe) -> bool:
    """Return whether a record is a simulation."""
    return isinstance(record, Mutation) and record.WhichOneof("command") in ("simulate", "set_realtime")


def commanded(record: Mutation | Keyframe) -> str:
    """Return the body of a record's command; "" if it has none."""
    command = record.WhichOneof("command") if isinstance(record, Mutation) else None
    return str(getattr(getattr(record, command), "body", "")) if command else ""


def _size(before: Pose | float | None, after: Pose | float) -> tuple[float, float]:
    if isinstance(before, float) and isinstance(after, float):
        return abs(after - before), 0.0
    if isinstance(before, tuple) and isinstance(after, tuple):
        return math.dist(before[0], after[0]), turn(before[1], after[1])
    return math.inf, 0.0


def _in_simulation(record: Mutation, world: World, body: str, joint: str) -> str:
    begun = [each.begin.trajectory for each in world.following.values() if each.begin.body == body]
    if any(joint in (trajectory.joints or ("",)) for trajectory in begun):
        return "driven"
    return "hand" if any(drag.body == body for drag in record.drags) else "physics"


def _how(record: Mutation, world: World, body: str, joint: str) -> tuple[str, list[Attachment]]:
    """Return how a command moved a body or joint, and by which attachments.

    ``world`` is the world's state before the command.
    """
    if is_physics(record):
        return _in_simulation(record, world, body, joint), []
    if record.HasField("reset"):
        return "reset", []
    if record.HasField("restore"):
        return "restored", []
    cause = commanded(record)
    if cause == body:
        return "command", []
    chain: list[Attachment] = []
    visited = {body}
    current = body
    while current != cause:
        held = world.carrier(current)
        if held is None or held.carrier in visited:
            return "along", []
        chain.append(held)
        visited.add(held.carrier)
        current = held.carrier
    return "carried", chain
