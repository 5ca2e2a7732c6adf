"""The funnel: the one way in which a world changes.

Validate, act in the engine, read back, emit one record, tell the observer, fire events. The world's lock is held from
validating to telling the observer, so the order of records is the order of changes. Handlers of events are user code:
they are called when the lock is free again (:mod:`pycram.world.lock`).
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from pycram.foundation.failures import ChangeRefused, WorldClosed
from pycram.scheduling.cancellation import before_change
from pycram.world.lock import WorldLock
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.call_site import call_site
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from pycram.world.attachment import Attachment
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld
    from recorder.geometry import Pose

#: A keyframe costs 0.3 ms and 3 kB; with one each 100 changes any step is folded from at most 100 records.
CHANGES_PER_KEYFRAME: Final = 100

_AT_REST: Final = (0.0,) * 6


class Reading(NamedTuple):
    """What the engine says of a body."""

    pose: Pose
    velocity: tuple[float, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]


def read(body: Object) -> Reading:
    """Reads a body's whole state from the engine.

    Args:
        body: a living object.
    """
    engine, handle = body.world.engine, body.handle
    return Reading(engine.pose(handle), engine.velocity(handle), *engine.joints(handle))


def put(body: Object, state: Reading) -> None:
    """Brings a body into a state that was read before; its motors hold the joints where they then are.

    No record tells of it: it belongs to the building of a world aside, which is introduced when it is complete.

    Args:
        body: a living object.
        state: what :func:`read` gave of it, or of the same model elsewhere.

    Raises:
        RuntimeError: somebody listens, who would have to be told.
    """
    if journal.recording():
        raise RuntimeError(f"{body.name} can be put into a state only aside, where nobody listens")
    engine, handle = body.world.engine, body.handle
    engine.set_pose(handle, state.pose)
    if not body.fixed and state.velocity != _AT_REST:
        engine.set_velocity(handle, state.velocity)
    positions = dict(zip(body.joints, state.positions, strict=True))
    engine.set_joints(handle, positions, dict(zip(body.joints, state.velocities, strict=True)))


def told(body: Object, now: Reading, before: Reading | None, tolerance: float = 0.0) -> records.BodyState | None:
    """What of a body is to be told.

    Args:
        body: the object.
        now: its state.
        before: what was told last; None tells everything.
        tolerance: differences up to this (m, rad, quaternion parts) are not worth telling.

    Returns:
        The record, None if nothing changed.
    """
    state = records.BodyState(body=body.name)
    changed = False
    if before is None or _differs((*now.pose[0], *now.pose[1]), (*before.pose[0], *before.pose[1]), tolerance):
        state.position[:] = now.pose[0]
        state.orientation[:] = now.pose[1]
        changed = True
    moving = now.velocity != _AT_REST
    if (moving and changed) or (not tolerance and before is not None and now.velocity != before.velocity):
        state.velocity[:] = now.velocity
        changed = True
    picked: Sequence[int]
    if before is None:
        picked = range(len(now.positions))
    elif tolerance:
        picked = [i for i, q in enumerate(now.positions) if abs(q - before.positions[i]) > tolerance]
    else:
        old = list(zip(before.positions, before.velocities, strict=True))
        picked = [i for i, pair in enumerate(zip(now.positions, now.velocities, strict=True)) if pair != old[i]]
    if picked:
        names = body.joints
        state.joints[:] = [names[i] for i in picked]
        state.joint_positions[:] = [now.positions[i] for i in picked]
        if any(now.velocities[i] for i in picked):
            state.joint_velocities[:] = [now.velocities[i] for i in picked]
        changed = True
    return state if changed else None


def _differs(a: Iterable[float], b: Iterable[float], tolerance: float) -> bool:
    return any(abs(x - y) > tolerance for x, y in zip(a, b, strict=True))


def _sign(record: records.Mutation) -> None:
    """Writes into a change where in the plan it is made, unless the task that it is part of tells that."""
    if journal.is_unrecorded():
        return
    task = span.current()
    asked = task.source if task is not None else None
    if asked is not None and call_site() in (asked.line, ("", 0)):
        return
    way = span.current_call_stack()
    record.source_file, record.source_line = way.line
    record.callers.extend(way.callers)


@dataclass(slots=True)
class Change:
    """A change in the making.

    Attributes:
        command: what was asked, as its record tells it.
        touched: objects whose state may be another now.
        removed: names of bodies that are gone.
        attached: attachments made or with a new relative pose.
        detached: attachments ended.
        hold: what holds Ctrl-C back until the change is on record.
        samples: states on the way, of a simulated stretch.
        events: what to announce: prepares a firing under the lock, gives the calls to make after it.
    """

    command: records.Mutation
    hold: Uninterrupted
    touched: dict[str, Object] = field(default_factory=dict)
    removed: list[str] = field(default_factory=list)
    attached: dict[tuple[str, str], Attachment] = field(default_factory=dict)
    detached: list[Attachment] = field(default_factory=list)
    samples: list[records.Sample] = field(default_factory=list)
    events: list[Callable[[], Callable[[], None]]] = field(default_factory=list)

    def touch(self, *bodies: Object) -> None:
        """Notes objects whose state may have changed."""
        for body in bodies:
            self.touched[body.name] = body

    def attach(self, attachment: Attachment) -> None:
        """Notes an attachment that is new or has a new relative pose."""
        self.attached[attachment.carrier.name, attachment.body.name] = attachment

    def concerned(self) -> set[str]:
        """Names of the objects of which anything may be another now."""
        held = (*self.attached.values(), *self.detached)
        return {*self.touched, *self.removed, *(side.name for one in held for side in (one.carrier, one.body))}


class Observer(Protocol):
    """Somebody who follows a world; called with its lock held, so that he sees every change, in order.

    He must not call user code, nor wait for anybody.
    """

    def passed(self) -> None:
        """Simulated time has passed, within a change."""

    def changed(self, done: Change) -> None:
        """A change was made and is on record."""


class TransactionManager:
    """The lock, the refusals and the records of one world.

    Attributes:
        lock: held from validating a change to emitting its record.
        query: the reasoning query that runs, during which changes are refused.
        observer: who follows the world.
    """

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self.lock = WorldLock()
        self.query = ""
        self.observer: Observer | None = None
        self._seen: dict[str, Reading] = {}
        self._since_keyframe = 0

    @contextmanager
    def change(self, command: records.Mutation) -> Iterator[Change]:
        """Makes one change.

        The block validates first and then acts in the engine, and notes in the change what it touched.

        Args:
            command: a mutation with its command only.

        Yields:
            The change to note things in.

        Raises:
            WorldClosed: the world has ended.
            ChangeRefused: a reasoning query runs in this world.
            RecordingError: the record can't be kept.
            Cancelled: the branch of the plan that asks for it has been told to stop.
        """
        if not self.lock.is_held:  # what is made of several changes is done as a whole
            before_change()
        with self.lock, Uninterrupted() as hold:
            self.check(str(command.WhichOneof("command")).replace("_", " "))
            change = Change(command, hold)
            yield change
            for name in change.removed:
                self._seen.pop(name, None)
            if journal.recording():
                self._emit(change)
            if self.observer is not None:
                self.observer.changed(change)
            self.lock.defer(prepare() for prepare in change.events)

    def check(self, action: str) -> None:
        """Refuses what can't be now.

        Args:
            action: what is tried, for the error.

        Raises:
            WorldClosed: the world has ended.
            ChangeRefused: a reasoning query runs in this world.
        """
        if self._world.closed:
            raise WorldClosed(self._world.name, action)
        if self.query:
            raise ChangeRefused(action, self.query)

    def _emit(self, change: Change) -> None:
        world, record = self._world, change.command
        effect = record.effect
        for name, body in change.touched.items():
            now = read(body)
            state = told(body, now, self._seen.get(name))
            self._seen[name] = now
            if state is not None:
                effect.bodies.append(state)
        effect.removed.extend(change.removed)
        effect.attached.extend(attachment.record() for attachment in change.attached.values())
        effect.detached.extend(attachment.record() for attachment in change.detached)
        effect.samples.extend(change.samples)
        _sign(record)
        journal.emit(record, world=world.name, sim_step=world.sim_step)
        self._since_keyframe += 1
        if self._since_keyframe >= CHANGES_PER_KEYFRAME and not world.closed:
            journal.emit(self.keyframe(), world=world.name, sim_step=world.sim_step)

    def sample(self, steps: int, before: dict[str, Reading]) -> records.Sample | None:
        """The bodies that moved visibly since the sample before.

        Args:
            steps: simulated steps of the world at the sample.
            before: readings of the sample before; updated.
        """
        sample = records.Sample(sim_step=steps)
        for body in self._world.objects:
            now = read(body)
            state = told(body, now, before.get(body.name), tolerance=1e-5)
            if state is not None:
                before[body.name] = now
                sample.bodies.append(state)
        return sample if sample.bodies else None

    def keyframe(self) -> records.Keyframe:
        """The world's whole state as a record."""
        world = self._world
        frame = records.Keyframe(
            mode=world.mode,
            gravity=world.gravity,
            realtime=world.realtime,
            robot=world.robot.name if world.robot else "",
        )
        for body in world.objects:
            now = read(body)
            frame.loaded.append(body.load_record)
            state = told(body, now, None)
            if state is not None:
                frame.bodies.append(state)
            self._seen[body.name] = now
            frame.attachments.extend(held.record() for held in body.attachments.values() if held.carrier is body)
        self._since_keyframe = 0
        return frame
