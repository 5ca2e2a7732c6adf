"""World transactions: every change of a world is a transaction, which is recorded.

A transaction checks the change, makes it in the engine, reads the state back, emits one record and fires events. A
transaction holds the world's lock, so records have the order of changes. Event handlers run after the release of the
lock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

from pycram.foundation.errors import call_all, chained
from pycram.foundation.failures import ChangeRefused, ReadOnly, WorldClosed
from pycram.foundation.refusals import refused
from pycram.physics.body import Snapshot
from pycram.scheduling.cancellation import before_change
from pycram.scheduling.schedule import Lock
from pycram.world.event import Event
from recorder import records
from recorder.tracing import context, journal, span
from recorder.tracing.interrupts import Uninterrupted
from recorder.tracing.journal import Journal

if TYPE_CHECKING:
    from pycram.world.attachment import BodyAttachment
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

#: Number of changes before a keyframe; these changes must also affect at least as many objects as the world has. A
#: keyframe of 10 objects costs 0.3 ms and 3 kB; its share in the cost of a change hardly depends on the number of
#: objects.
TRANSACTIONS_PER_KEYFRAME: Final = 100
AT_REST: Final = (0.0,) * 6  # velocity of an object at rest, m/s and rad/s


@dataclass(slots=True)
class Transaction:
    """A change of a world before it is recorded."""

    command: records.Mutation  # the record, which at first contains only its command
    interrupts: Uninterrupted  # delays Ctrl-C until the transaction is recorded
    modified: dict[str, Object] = field(default_factory=dict)  # objects whose states may have changed, by name
    removed: list[str] = field(default_factory=list)  # names of removed objects
    #: Attachments that are new or have a new relative pose; the keys are the names of the carrier and the body.
    attached: dict[tuple[str, str], BodyAttachment] = field(default_factory=dict)
    detached: list[BodyAttachment] = field(default_factory=list)  # attachments that ended
    samples: list[records.Sample] = field(default_factory=list)  # states within a simulation
    number: Callable[[Journal], None] | None = None  # sets step numbers in the command for a recording
    #: Functions that are called under the lock when the transaction is recorded. Each returns a function that is called
    #: after the lock's release.
    callbacks: list[Callable[[], Callable[[], None]]] = field(default_factory=list)

    def mark_modified(self, *bodies: Object) -> None:
        """Mark changed objects; the transaction reads their states back, and compares them with their records."""
        for body in bodies:
            self.modified[body.name] = body

    def fire(self, event: Event, *arguments: object) -> None:
        """Fire an event after the transaction is recorded."""
        self.callbacks.append(partial(event.prepare, *arguments))

    def affected(self) -> set[str]:
        """Return the names of all objects that the transaction may have changed."""
        ends = (*self.attached.values(), *self.detached)
        return {*self.modified, *self.removed, *(body.name for end in ends for body in (end.carrier, end.body))}


class Observer(Protocol):
    """An observer of a world's transactions; a world calls them in order, under its lock. Observers must not wait."""

    def time_passed(self) -> None:
        """Handle the passing of simulated time within a transaction."""

    def has_news(self) -> bool:
        """Return whether simulated time has changed an awaited value."""

    def committed(self, transaction: Transaction) -> None:
        """Handle a recorded transaction."""


