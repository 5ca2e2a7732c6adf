"""World transactions: the one way in which a world changes.

Validate, act in the engine, read the state back, emit one record, notify the observer, fire events. The world's lock is
held from validating to notifying the observer, so the order of records is the order of changes. Handlers of events are
user code: they are called when the lock is free again (:mod:`pycram.world.lock`). One change, as in
``Object.set_position``::

    with world.transactions.begin(records.Mutation(move_body=command)) as transaction:
        world.engine.set_pose(body.handle, pose)
        transaction.mark_modified(body)
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

from pycram.foundation.failures import ChangeRefused, WorldClosed
from pycram.scheduling.cancellation import before_change
from pycram.world.lock import WorldLock
from pycram.world.snapshot import state_delta, take_snapshot
from recorder import records
from recorder.tracing import context, journal, span
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pycram.physics.body import Snapshot
    from pycram.world.attachment import Attachment
    from pycram.world.event import Event
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld
    from recorder.tracing.journal import Journal

#: A keyframe costs 0.3 ms and 3 kB; with one each 100 transactions any step is folded from at most 100 records.
TRANSACTIONS_PER_KEYFRAME: Final = 100


@dataclass(slots=True)
class Transaction:
    """A change of a world that isn't recorded yet, and all that it has changed so far.

    Attributes:
        command: The record, at first with its command only.
        interrupts: Holds Ctrl-C back until the transaction is recorded.
        modified: Objects whose state may have changed, by name.
        removed: Names of removed objects.
        attached: Attachments that are new or have a new relative pose, by the names of carrier and body.
        detached: Attachments that ended.
        samples: States within a simulation.
        number: Sets what the command says of other steps, before a recording takes it.
        callbacks: Called with the lock held when the transaction is recorded; each gives a call to make after that.
    """

    command: records.Mutation
    interrupts: Uninterrupted
    modified: dict[str, Object] = field(default_factory=dict)
    removed: list[str] = field(default_factory=list)
    attached: dict[tuple[str, str], Attachment] = field(default_factory=dict)
    detached: list[Attachment] = field(default_factory=list)
    samples: list[records.Sample] = field(default_factory=list)
    number: Callable[[Journal], None] | None = None
    callbacks: list[Callable[[], Callable[[], None]]] = field(default_factory=list)

    def mark_modified(self, *bodies: Object) -> None:
        """Have the state of objects read back and compared with their last records."""
        for body in bodies:
            self.modified[body.name] = body

    def mark_attached(self, attachment: Attachment) -> None:
        """Record an attachment that is new or has a new relative pose."""
        self.attached[attachment.carrier.name, attachment.body.name] = attachment

    def fire(self, event: Event, *arguments: object) -> None:
        """Fire an event when the transaction is recorded."""
        self.callbacks.append(partial(event.prepare, *arguments))

    def affected(self) -> set[str]:
        """Return the names of all objects of which anything may have changed."""
        ends = (*self.attached.values(), *self.detached)
        return {*self.modified, *self.removed, *(body.name for end in ends for body in (end.carrier, end.body))}


class Observer(Protocol):
    """A follower of a world's transactions, called with its lock held, in their order.

    It must not call user code nor wait for anything.
    """

    def time_passed(self) -> None:
        """Notice that simulated time has passed, within a transaction."""

    def has_news(self) -> bool:
        """Whether simulated time has changed what somebody waits for."""

    def committed(self, transaction: Transaction) -> None:
        """Notice that a transaction was made and is recorded."""


class TransactionManager:
    """The lock, the refusals and the records of one world.

    Attributes:
        lock: Held from validating a change to emitting its record.
        query: The reasoning query that runs, during which changes are refused; "" for none.
        observer: The follower of the world.
    """

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self.lock = WorldLock()
        self.query = ""
        self.observer: Observer | None = None
        self._recorded: dict[str, Snapshot] = {}
        self._since_keyframe = 0

    @contextmanager
    def begin(self, command: records.Mutation) -> Iterator[Transaction]:
        """Make one transaction: the block validates, acts in the engine, and marks what it modified.

        Args:
            command: A record with its command only.

        Raises:
            WorldClosed: The world has ended.
            ChangeRefused: A reasoning query runs in this world.
            RecordingError: The record can't be written.
            Cancelled: The branch of the plan that asks for it is cancelled.
            RunsEarly: Actions of the plan that come before it have not run.
            RecursionError: There is no room on the stack for making and recording it.
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
            steps = self._record(transaction) if journal.recording() else {}
            self._world.beliefs.follow(transaction, steps)
            if self._since_keyframe >= TRANSACTIONS_PER_KEYFRAME and not self._world.closed:
                self._record_keyframe()
            if self.observer is not None:
                self.observer.committed(transaction)
            self.lock.defer(callback() for callback in transaction.callbacks)

    def check(self, action: str) -> None:
        """Refuse an action that is impossible now.

        Args:
            action: What is tried, for the error.

        Raises:
            WorldClosed: The world has ended.
            ChangeRefused: A reasoning query runs in this world.
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
        return span.emit(record, world=world.name, sim_step=world.sim_step, number=transaction.number)

    def _record_keyframe(self) -> None:
        world, frame = self._world, self.keyframe()

        def number(journal: Journal) -> None:
            del frame.beliefs[:]
            frame.beliefs.extend(world.beliefs.records(journal))

        journal.emit(frame, world=world.name, sim_step=world.sim_step, number=number)

    def keyframe(self) -> records.Keyframe:
        """Return the world's whole state as a record; the steps in what is believed are none of any recording."""
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
        self._since_keyframe = 0
        return frame
