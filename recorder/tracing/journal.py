"""The journal: numbers records, orders them, and passes them to sinks.

Lock order: a world's lock, then a journal's lock, never the other way round. A journal calls no user code and no world
while it holds its lock. Callers of :func:`emit` hold the lock of the changed world, so changes have the same order in
the log and in the world. If a sink can't keep a record or file, every function that appends raises its RecordingError.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

from recorder.records import TOPICS, Keyframe, Mutation, Output, Record, Strike
from recorder.records.values import AssetFile
from recorder.tracing import context
from recorder.tracing.context import KnownWorld, current_name
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path


class Sink(Protocol):
    """The destination of records. The journal calls it in order, under its lock; the sink must not call the journal.

    It must not keep references to mutations and keyframes. It may keep other records; later, only the number and time
    of a kept record may change, when another journal records it.
    """

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Take a record and its serialized form; raise RecordingError if the record can't be kept."""

    def attach(self, asset: AssetFile) -> None:
        """Take a file; files with the same content are passed only once."""

    def flush(self) -> None:
        """Write all buffered records; raise RecordingError if that fails."""

    def close(self) -> None:
        """Write all buffered records, and close."""


class NullSink:
    """A sink that drops all records and files; subclasses override some of its methods."""

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Drop a record."""

    def attach(self, asset: AssetFile) -> None:
        """Drop a file."""

    def flush(self) -> None:
        """Do nothing: no record is buffered."""

    def close(self) -> None:
        """Do nothing: no file is open."""


class RecordedWorld(KnownWorld, Protocol):
    """A world, as journals use it."""

    def record_keyframe(self, journal: Journal) -> None:
        """Append the whole state to a journal, with its assets."""


class Journal:
    """Numbers records for several sinks.

    ``clock_ns`` returns ns since the Unix epoch; ``monotonic_ns`` returns ns of a steady clock. With
    ``local_variables``, recorded failures may contain the plan's local variables.
    """

    def __init__(
        self,
        sinks: Sequence[Sink],
        clock_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        *,
        local_variables: bool = True,
    ) -> None:
        self.local_variables = local_variables
        self._sinks = tuple(sinks)
        self._clock_ns, self._monotonic_ns = clock_ns, monotonic_ns
        self._began_ns = monotonic_ns()
        self._lock = threading.RLock()
        self._writing = self._resuming = False
        # records and files that arrived while this thread was writing
        self._interrupting: deque[Record | AssetFile] = deque()
        self._strikes: list[Strike] = []  # strikes since the latest record
        self._next = 0
        self._latest_ns = 0
        self._attached: set[str] = set()
        self._expected: set[str] = set()

    @property
    def length(self) -> int:
        """Number of records, which is the next record's ``seq``."""
        return self._next

    def add_sink(self, sink: Sink) -> None:
        """Add a sink. It receives all later records, and is closed together with the other sinks."""
        with self._lock:
            self._sinks = (*self._sinks, sink)

    def remove_sink(self, sink: Sink) -> None:
        """Remove a sink, which stays open."""
        with self._lock:
            self._sinks = tuple(each for each in self._sinks if each is not sink)

    def expect_keyframes(self, worlds: Iterable[str]) -> None:
        """Skip mutations of these worlds until their next keyframes, which include the mutations."""
        with self._lock:
            self._expected.update(worlds)

    def append(self, record: Record) -> int:
        """Set the number and times of a record, and keep the record; return its size in bytes.

        The size is 0 if the record is skipped (:meth:`expect_keyframes`) or if it is queued because this thread is
        writing another record. Output of signal handlers, finalizers and sinks is queued.
        """
        record.cause = _cause.get().get(self, 0)
        return self._take(record)

    def strike(self, strike: Strike) -> None:
        """Keep a strike, which is written with the next record."""
        with self._lock:
            self._strikes.append(strike)

    def attach(self, assets: Iterable[AssetFile]) -> None:
        """Keep files; files with the same content are kept once."""
        for asset in assets:
            self._take(asset)

    def _take(self, item: Record | AssetFile) -> int:
        with Uninterrupted(), self._lock:
            if self._writing:
                if not (
                    self._resuming and isinstance(item, Output)
                ):  # otherwise a sink that prints would print forever
                    self._interrupting.append(item)
                return 0
            self._writing = True
            try:
                size = self._write(item)
                self._resuming = True
                while self._interrupting:
                    self._write(self._interrupting.popleft())
            finally:
                self._writing = self._resuming = False
            return size

    def _write(self, item: Record | AssetFile) -> int:
        if isinstance(item, AssetFile):
            if item.key not in self._attached:
                for sink in self._sinks:
                    sink.attach(item)
                self._attached.add(item.key)
            return 0
        if self._expected and item.world in self._expected and isinstance(item, (Mutation, Keyframe)):
            if isinstance(item, Mutation) and not item.HasField("open_world"):
                return 0
            self._expected.remove(item.world)
        self._latest_ns = max(self._clock_ns(), self._latest_ns)  # log time never decreases
        del item.strikes[:]  # strikes that another journal has added
        if self._strikes:
            item.strikes.extend(self._strikes)
            self._strikes.clear()
        item.seq = self._next
        item.wall_time_ns = self._latest_ns
        item.monotonic_ns = self._monotonic_ns() - self._began_ns
        self._next += 1
        topic, payload = TOPICS[type(item)], item.SerializeToString()
        for sink in self._sinks:
            sink.write(topic, item, payload)
        return len(payload)

    def flush(self) -> None:
        """Flush all sinks, unless this thread is appending a record."""
        with Uninterrupted(), self._lock:
            if not self._writing:
                for sink in self._sinks:
                    sink.flush()

    def locks(self) -> list[threading.RLock]:
        """Return the locks of the journal and its sinks, in the order in which they must be acquired."""
        return [self._lock, *filter(None, (getattr(sink, "lock", None) for sink in self._sinks))]

    def close(self) -> None:
        """Close every sink; an error is raised after all sinks are closed."""
        with Uninterrupted(), self._lock, ExitStack() as closing:
            for sink in reversed(self._sinks):
                closing.callback(sink.close)


