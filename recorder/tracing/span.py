"""The running task: spans, one per node of the task tree.

A span is opened around each designator execution, process module, language block, branch and attempt. The current one
is carried by the context, so that records made inside know their cause. A plain thread starts with an empty context:
whoever starts a thread for a task runs it with ``contextvars.copy_context().run``.

Every span makes its records, also without a recording: the tree of the running plan (:func:`tree`) is folded from them.
Without a recording they hold no results and no tracebacks.
"""

from __future__ import annotations

import itertools
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, TypeAlias, cast

from recorder.records import Decision, Task, arguments, escaped, failure, to_json
from recorder.tasks import Tree
from recorder.tracing import context, journal
from recorder.tracing.call_stack import CallStack, call_site, failure_with_frames, plan_frame, walk
from recorder.tracing.context import current_name
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextvars import ContextVar, Token
    from types import FrameType, TracebackType
    from typing import Self

    from recorder.records import Event, Fluent, Mutation, Query, Refusal, Subscription
    from recorder.tracing.call_stack import CallSite
    from recorder.tracing.journal import Journal

    Located: TypeAlias = Mutation | Event | Subscription | Query | Refusal | Fluent  # with the plan's line

#: A plan may run for days: its tree keeps the latest tasks, up to this number and these bytes of records.
MAX_TASKS: Final = 20_000
MAX_BYTES: Final = 100_000_000
_MAX_CACHED: Final = 4096  # call stacks as records hold them

_STARTED, _FINISHED = Task.STARTED, Task.FINISHED  # looked up once, as a message type finds them slowly
_RUNNING, _SUCCEEDED, _FAILED, _CANCELLED = Task.RUNNING, Task.SUCCEEDED, Task.FAILED, Task.CANCELLED
_ids = itertools.count(1)
_tree: Final = Tree(MAX_TASKS, MAX_BYTES)
_tree_of = 0  # number of the recording whose tasks the tree has; 0 before the first
_running: Final[dict[int, Task]] = {}  # how the tasks began that recordings may have and that have not ended
_emitting: Final = threading.RLock()  # held from the record of a task's beginning or end to the change of these two
_current: Final = cast("ContextVar[Span | None]", journal.current_task)


class Cancelled(BaseException):
    """The task was cancelled, because the block around it is decided.

    Not an Exception, so that a plan's ``except Exception`` doesn't swallow it.
    """


def tree() -> Tree:
    """Return the latest 20,000 tasks since the latest recording began; it grows as the process runs.

    Where nothing is recorded, it has the latest of all tasks.
    """
    return _tree


