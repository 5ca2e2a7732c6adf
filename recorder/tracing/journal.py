"""The journal numbers records, and passes records and files to sinks.

Lock order: first a world's lock, then a journal's lock. A journal that holds its lock calls no user code and no world.
Callers of :func:`emit` hold the lock of the changed world, so the log has the world's order of changes. Functions that
append records raise RecordingError if a sink can't keep the record.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

from recorder.records import TOPICS, Keyframe, Mutation, Output, Record, Strike
from recorder.records.values import AssetFile
from recorder.tracing import context
from recorder.tracing.context import KnownWorld, current_name
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from recorder.tracing.span import Span


class Sink(Protocol):
    """The destination of records. The journal calls sinks with its lock held; a sink must not call the journal.

    A sink must not keep references to mutations and keyframes. A sink may keep other records, but another journal may
    later change the number and time of these records.
    """

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Take a record and its serialized form. Raise RecordingError if the record can't be kept."""

    def attach(self, asset: AssetFile) -> None:
        """Take a file. If several files have the same content, the journal passes only one of these files."""

    def flush(self) -> None:
        """Write all buffered records. Raise RecordingError if writing fails."""

    def close(self) -> None:
        """Write all buffered records, and close."""


class NullSink:
    """A sink that drops all records and files. Subclasses override some methods."""

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Drop a record."""

    def attach(self, asset: AssetFile) -> None:
        """Drop a file."""

    def flush(self) -> None:
        """Do nothing, because no record is buffered."""

    def close(self) -> None:
        """Do nothing, because no file is open."""


class Journal:
    """A journal numbers records, and passes them to several sinks.

    ``clock_ns`` returns ns since the Unix epoch, ``monotonic_ns`` ns of a steady clock. With ``local_variables``,
    recorded failures may contain local variables of the plan.
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
        self._interrupting: deque[Record | AssetFile] = deque()  # items that arrived while this thread was writing
        self._strikes: list[Strike] = []  # strikes since the latest record
        self.length = 0  # number of records; the next record has this ``seq``
        self._latest_ns = 0
        self._attached: set[str] = set()
        self._expected: set[str] = set()

    def add_sink(self, sink: Sink) -> None:
        """Add a sink, which receives all later records, and is closed with the other sinks."""
        with self._lock:
            self._sinks = (*self._sinks, sink)

    def remove_sink(self, sink: Sink) -> None:
        """Remove a sink without closing it."""
        with self._lock:
            self._sinks = tuple(each for each in self._sinks if each is not sink)

    def expect_keyframes(self, worlds: Iterable[str]) -> None:
        """Skip the mutations of these worlds until their next keyframes, which contain these changes."""
        with self._lock:
            self._expected.update(worlds)

    def append(self, record: Record) -> None:
        """Number a record, and write it. If this thread is already writing another record, the record is queued."""
        record.cause = _cause.get().get(self, 0)
        self._take(record)

    def strike(self, strike: Strike) -> None:
        """Add a strike to the next record."""
        with self._lock:
            self._strikes.append(strike)

    def attach(self, assets: Iterable[AssetFile]) -> None:
        """Attach files; if several files have the same content, attach only one of these files."""
        for asset in assets:
            self._take(asset)

    def _take(self, item: Record | AssetFile) -> None:
        with Uninterrupted(), self._lock:
            if self._writing:
                if not (self._resuming and isinstance(item, Output)):  # otherwise a sink that prints would never end
                    self._interrupting.append(item)
                return
            self._writing = True
            try:
                self._write(item)
                self._resuming = True
                while self._interrupting:
                    self._write(self._interrupting.popleft())
            finally:
                self._writing = self._resuming = False

    def _write(self, item: Record | AssetFile) -> None:
        if isinstance(item, AssetFile):
            if item.key not in self._attached:
                for sink in self._sinks:
                    sink.attach(item)
                self._attached.add(item.key)
            return
        if self._expected and item.world in self._expected and isinstance(item, (Mutation, Keyframe)):
            if isinstance(item, Mutation) and not item.HasField("open_world"):
                return
            self._expected.remove(item.world)
        self._latest_ns = max(self._clock_ns(), self._latest_ns)  # the log time must never decrease
        del item.strikes[:]  # strikes that were added through another journal
        if self._strikes:
            item.strikes.extend(self._strikes)
            self._strikes.clear()
        item.seq = self.length
        item.wall_time_ns = self._latest_ns
        item.monotonic_ns = self._monotonic_ns() - self._began_ns
        self.length += 1
        topic, payload = TOPICS[type(item)], item.SerializeToString()
        for sink in self._sinks:
            sink.write(topic, item, payload)

    def flush(self) -> None:
        """Flush all sinks, unless this thread is just appending a record."""
        with Uninterrupted(), self._lock:
            if not self._writing:
                for sink in self._sinks:
                    sink.flush()

    def locks(self) -> list[threading.RLock]:
        """Return the locks of the journal and its sinks, in the order in which they must be acquired."""
        return [self._lock, *filter(None, (getattr(sink, "lock", None) for sink in self._sinks))]

    def close(self) -> None:
        """Close every sink. An error is raised after all sinks are closed."""
        with Uninterrupted(), self._lock, ExitStack() as closing:
            for sink in reversed(self._sinks):
                closing.callback(sink.close)