class RunningTask(Protocol):
    """A task, as the journal uses it."""

    @property
    def id(self) -> int:
        """Its number, from 1."""

    def announce(self) -> None:
        """Record the request of the task, unless its request or its start is recorded."""


#: The running task of this context, or None; set by :mod:`recorder.tracing.span`.
current_task: ContextVar[RunningTask | None] = ContextVar("pycram_task", default=None)


def task_id() -> int:
    """Return the id of the running task of this context; 0 without a task."""
    task = current_task.get()
    return task.id if task is not None else 0


def announced_task_id() -> int:
    """Return the id of the task that runs in this context, 0 without a task; its beginning is recorded first.

    A block's body runs before the block's branch starts, and may already change a world.
    """
    task = current_task.get()
    if task is None:
        return 0
    task.announce()
    return task.id


_registry = threading.Lock()
_open: tuple[Journal, ...] = ()
_opened = 0  # number of journals that were opened
_sources: tuple[RecordedWorld, ...] = ()  # the known worlds; replaced, not mutated
_isolated: ContextVar[tuple[Journal, ...] | None] = ContextVar("pycram_unrecorded", default=None)


def listening() -> tuple[Journal, ...]:
    """Return the journals that record this context."""
    own = _isolated.get()
    return _open if own is None else own


def recording() -> bool:
    """Return whether any journal records this context; if not, callers needn't build records."""
    return bool(listening())


def is_unrecorded() -> bool:
    """Return whether this context is isolated from the plan's recordings; see :func:`unrecorded`."""
    return _isolated.get() is not None


@contextmanager
def unrecorded(*journals: Journal) -> Iterator[None]:
    """Isolate the block from the plan's recordings; only ``journals`` record it.

    Outside of the block, the worlds that it opens are unknown until they are announced.
    """
    token = _isolated.set(journals)
    try:
        yield
    finally:
        _isolated.reset(token)


#: The step, in each journal, of the event whose handler runs in this context.
_cause: ContextVar[Mapping[Journal, int]] = ContextVar("pycram_cause", default=MappingProxyType({}))


@contextmanager
def caused_by(event: Mapping[Journal, int]) -> Iterator[None]:
    """Mark the block's records as caused by an event, which is given by its step in each journal."""
    token = _cause.set(event)
    try:
        yield
    finally:
        _cause.reset(token)


def emit(
    record: Record,
    *,
    world: str = "",
    sim_step: int = 0,
    task: int | None = None,
    number: Callable[[Journal], None] | None = None,
) -> Mapping[Journal, int]:
    """Complete a record's envelope and append it to every open journal; return its step in each journal.

    Args:
        record: the record without its envelope.
        world: name of the record's world, if any.
        sim_step: simulated steps of that world.
        task: id of its task; by default the current task.
        number: function that sets references to steps, which each journal numbers differently; called for each journal.

    Raises:
        RecursionError: the stack has no room; the record isn't numbered.
    """
    context.require_stack_room(context.FOR_RECORD)
    record.world = world
    record.sim_step = sim_step
    record.task = announced_task_id() if task is None else task
    record.thread = current_name()
    steps = {}
    for journal in listening():
        if number is not None:
            number(journal)
        journal.append(record)
        steps[journal] = record.seq
    return steps


