"""Worker threads for calls that would otherwise block all branches of a thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextvars import copy_context
from typing import TypeVar

from pycram.scheduling.cancellation import StrikeSource, join, raise_if_cancelled
from pycram.scheduling.schedule import refuse_held, scheduler
from recorder.tracing.context import current_name
from recorder.tracing.span import span

Result = TypeVar("Result")


class _WorkerEnd(StrikeSource):
    def __init__(self) -> None:
        super().__init__()
        self._set = threading.Event()

    def set(self) -> None:
        self._set.set()
        self._scheduler.ring()

    def is_due(self) -> bool:
        return self._set.is_set()

    def await_due(self) -> None:
        self._set.wait()


def in_thread(function: Callable[..., Result], *args: object, **kwargs: object) -> Result:
    """Call a function in a worker thread while other branches run, and return its result.

    Use this function for calls that block outside of PyCRAM: ``in_thread(time.sleep, 3)``, a request to a server, or a
    long calculation that releases the interpreter lock. The function runs in the branch's context. The call of the
    function is recorded as a task. A cancelled branch waits until the function has returned, so the function should
    have a timeout. If the function changes a world, the changes have no fixed place in the plan's order.

    Raises:
        BaseException: Any error of the function.
        Cancelled: The branch was cancelled during the call.
        LockHeld: The caller holds a lock.
    """
    refuse_held()
    results: list[Result] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            results.append(function(*args, **kwargs))
        except BaseException as error:  # noqa: BLE001  any error is raised in the branch
            errors.append(error)
        ended.set()

    name = f"{current_name()} {getattr(function, '__name__', 'function')}"
    task = span("in-thread", getattr(function, "__name__", "function"))
    # A daemon thread doesn't keep the process alive when Ctrl-C, outside of all branches, abandons the call.
    with task, _WorkerEnd() as ended:
        threading.Thread(target=copy_context().run, args=(work,), name=name, daemon=True).start()
        join(ended, lambda: ended.struck)
        task.checkpoint = scheduler().checkpoints
        try:
            if errors:
                raise errors[0]
            raise_if_cancelled()
            task.result = results[0]
            return results[0]
        finally:
            errors.clear()  # the error's traceback would keep this frame alive
