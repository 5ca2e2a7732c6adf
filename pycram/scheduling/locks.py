"""Locks of threads: re-entrant, held for a short time, and never while a branch gives way to another one."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pycram.foundation.error_families import UsageError

if TYPE_CHECKING:
    from types import TracebackType


class LockHeld(UsageError):
    """Code waits, or lets other branches go on, that holds a lock: another branch of its thread would get in."""

    def __init__(self) -> None:
        super().__init__("a branch must not wait or perform a motion while it holds the lock of a world or of fluents")


class _Held(threading.local):
    """How many locks this thread holds."""

    count = 0


held = _Held()


class Lock:
    """A re-entrant lock, as a context manager."""

    __slots__ = ("_lock",)

    def __init__(self) -> None:
        """Begins free."""
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        """Waits for it."""
        self._lock.acquire()
        held.count += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Lets it go."""
        held.count -= 1
        self._lock.release()


def refuse_held() -> None:
    """Called where a branch may give way.

    Raises:
        LockHeld: this thread holds a lock.
    """
    if held.count:
        raise LockHeld
