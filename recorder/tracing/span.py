"""Which task is running: spans, one per node of the task tree.

A span is opened around each designator execution, process module, language block, branch and attempt. The current one
is carried by the context, so that records made inside know their cause. A plain thread starts with an empty context:
whoever starts a thread for a task runs it with ``contextvars.copy_context().run``.

Every span makes its records, whether anybody records or not: they are what the tree of the running plan
(:func:`tree`) is folded from. Without a recording they hold no results and no tracebacks.
"""

from __future__ import annotations

import itertools
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, cast

from recorder import threads
from recorder.records import Task, arguments, failure, to_json
from recorder.tasks import Tree
from recorder.tracing import journal
from recorder.tracing.call_site import CallStack, plan_frame, walk
from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from contextvars import ContextVar, Token
    from types import FrameType, TracebackType
    from typing import Self

#: A plan may run for days: its tree keeps the latest tasks, so many of them and so many bytes of records.
KEPT: Final = 20_000
KEPT_BYTES: Final = 100_000_000

_STARTED, _FINISHED = Task.STARTED, Task.FINISHED  # looked up once, as a message type finds them slowly
_RUNNING, _SUCCEEDED, _FAILED, _CANCELLED = Task.RUNNING, Task.SUCCEEDED, Task.FAILED, Task.CANCELLED
_ids = itertools.count(1)
_current: Final = cast("ContextVar[Span | None]", journal.running)


class Cancelled(BaseException):
    """The task was told to stop because the block around it is decided.

    Not an Exception, so that a plan's ``except Exception`` doesn't swallow it.
    """


class _Plan:
    """The tasks of this process: of the latest recording, or since the start where nothing is recorded."""

    def __init__(self) -> None:
        self.tree = Tree(KEPT, KEPT_BYTES)
        self._openings = 0

    def begin(self) -> None:
        """Lets go of what came before the latest recording."""
        if self._openings != journal.openings():
            self._openings = journal.openings()
            self.tree.forget()


_plan = _Plan()


def tree() -> Tree:
    """The tasks of this process, which grow as it runs.

    Returns:
        Those since the latest recording began; where nothing is recorded, all. The last 20,000.
    """
    return _plan.tree


@dataclass(slots=True)
class Span:
    """A task in the making: its block is the task, from its start to its end, however that comes.

    Attributes:
        kind: motion, process-module, block, branch, failure-handling, attempt, timeout, cleanup, ...
        name: what people call it.
        parent: id of the task that it is part of, 0 for none.
        parameters: as given.
        attempt: which attempt it is, from 1; 0 if it is none.
        source: the way through the plan's code to where it was asked for; None to look for it when it starts.
        id: unique in this process, from 1.
        solution: as resolved; set while it runs.
        result: what it returned; set while it runs.
        error: what it failed with, where that isn't raised; set while it runs.
    """

    kind: str
    name: str
    parent: int = field(default_factory=journal.task_id)
    parameters: Mapping[str, object] = field(default_factory=dict)
    attempt: int = 0
    source: CallStack | None = None
    id: int = field(default_factory=_ids.__next__)
    solution: Mapping[str, object] = field(default_factory=dict)
    result: object = None
    error: BaseException | None = None
    _start: int = 0
    _ended: bool = False
    _body: FrameType | None = field(default=None, init=False, repr=False)  # the code that began it, as long as it runs
    _token: Token[Span | None] = field(init=False, repr=False)

    def ask(self) -> None:
        """Says that it is going to run, for what is asked for in one thread and runs in another."""
        self._say(Task.ASKED, Task.CREATED)

    def start(self) -> None:
        """Says that it begins."""
        self._start = time.perf_counter_ns()
        self._say(_STARTED, _RUNNING)

    def finish(self, error: BaseException | None = None) -> None:
        """Says that it ended; nothing happens if that was said before.

        Args:
            error: what it failed with, or was cancelled by; None if it succeeded.
        """
        if self._ended:
            return
        ended = _SUCCEEDED if error is None else _CANCELLED if isinstance(error, Cancelled) else _FAILED
        record = self._record(_FINISHED, ended)
        record.duration_ns = time.perf_counter_ns() - self._start if self._start else 0
        recorded = journal.recording()
        if recorded:
            if self.solution:
                record.solution.extend(arguments(self.solution))
            record.result_json = to_json(self.result) if self.result is not None else "null"
        if error is not None and ended == _FAILED:
            record.failure.CopyFrom(failure(error, trace=recorded))
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
        self._way()
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def __enter__(self) -> Self:
        """Begins, as the current task of this context."""
        if self.source is None:
            outer = _current.get()
            frame = sys._getframe(1)  # noqa: SLF001  see way_here()
            self.source, self._body = walk(frame, outer.source if outer is not None else None)
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
        except KeyboardInterrupt as stopped:  # perhaps before its record
            self.finish(stopped)
            raise
        finally:
            self._body = None
            _current.reset(self._token)

    def _way(self) -> CallStack:
        """The way to where it was asked for; looked for before it is itself the current task."""
        if self.source is None:
            self.source = current_call_stack()
        return self.source

    def _say(self, phase: Task.Phase, status: Task.Status) -> None:
        record, way = self._record(phase, status), self._way()
        record.source_file, record.source_line = way.line
        record.callers.extend(way.callers)
        if self.parameters:
            record.parameters.extend(arguments(self.parameters))
        self._emit(record)

    def _record(self, phase: Task.Phase, status: Task.Status) -> Task:
        """What every record of it says."""
        world, sim_step = journal.now()
        return Task(
            world=world,
            sim_step=sim_step,
            task=self.id,
            thread=threads.name(),
            phase=phase,
            status=status,
            parent=self.parent,
            kind=self.kind,
            name=self.name,
            attempt=self.attempt,
        )

    def _emit(self, record: Task) -> None:
        if not self.parent and record.phase != _FINISHED:
            _plan.begin()
        size = 0
        try:
            size = journal.tell(record)
        finally:
            if not size and not record.wall_time_ns:  # no journal numbered it
                record.wall_time_ns = time.time_ns()
            _plan.tree.apply(record, size)


def current() -> Span | None:
    """The innermost running task of this context."""
    return _current.get()


def current_call_stack() -> CallStack:
    """The way through the plan's code to the caller."""
    here = sys._getframe(1)  # noqa: SLF001  inspect.stack() reads source files: it takes 100 times as long
    task = _current.get()
    if task is None:
        return walk(here)[0]
    outer, body, way = task.source, task._body, None  # noqa: SLF001  same module
    if outer is not None and body is not None and plan_frame(here)[0] is body:
        way = outer.turned(body.f_lineno)
    return way or walk(here, outer)[0]


def span(kind: str, name: str, parameters: Mapping[str, object] | None = None) -> Span:
    """A task for a ``with`` statement: on record when its block begins and, however that ends, when it ends.

    Args:
        kind: kind of the node.
        name: name of the node.
        parameters: what it was given.

    Returns:
        The span; set ``solution`` and ``result`` on it.
    """
    return Span(kind, name, parameters=parameters or {})