def publish(record: Record) -> int:
    """Append a record with its envelope to every open journal; return its size in bytes, 0 without a journal."""
    size = 0
    for journal in listening():
        size = journal.append(record)
    return size


def records_here(journal: Journal) -> bool:
    """Return whether a journal is open and records this context."""
    return journal in listening()


def keeps_local_variables() -> bool:
    """Return whether this context is recorded, and all its journals may have local variables."""
    journals = listening()
    return bool(journals) and all(journal.local_variables for journal in journals)


#: Returns how often this thread has polled for strikes. The scheduler sets this function; without it, the count is 0.
looks: Callable[[], int] = int


def strike(look: int, which: Iterable[int]) -> None:
    """Keep a strike in every open journal. A strike is a decision of the clock or of worker threads that a poll found.

    Args:
        look: number of the poll that found the decision.
        which: indices of the polled items, from 0.
    """
    for journal in _open:
        journal.strike(Strike(look=look, which=which))


def attach(assets: Iterable[AssetFile]) -> None:
    """Keep files in every open journal."""
    files = list(assets)
    for journal in listening():
        journal.attach(files)


def flush() -> None:
    """Flush all open journals; called before native code that blocks all other threads for a long time."""
    for journal in _open:
        journal.flush()


def register(source: RecordedWorld) -> None:
    """Make a world known to journals until it is unregistered; do nothing in an isolated context."""
    global _sources  # noqa: PLW0603  see open_journal
    if _isolated.get() is None:
        with _registry:
            _sources = (*(known for known in _sources if known is not source), source)


def announce(source: RecordedWorld) -> None:
    """Make known a world that was opened unrecorded; open journals record its state now, others when they open."""
    register(source)
    for journal in listening():
        source.record_keyframe(journal)


def unregister(source: RecordedWorld) -> None:
    """Forget a closed world."""
    global _sources  # noqa: PLW0603  see open_journal
    with _registry:
        _sources = tuple(known for known in _sources if known is not source)


def current_world() -> tuple[str, int]:
    """Return the name and simulated steps of this context's current world, if it is known; otherwise "" and 0."""
    world = context.current_world(_sources)
    return (world.name, world.sim_step) if world is not None else ("", 0)


def recording_number() -> int:
    """Return the number of the latest recording of this process, from 1; 0 before the first."""
    return _opened


def open_journal(journal: Journal, running: AbstractContextManager[Iterable[Record]] | None = None) -> None:
    """Begin recording to a journal; a keyframe of each existing world comes first.

    Args:
        journal: the journal; after an error, no further records are appended to it.
        running: returns the records of the running tasks, which come first; no task can end until they are appended.

    Raises:
        RecursionError: the stack has no room for the keyframes.
    """
    global _open, _opened  # noqa: PLW0603  a process has one set of open journals
    context.require_stack_room(context.FOR_TASK)
    with _registry, running or nullcontext(()) as tasks:
        _opened += 1
        order = context.open_worlds()  # the list lacks a world that is being opened
        sources = sorted(_sources, key=lambda source: order.index(source) if source in order else len(order))
        for record in tasks:
            journal.append(record)
        journal.expect_keyframes(source.name for source in sources)
        _open = (*_open, journal)
    with ExitStack() as undoing:
        undoing.callback(forget_journal, journal)
        for source in sources:
            source.record_keyframe(journal)
        undoing.pop_all()


def close_journal(journal: Journal) -> None:
    """End recording to a journal, and close its sinks."""
    with _registry:
        forget_journal(journal)
    journal.close()


@contextmanager
def still() -> Iterator[None]:
    """Hold the locks of all open journals while the block runs, for a fork (:mod:`recorder.tracing.forking`).

    It writes little memory: a written page is no longer shared with a waiting copy of the process.
    """
    held: list[threading.RLock] = []
    try:
        with _registry:
            for journal in _open:
                for lock in journal.locks():
                    lock.acquire()
                    held.append(lock)
            yield
    finally:
        for lock in reversed(held):
            lock.release()


def paths() -> list[Path]:
    """Return the files of the journals that record this context."""
    sinks = [sink for journal in listening() for sink in journal._sinks]  # noqa: SLF001  same module
    return [sink.path for sink in sinks if hasattr(sink, "path")]


def forget_all() -> None:
    """End recording to all journals without touching their sinks, which a forked child's parent owns."""
    global _open  # noqa: PLW0603  see open_journal
    _open = ()


def forget_journal(journal: Journal) -> None:
    """End recording to a journal without touching its sinks."""
    global _open  # noqa: PLW0603  see open_journal
    _open = tuple(each for each in _open if each is not journal)
