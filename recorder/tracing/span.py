"""The running task: a span for each node of the task tree.

Records belong to the span of their context. Plain threads start with an empty context, so threads that belong to a task
must use ``contextvars.copy_context().run``. Spans make records even if nothing is recorded, for the tree of the running
plan (:func:`tree`).
"""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import Token
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Self, TypeAlias

from recorder.records import (
    Decision,
    Event,
    Fluent,
    Mutation,
    Query,
    Refusal,
    Subscription,
    Task,
    arguments,
    escaped,
    failure,
    to_json,
)
from recorder.tasks import Tree
from recorder.tracing import context, journal
from recorder.tracing.call_stack import CallStack, call_site, failure_with_frames, walk
from recorder.tracing.context import current_name
from recorder.tracing.interrupts import Uninterrupted
from recorder.tracing.journal import Journal

if TYPE_CHECKING:
    Located: TypeAlias = Mutation | Event | Subscription | Query | Refusal | Fluent  # records with the plan's line

MAX_TASKS: Final = 20_000  # largest number of tasks in the tree; a plan may run for days
MAX_BYTES: Final = 100_000_000

_ids = itertools.count(1)
_tree: Final = Tree(MAX_TASKS, MAX_BYTES)
_tree_of = 0  # number of the recording that contains the tree's tasks; 0 before the first recording
_running: Final[dict[int, Task]] = {}  # the first records of running tasks, by id
_emitting: Final = threading.RLock()  # the lock for changes of ``_tree`` and ``_running``
_current: Final = journal.current_task


class Cancelled(BaseException):
    """The task was cancelled, because a block around it was decided. ``except Exception`` doesn't catch this error."""


def tree() -> Tree:
    """Return the growing tree of the latest recording's last 20,000 tasks; without a recording, of the process."""
    return _tree


