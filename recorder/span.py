"""Which task is running: spans, one per node of the task tree.

A span is opened around each designator execution, process module and language block. The current one is carried by the
context, so that records made inside know their cause. A plain thread starts with an empty context: whoever starts a
thread for a task runs it with ``contextvars.copy_context().run``.
"""

from __future__ import annotations

import itertools
import sys
import time
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from recorder import journal
from recorder.records import Task, arguments, failure, to_json

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_ids = itertools.count(1)
_current: ContextVar[Span | None] = ContextVar("pycram_span", default=None)

#: Frames of these packages are the machinery; the plan's line is the first one outside of them.
_MACHINERY = frozenset({"pycram", "recorder", "contextlib", "threading", "concurrent", "contextvars"})


class Cancelled(BaseException):
    """The task was told to stop because the block around it is decided.

    Not an Exception, so that a plan's ``except Exception`` doesn't swallow it.
    """


@dataclass(slots=True)
class Span:
    """A running task.

    Attributes:
        id: unique in this process, from 1.
        parent: id of the task that it is part of, 0 for none.
        kind: plan, motion, process-module, par, branch, ...
        name: what people call it.
        parameters: as given.
        solution: as resolved; set while it runs.
        result: what it returned; set while it runs.
    """

    kind: str
    name: str
    parent: int
    parameters: Mapping[str, object] = field(default_factory=dict)
    id: int = field(default_factory=lambda: next(_ids))
    solution: Mapping[str, object] = field(default_factory=dict)
    result: object = None


def current() -> Span | None:
    """The innermost running task of this context."""
    return _current.get()


def plan_line() -> tuple[str, int]:
    """File and line of the user's code that led here.

    Returns:
        Path and line number of the innermost frame that isn't ours or the standard library's thread machinery.
    """
    frame = sys._getframe(1)  # noqa: SLF001  inspect.stack() reads source files: 100 times slower
    while frame is not None:
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        demo = Path(frame.f_code.co_filename).parent.name == "demos"
        if package not in _MACHINERY or demo:
            return frame.f_code.co_filename, frame.f_lineno
        if frame.f_back is None:
            break
        frame = frame.f_back
    return "", 0


@contextmanager
def span(kind: str, name: str, parameters: Mapping[str, object] | None = None) -> Iterator[Span]:
    """Runs its block as a task: recorded when it starts and, however it ends, when it ends.

    Args:
        kind: kind of the node.
        name: name of the node.
        parameters: what it was given.

    Yields:
        The span; set ``solution`` and ``result`` on it.
    """
    task = Span(kind, name, journal.task_id.get(), parameters or {})
    token = _current.set(task)
    id_token = journal.task_id.set(task.id)
    start = time.perf_counter_ns()
    try:
        if journal.recording():
            file, line = plan_line()
            journal.emit(
                Task(
                    phase=Task.STARTED,
                    status=Task.RUNNING,
                    parent=task.parent,
                    kind=kind,
                    name=name,
                    parameters=arguments(task.parameters),
                    source_file=file,
                    source_line=line,
                ),
            )
        yield task
    except BaseException as error:
        status = Task.CANCELLED if isinstance(error, Cancelled) else Task.FAILED
        _finish(task, status, start, error)
        raise
    else:
        _finish(task, Task.SUCCEEDED, start)
    finally:
        _current.reset(token)
        journal.task_id.reset(id_token)


def _finish(task: Span, status: Task.Status, start: int, error: BaseException | None = None) -> None:
    if not journal.recording():
        return
    record = Task(
        phase=Task.FINISHED,
        status=status,
        parent=task.parent,
        kind=task.kind,
        name=task.name,
        solution=arguments(task.solution),
        result_json=to_json(task.result),
        failure=failure(error) if error is not None else None,
        duration_ns=time.perf_counter_ns() - start,
    )
    try:
        journal.emit(record)
    except OSError:
        if error is None:  # a failing disk must not hide why the task failed
            raise