class TransactionManager:
    """Manages the lock and the records of one world, and refuses changes during queries."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self.lock = WorldLock()
        self.query = ""  # the reasoning query that runs now and forbids changes; "" without a query
        self.observer: Observer | None = None
        self._recorded: dict[str, Snapshot] = {}
        self._since_keyframe = self._changed_since_keyframe = 0  # counts of changes and of changed objects

    @contextmanager
    def begin(self, command: records.Mutation) -> Iterator[Transaction]:
        """Make one transaction; the ``with`` block checks, changes the engine, and marks the modified objects.

        ``command`` is a record that contains only a command.

        Raises:
            WorldClosed: The world has ended.
            ChangeRefused: A reasoning query runs in this world.
            RecordingError: The record can't be written.
            Cancelled: The branch is cancelled.
            RunsEarly: Earlier actions of the plan haven't run.
            RecursionError: The stack has no room for the change and its record.
        """
        context.require_stack_room(context.FOR_TASK)
        change = str(command.WhichOneof("command")).replace("_", " ")
        before_change(change)
        with self.lock, Uninterrupted() as interrupts:
            self.check(change)
            transaction = Transaction(command, interrupts)
            yield transaction
            for name in transaction.removed:
                self._recorded.pop(name, None)
            self._world.beliefs.follow(transaction, self._record(transaction) if journal.recording() else {})
            due = self._since_keyframe >= TRANSACTIONS_PER_KEYFRAME
            if due and self._changed_since_keyframe >= len(self._world.objects) and not self._world.closed:
                world, frame = self._world, self.keyframe()
                self._since_keyframe = self._changed_since_keyframe = 0

                def number(journal: Journal) -> None:
                    del frame.beliefs[:]
                    frame.beliefs.extend(world.beliefs.records(journal))

                journal.emit(frame, world=world.name, sim_step=world.sim_step, number=number)
            if self.observer is not None:
                self.observer.committed(transaction)
            self.lock.defer(callback() for callback in transaction.callbacks)

    def check(self, action: str) -> None:
        """Raise WorldClosed if the world has ended, or ChangeRefused during a reasoning query.

        ``action`` is the name of the change in the message.
        """
        if self._world.closed:
            raise WorldClosed(self._world.name, action)
        if self.query:
            raise ChangeRefused(action, self.query)

    def _record(self, transaction: Transaction) -> Mapping[Journal, int]:
        world, record = self._world, transaction.command
        effect = record.effect
        for name, body in transaction.modified.items():
            now = take_snapshot(body)
            delta = state_delta(body, now, self._recorded.get(name))
            self._recorded[name] = now
            if delta is not None:
                effect.bodies.append(delta)
        effect.removed.extend(transaction.removed)
        effect.attached.extend(attachment.record() for attachment in transaction.attached.values())
        effect.detached.extend(attachment.record() for attachment in transaction.detached)
        effect.samples.extend(transaction.samples)
        self._since_keyframe += 1
        self._changed_since_keyframe += max(1, len(effect.bodies))
        return span.emit(record, world=world.name, sim_step=world.sim_step, number=transaction.number)

    def keyframe(self) -> records.Keyframe:
        """Return the world's whole state as a record; its beliefs have no step numbers."""
        world = self._world
        frame = records.Keyframe(
            mode=world.mode,
            gravity=world.gravity,
            realtime=world.realtime,
            robot=world.robot.name if world.robot else "",
        )
        for body in world.objects:
            now = take_snapshot(body)
            frame.loaded.append(body.load_record)
            state = state_delta(body, now, None)
            if state is not None:
                frame.bodies.append(state)
            self._recorded[body.name] = now
            frame.attachments.extend(attachment.record() for attachment in body.carried)
        frame.beliefs.extend(world.beliefs.records())
        frame.following.extend(followed.following for followed in world.trajectories.active.values())
        return frame


def take_snapshot(body: Object) -> Snapshot:
    """Return the state of an object in the engine."""
    return body.world.engine.snapshot(body.handle)


def restore_snapshot(body: Object, snapshot: Snapshot) -> None:
    """Set an object to a snapshot of itself, or of the same model in another world; motors hold its joints.

    Only worlds that are rebuilt from recordings need this change, which isn't a transaction. During a recording, which
    would miss the change, RuntimeError is raised.
    """
    if journal.recording():
        raise RuntimeError(f"the state of {body.name} can only be restored while nothing is recorded")
    engine, handle = body.world.engine, body.handle
    engine.set_pose(handle, snapshot.pose)
    if not body.fixed and snapshot.velocity != AT_REST:
        engine.set_velocity(handle, snapshot.velocity)
    positions = dict(zip(body.joints, snapshot.positions, strict=True))
    engine.set_joints(handle, positions, dict(zip(body.joints, snapshot.velocities, strict=True)))