@dataclass(slots=True)
class Span:
    """A task while it runs; as a context manager, the task is the block."""

    kind: str  # motion, process-module, block, branch, failure-handling, attempt, timeout, cleanup, ...
    name: str  # what people call it
    parent: int = field(default_factory=journal.task_id)  # id of the task that it is part of, 0 for none
    parameters: Mapping[str, object] = field(default_factory=dict)
    attempt: int = 0  # number of the attempt, from 1; 0 if it is none
    source: CallStack | None = None  # call stack of the code that asked for it; None to find it at the start
    id: int = field(default_factory=_ids.__next__)  # unique in this process, from 1
    solution: Mapping[str, object] = field(default_factory=dict)  # as resolved; set while it runs
    result: object = None  # what it returned; set while it runs
    error: BaseException | None = None  # what it failed with, where that isn't raised; set while it runs
    decision: Decision | None = None  # how it was decided; set while it runs, or before
    checkpoint: int = 0  # where the clock or a worker thread decided it, as records have it; set while it runs
    _start_ns: int = 0
    _begun: bool = False
    _ended: bool = False
    _frame: FrameType | None = field(default=None, init=False, repr=False)  # of the plan, that entered it
    _token: Token[Span | None] = field(init=False, repr=False)

    def ask(self) -> None:
        """Records that it is asked for, where it starts later or in another thread."""
        self._emit_begin(Task.ASKED, Task.CREATED)

    def start(self, began_ns: int = 0) -> None:
        """Record the start.

        Args:
            began_ns: time of an earlier start, by the performance counter.

        Raises:
            RecursionError: there would be no room for recording its end; nothing is recorded of it.
        """
        self._start_ns = began_ns or time.perf_counter_ns()
        self._emit_begin(_STARTED, _RUNNING)

    def finish(self, error: BaseException | None = None) -> None:
        """Record the end once, if the beginning was recorded; ``error`` ended it, None if it succeeded."""
        if self._ended or not self._begun:
            return
        status = _SUCCEEDED if error is None else _CANCELLED if isinstance(error, Cancelled) else _FAILED
        record = self._record(_FINISHED, status)
        if self.checkpoint:
            record.checkpoint = self.checkpoint
        record.duration_ns = time.perf_counter_ns() - self._start_ns if self._start_ns else 0
        recorded = journal.recording()
        if recorded:
            if self.solution:
                record.solution.extend(arguments(self.solution))
            record.result_json = to_json(self.result) if self.result is not None else "null"
        if error is not None and status == _FAILED:
            record.failure.CopyFrom(failure_with_frames(error) if recorded else failure(error, trace=False))
        with Uninterrupted():  # its end is in the log and in the tree, or in neither
            self._ended = True
            try:
                self._emit(record)
            except OSError:
                if error is None:  # a failing disk must not hide why the task failed
                    raise

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Runs its block as part of this task, which begins and ends elsewhere."""
        if self.source is None:
            self.source = current_call_stack()
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def __enter__(self) -> Self:
        """Starts, as the current task of this context."""
        if self.source is None:
            outer = _current.get()
            frame = sys._getframe(1)  # noqa: SLF001  see current_call_stack()
            self.source, self._frame = walk(frame, outer.source if outer is not None else None)
        self._token = _current.set(self)
        try:
            self.start()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.finish(self.error if error is None else error)
        except KeyboardInterrupt as interrupt:  # perhaps before its record
            self.finish(interrupt)
            raise
        finally:
            self._frame = None
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
        global _tree_of  # noqa: PLW0603  the tree is the process's
        if not self.parent and record.phase != _FINISHED and _tree_of != journal.recording_number():
            _tree_of = journal.recording_number()
            _tree.forget()
        size = 0
        with _emitting:
            try:
                size = journal.publish(record)
            finally:
                if not size and not record.wall_time_ns:  # no journal numbered it
                    record.wall_time_ns = time.time_ns()
                _tree.apply(record, size)
                if record.phase == _FINISHED:
                    _running.pop(self.id, None)
                elif not journal.is_unrecorded():
                    _running[self.id] = record


def current() -> Span | None:
    """The innermost running task of this context."""
    return _current.get()


@contextmanager
def running() -> Iterator[list[Task]]:
    """Keep tasks from beginning and ending while the block runs, and yield those that run.

    They are records of their beginnings for a recording that begins now, outer tasks before inner ones.
    """
    with _emitting:
        records = []
        for _, began in sorted(_running.items()):
            record = Task()
            record.CopyFrom(began)
            record.began_ns = began.wall_time_ns
            if began.parent not in _running:  # a thread of its own can outlive what it is part of
                record.parent = 0
            records.append(record)
        yield records


def emit(
    record: Located, *, world: str = "", sim_step: int = 0, number: Callable[[Journal], None] | None = None
) -> Mapping[Journal, int]:
    """Records something with the plan's line that led to it, unless its task has the same; see :func:`journal.emit`."""
    if not journal.is_unrecorded():
        task = _current.get()
        asked = task.source if task is not None else None
        if asked is None or call_site() not in (asked.line, ("", 0)):
            record.MergeFromString(_line_fields(type(record), current_call_stack()))
    return journal.emit(record, world=world, sim_step=sim_step, number=number)


def _line_fields(kind: type[Located], stack: CallStack) -> bytes:
    """The fields of a record that hold a call stack, serialized: a plan's loop has the same ones again and again."""
    key = kind, stack.lines
    fields = _fields.get(key)
    if fields is None:
        file, line = stack.line
        if len(_fields) >= _MAX_CACHED:
            _fields.clear()
        fields = kind(source_file=file, source_line=line, callers=stack.callers).SerializeToString()
        _fields[key] = fields
    return fields


_fields: Final[dict[tuple[type[Located], tuple[CallSite, ...]], bytes]] = {}


def current_call_stack() -> CallStack:
    """The call stack of the caller."""
    frame = sys._getframe(1)  # noqa: SLF001  inspect.stack() reads source files: it takes 100 times as long
    task = _current.get()
    if task is None:
        return walk(frame)[0]
    outer, entered, call_stack = task.source, task._frame, None  # noqa: SLF001  same module
    if outer is not None and entered is not None and plan_frame(frame)[0] is entered:
        call_stack = outer.at_line(entered.f_lineno)
    return call_stack or walk(frame, outer)[0]


def span(kind: str, name: str, parameters: Mapping[str, object] | None = None) -> Span:
    """A task for a ``with`` statement: recorded when its block begins and, however that ends, when it ends.

    Set ``solution`` and ``result`` on it.
    """
    return Span(kind, name, parameters=parameters or {})