#: The running task of this context, or None. :mod:`recorder.tracing.span` sets this variable.
current_task: ContextVar[Span | None] = ContextVar("pycram_task", default=None)


def task_id() -> int:
    """Return the id of the running task of this context; 0 if there is none."""
    task = current_task.get()
    return task.id if task is not None else 0


def announced_task_id() -> int:
    """Record the request of this context's running task, and return the task's id; 0 if there is none."""
    task = current_task.get()
    if task is None:
        return 0
    task.announce()  # a block's body runs before the block's branch starts, and may already change a world
    return task.id


_registry = threading.Lock()
_open: tuple[Journal, ...] = ()
_opened = 0  # number of journals that this process has opened
_sources: tuple[KnownWorld, ...] = ()  # the known worlds; a change replaces the tuple
_isolated: ContextVar[tuple[Journal, ...] | None] = ContextVar("pycram_unrecorded", default=None)


def listening() -> tuple[Journal, ...]:
    """Return the journals that record this context."""
    own = _isolated.get()
    return _open if own is None else own


def recording() -> bool:
    """Return whether a journal records this context. If not, callers needn't build records."""
    return bool(listening())


def is_unrecorded() -> bool:
    """Return whether :func:`unrecorded` isolates this context from the plan's recordings."""
    return _isolated.get() is not None


@contextmanager
def unrecorded(*journals: Journal) -> Iterator[None]:
    """Isolate a block: only ``journals`` record the block, and its new worlds are unknown until :func:`announce`."""
    token = _isolated.set(journals)
    try:
        yield
    finally:
        _isolated.reset(token)


#: The event that this context handles: its step in each journal.
_cause: ContextVar[Mapping[Journal, int]] = ContextVar("pycram_cause", default=MappingProxyType({}))


@contextmanager
def caused_by(event: Mapping[Journal, int]) -> Iterator[None]:
    """Mark the records of a block as caused by an event. ``event`` has the step of the event's record by journal."""
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
    """Complete the envelope of a record, append the record to every open journal, and return its step in each journal.

    ``task`` is the id of the record's task, by default the current task. ``number`` is called for each journal, to set
    references to steps in the record. RecursionError is raised if the stack has no room for a record.
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


def publish(record: Record) -> None:
    """Append a record with its envelope to every open journal."""
    for journal in listening():
        journal.append(record)


def records_here(journal: Journal) -> bool:
    """Return whether a journal is open and records this context."""
    return journal in listening()


def keeps_local_variables() -> bool:
    """Return whether this context has journals that all record local variables."""
    journals = listening()
    return bool(journals) and all(journal.local_variables for journal in journals)


looks: Callable[[], int] = int  # a function of the scheduler that returns how often this thread has polled for strikes


def strike(look: int, which: Iterable[int]) -> None:
    """Add a strike to every open journal. ``look`` is the number of the poll, ``which`` the indices of its sources."""
    for journal in _open:
        journal.strike(Strike(look=look, which=which))


def attach(assets: Iterable[AssetFile]) -> None:
    """Attach files to every open journal."""
    files = list(assets)
    for journal in listening():
        journal.attach(files)


def flush() -> None:
    """Flush all open journals, before native code that blocks all other threads for a long time."""
    for journal in _open:
        journal.flush()


def register(source: KnownWorld) -> None:
    """Make a world known to journals until :func:`unregister`; do nothing in an isolated context."""
    global _sources  # noqa: PLW0603  see open_journal
    if _isolated.get() is None:
        with _registry:
            _sources = (*(known for known in _sources if known is not source), source)


def announce(source: KnownWorld) -> None:
    """Make an unrecorded world known. Open journals record the world's state now, later journals when they open."""
    register(source)
    for journal in listening():
        source.record_keyframe(journal)


def unregister(source: KnownWorld) -> None:
    """Forget a closed world."""
    global _sources  # noqa: PLW0603  see open_journal
    with _registry:
        _sources = tuple(known for known in _sources if known is not source)


def current_world() -> tuple[str, int]:
    """Return the name and simulated steps of this context's current world; "" and 0 if unknown."""
    world = context.current_world(_sources)
    return (world.name, world.sim_step) if world is not None else ("", 0)


def recording_number() -> int:
    """Return the number of the latest recording of this process, from 1; 0 before the first recording."""
    return _opened


def open_journal(journal: Journal, running: AbstractContextManager[Iterable[Record]] | None = None) -> None:
    """Begin recording to a journal. First, a keyframe of each existing world is recorded.

    The context manager ``running`` returns the records of running tasks, and keeps tasks from starting or ending. After
    an error, such as a RecursionError on a full stack, the journal gets no further records.
    """
    global _open, _opened  # noqa: PLW0603
    context.require_stack_room(context.FOR_TASK)
    with _registry, running or nullcontext(()) as tasks:
        _opened += 1
        order = context.open_worlds()  # a world that is just being opened isn't in the list
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
    """Hold the locks of all open journals in a block, for a fork (:mod:`recorder.tracing.forking`)."""
    held: list[threading.RLock] = []  # an ExitStack would write more memory, which processes then no longer share
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
    """End recording to all journals in a forked child. Their sinks belong to the parent process."""
    global _open  # noqa: PLW0603  see open_journal
    _open = ()


def forget_journal(journal: Journal) -> None:
    """End recording to a journal without touching its sinks."""
    global _open  # noqa: PLW0603  see open_journal
    _open = tuple(each for each in _open if each is not journal)