def state_delta(body: Object, now: Snapshot, last: Snapshot | None, tolerance: float = 0.0) -> records.BodyState | None:
    """Return the changes of an object's state since the state ``last``, or the whole state; None without changes.

    Differences of poses and joints up to ``tolerance`` (m, rad, quaternion components) don't count. If the tolerance
    isn't 0, a change of only velocities doesn't count.
    """
    if now is last:  # the engine returns the same snapshot until a body changes
        return None
    state = records.BodyState(body=body.name)
    changed = False
    numbers = () if last is None else zip((*now.pose[0], *now.pose[1]), (*last.pose[0], *last.pose[1]), strict=True)
    if last is None or any(abs(a - b) > tolerance for a, b in numbers):
        state.position[:], state.orientation[:] = now.pose
        changed = True
    if (changed and now.velocity != AT_REST) or (not tolerance and last is not None and now.velocity != last.velocity):
        state.velocity[:] = now.velocity
        changed = True
    joints = _changed_joints(now, last, tolerance)
    if joints:
        names = body.joints
        state.joints[:] = [names[i] for i in joints]
        state.joint_positions[:] = [now.positions[i] for i in joints]
        if any(now.velocities[i] for i in joints):
            state.joint_velocities[:] = [now.velocities[i] for i in joints]
        changed = True
    return state if changed else None


def _changed_joints(now: Snapshot, last: Snapshot | None, tolerance: float) -> Sequence[int]:
    if last is None:
        return range(len(now.positions))
    if tolerance:
        return [i for i, position in enumerate(now.positions) if abs(position - last.positions[i]) > tolerance]
    before = zip(last.positions, last.velocities, strict=True)
    after = zip(now.positions, now.velocities, strict=True)
    return [i for i, (old, new) in enumerate(zip(before, after, strict=True)) if old != new]


class WorldLock(Lock):
    """A world's re-entrant lock, which isn't held while event handlers or other branches run.

    Calls of event handlers are deferred until the thread has released the lock completely: a handler may wait for
    another thread that needs this world.
    """

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0
        self.contenders: set[int] = set()  # idents of the threads that wait for the lock
        self._deferred: list[Callable[[], None]] = []

    def defer(self, calls: Iterable[Callable[[], None]]) -> None:
        """Make calls in order, after the thread that holds the lock has released it."""
        self._deferred.extend(calls)

    def __enter__(self) -> None:
        if not self._try():
            thread = threading.get_ident()
            self.contenders.add(thread)
            try:
                super().__enter__()
            finally:
                self.contenders.remove(thread)
        self._depth += 1

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Release the lock, then make the deferred calls; then raise their first error.

        If the ``with`` block failed, its error propagates instead, with the errors of calls as its context.
        """
        deferred: list[Callable[[], None]] = []
        self._depth -= 1
        if not self._depth:
            deferred, self._deferred = self._deferred, []
        super().__exit__(kind, error, trace)
        errors = call_all(deferred)
        if error is not None:
            chained(error, errors)
        elif errors:
            raise chained(errors[0], errors[1:])


class ReadOnlyAttributes:
    """Base of classes whose public attributes only transactions change; property setters still work.

    After :meth:`_seal`, assigning or deleting a public attribute raises ReadOnly, which names a method to use instead.
    Plans and subclasses may add other attributes.
    """

    _SUBJECT: ClassVar[str]  # name of the object in records of refusals
    _CHANGED_BY: ClassVar[Mapping[str, str]]  # for each attribute, the method to use instead; "" if there is none
    _sealed: frozenset[str] = frozenset()

    def _seal(self, kind: type) -> None:
        """Make the present attributes of the object and of the class read-only."""
        settable = {name for name, member in vars(kind).items() if isinstance(member, property) and member.fset}
        self._sealed = frozenset(name for name in (vars(self).keys() | vars(kind).keys()) - settable if name[0] != "_")

    def __setattr__(self, name: str, value: object) -> None:
        if name in self._sealed:
            raise self._refused(name, f"{name} = ...", {"value": value})
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        if name in self._sealed:
            raise self._refused(name, f"del {name}", {})
        super().__delattr__(name)

    def _refused(self, name: str, called: str, arguments: Mapping[str, object]) -> ReadOnly:
        instead = self._CHANGED_BY.get(name) or self._CHANGED_BY[""]
        return refused(ReadOnly(repr(self), name, instead), called, {self._SUBJECT: self, **arguments})


def update(owner: ReadOnlyAttributes, **values: object) -> None:
    """Set read-only attributes in a transaction, which records the change."""
    vars(owner).update(values)
