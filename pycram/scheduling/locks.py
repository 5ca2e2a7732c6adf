"""Re-entrant locks of threads: held for a short time, and never across a checkpoint."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pycram.foundation.error_families import UsageError
from pycram.foundation.refusals import refused

if TYPE_CHECKING:
    from types import TracebackType


class LockHeld(UsageError):
    """A branch waits, or lets others run, while it holds a lock: other branches of its thread would get in too."""

    def __init__(self) -> None:
        super().__init__("a branch must not wait or perform a motion while it holds the lock of a world or of fluents")


class _Held(threading.local):
    """Number of locks that the thread holds."""

    count = 0


held = _Held()


class Lock:
    """A re-entrant lock, as a context manager."""

    __slots__ = ("_lock",)

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        self._lock.acquire()
        held.count += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        held.count -= 1
        self._lock.release()


def refuse_held() -> None:
    """Raise LockHeld if the thread holds a lock; called wherever a branch may yield to others."""
    if held.count:
        raise refused(LockHeld(), "wait", {})
