"""Worker threads for calls that would block all branches of a thread."""

from __future__ import annotations

import threading
from contextvars import copy_context
from typing import TYPE_CHECKING, TypeVar

from pycram.scheduling.cancellation import join, raise_if_cancelled
from pycram.scheduling.locks import refuse_held
from pycram.scheduling.schedule import Outer, scheduler
from recorder.tracing.context import current_name
from recorder.tracing.span import span

if TYPE_CHECKING:
    from collections.abc import Callable

Result = TypeVar("Result")


class _Ended(Outer):
    """The end of a worker."""

    def __init__(self) -> None:
        super().__init__()
        self._set = threading.Event()

    def set(self) -> None:
        """Say so, in the worker."""
        self._set.set()
        self._scheduler.ring()

    def is_due(self) -> bool:
        """Whether it has ended."""
        return self._set.is_set()

    def await_due(self) -> None:
        """Wait for it, without others."""
        self._set.wait()


def in_thread(function: Callable[..., Result], *args: object, **kwargs: object) -> Result:
    """Call a function in a worker thread, in the branch's context, while other branches run; return its result.

    It is a task of its own on record, with what it returned, and at which checkpoint of the plan it came.

    For what blocks outside of PyCRAM: ``in_thread(time.sleep, 3)``, a request to a server, a long calculation that
    releases the interpreter lock. A branch that is cancelled meanwhile stops when the function has returned: give it a
    timeout of its own. What it changes in a world comes at no fixed place in the plan's order.

    Raises:
        BaseException: The function raised it.
        Cancelled: The branch was cancelled meanwhile.
        LockHeld: The caller holds a lock.
    """
    refuse_held()
    results: list[Result] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            results.append(function(*args, **kwargs))
        except BaseException as error:  # noqa: BLE001  raised in the branch
            errors.append(error)
        ended.set()

    name = f"{current_name()} {getattr(function, '__name__', 'function')}"
    task = span("in-thread", getattr(function, "__name__", "function"))
    # a daemon: only Ctrl-C outside of all branches abandons it, and then the process may end
    with task, _Ended() as ended:
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
            errors.clear()  # the error's traceback refers to this frame