@dataclass(slots=True)
class Span:
    """A running task. Used as a context manager, the span is the task of the block."""

    kind: str  # motion, process-module, block, branch, failure-handling, attempt, timeout, cleanup, ...
    name: str  # name of the task
    parent: int = field(default_factory=journal.task_id)  # id of the task around this one; 0 if there is none
    parameters: Mapping[str, object] = field(default_factory=dict)
    attempt: int = 0  # number of the attempt, from 1; 0 for other kinds of tasks
    source: CallStack | None = None  # call stack of the request; None to use the call stack of the start
    id: int = field(default_factory=_ids.__next__)  # id of the task, unique in this process, from 1
    solution: Mapping[str, object] = field(default_factory=dict)  # the resolved solution
    result: object = None
    error: BaseException | None = None  # failure that ends the task although no exception is raised
    decision: Decision | None = None  # decision about the task
    checkpoint: int = 0  # checkpoint at which the clock or a worker thread ended the task
    #: The task around the code that made this task
    _around: Span | None = field(default_factory=lambda: _current.get(), repr=False)  # noqa: PLW0108  defined below
    _start_ns: int = 0
    _begun: bool = False
    _ended: bool = False
    _token: Token[Span | None] = field(init=False, repr=False)

    def ask(self) -> None:
        """Record the request of a task that starts later or in another thread."""
        self._emit_begin(Task.ASKED, Task.CREATED)

    def announce(self) -> None:
        """Record the request of the task, unless its request or its start is recorded."""
        if not self._begun and not journal.is_unrecorded():
            self.ask()

    def start(self, began_ns: int = 0) -> None:
        """Record the start. ``began_ns`` is the time of a start that came earlier, by the performance counter.

        If the stack has no room for the task's records, RecursionError is raised, and the task isn't recorded.
        """
        self._start_ns = began_ns or time.perf_counter_ns()
        self._emit_begin(Task.STARTED, Task.RUNNING)

    def finish(self, error: BaseException | None = None) -> None:
        """Record the end once, if the start was recorded. ``error`` is None if the task succeeded."""
        if self._ended or not self._begun:
            return
        status = Task.SUCCEEDED if error is None else Task.CANCELLED if isinstance(error, Cancelled) else Task.FAILED
        record = self._record(Task.FINISHED, status)
        if self.checkpoint:
            record.checkpoint = self.checkpoint
        record.duration_ns = time.perf_counter_ns() - self._start_ns if self._start_ns else 0
        recorded = journal.recording()
        if recorded:
            if self.solution:
                record.solution.extend(arguments(self.solution))
            record.result_json = to_json(self.result) if self.result is not None else "null"
        if error is not None and status == Task.FAILED:
            record.failure.CopyFrom(failure_with_frames(error) if recorded else failure(error, trace=False))
        with Uninterrupted():  # both the log and the tree need the end
            self._ended = True
            try:
                self._emit(record)
            except OSError:
                if error is None:  # an error of a full disk must not hide the failure of the task
                    raise

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Run a block as part of this task; the task begins and ends elsewhere."""
        if self.source is None:
            self.source = current_call_stack()
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def __enter__(self) -> Self:
        """Start the task, and make it the current task of this context."""
        if self.source is None:
            self.source = current_call_stack()
        self._token = _current.set(self)
        try:
            self.start()
        except BaseException as error:  # after an interrupt of the start, the task must still end
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.finish(self.error if error is None else error)
        except KeyboardInterrupt as interrupt:  # the record of the end may be missing
            self.finish(interrupt)
            raise
        finally:
            _current.reset(self._token)

    def _emit_begin(self, phase: Task.Phase, status: Task.Status) -> None:
        context.require_stack_room(context.FOR_TASK)
        record = self._record(phase, status)
        if self.source is None:
            self.source = current_call_stack()
        record.source_file, record.source_line = self.source.line
        record.callers.extend(self.source.callers)
        if self.parameters:
            record.parameters.extend(arguments(self.parameters))
        self._begun = True
        if self._around is not None and self._around.id == self.parent:
            self._around.announce()
        self._emit(record)

    def _record(self, phase: Task.Phase, status: Task.Status) -> Task:
        world, sim_step = journal.current_world()
        return Task(
            world=world,
            sim_step=sim_step,
            task=self.id,
            thread=current_name(),
            phase=phase,
            status=status,
            parent=self.parent,
            kind=self.kind,
            name=escaped(self.name),
            attempt=self.attempt,
            decision=self.decision,
        )

    def _emit(self, record: Task) -> None:
        global _tree_of  # noqa: PLW0603  the process has only one tree
        if not self.parent and record.phase != Task.FINISHED and _tree_of != journal.recording_number():
            _tree_of = journal.recording_number()
            _tree.forget()
        with _emitting:
            try:
                journal.publish(record)
            finally:
                if not record.wall_time_ns:  # no journal has numbered the record
                    record.wall_time_ns = time.time_ns()
                _tree.apply(record)
                if record.phase == Task.FINISHED:
                    _running.pop(self.id, None)
                elif not journal.is_unrecorded():
                    _running[self.id] = record


def current() -> Span | None:
    """Return the innermost running task of this context."""
    return _current.get()


@contextmanager
def running() -> Iterator[list[Task]]:
    """Run a block in which no task starts or ends; yield records of the running tasks, outer tasks first."""
    with _emitting:
        records = []
        for _, began in sorted(_running.items()):
            record = Task()
            record.CopyFrom(began)
            record.began_ns = began.wall_time_ns
            if began.parent not in _running:  # a thread may run longer than its parent task
                record.parent = 0
            records.append(record)
        yield records


def emit(
    record: Located, *, world: str = "", sim_step: int = 0, number: Callable[[Journal], None] | None = None
) -> Mapping[Journal, int]:
    """Call :func:`journal.emit`; add the plan's line to the record, unless the record's task has the same line."""
    if not journal.is_unrecorded():
        task = _current.get()
        asked = task.source if task is not None else None
        if asked is None or call_site() not in (asked.line, ("", 0)):
            stack = current_call_stack()
            record.source_file, record.source_line = stack.line
            record.callers.extend(stack.callers)
    return journal.emit(record, world=world, sim_step=sim_step, number=number)


def current_call_stack() -> CallStack:
    """Return the call stack of the caller."""
    task = _current.get()
    # inspect.stack() would read source files, and take 100 times as long
    return walk(sys._getframe(1), task.source if task is not None else None)  # noqa: SLF001


def span(kind: str, name: str, parameters: Mapping[str, object] | None = None) -> Span:
    """Return a task for a ``with`` statement. The block may set ``solution`` and ``result`` of the task."""
    return Span(kind, name, parameters=parameters or {})
