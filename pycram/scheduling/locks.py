"""Re-entrant locks of threads: held for a short time, and never across a checkpoint."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from pycram.foundation.errors import UsageError
from pycram.foundation.refusals import refused

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType


class LockHeld(UsageError):
    """A branch waits, or lets others run, while it holds a lock: other branches of its thread would get in too."""

    def __init__(self) -> None:
        super().__init__("a branch must not wait or perform a motion while it holds the lock of a world or of fluents")


class _Held(threading.local):
    """Number of locks that the thread holds."""

    count = 0


_held: Final = _Held()
_shared: Final[list[Callable[[], bool]]] = []  # whether the thread holds each of the shared locks


def shared_lock() -> threading.RLock:
    """Return a lock for all of the process, which is never freed; with it ``with`` takes a fifth of a Lock's time."""
    lock = threading.RLock()
    _shared.append(lock._is_owned)  # type: ignore[attr-defined]  # noqa: SLF001  as threading.Condition does
    return lock


class Lock:
    """A re-entrant lock, as a context manager; counted where it is held."""

    __slots__ = ("_lock",)

    def __init__(self) -> None:
        self._lock = threading.RLock()

    @property
    def is_mine(self) -> bool:
        """Whether this thread holds it."""
        return bool(self._lock._is_owned())  # type: ignore[attr-defined]  # noqa: SLF001  as above

    def __enter__(self) -> None:
        self._lock.acquire()
        _held.count += 1

    def _try(self) -> bool:
        """Acquire it, unless another thread has it; return whether that was so."""
        acquired = self._lock.acquire(blocking=False)
        _held.count += acquired
        return acquired

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        _held.count -= 1
        self._lock.release()


def is_held() -> bool:
    """Whether the thread holds a lock."""
    if _held.count:
        return True
    for is_owned in _shared:  # noqa: SIM110  any() takes three times as long
        if is_owned():
            return True
    return False


def refuse_held() -> None:
    """Raise LockHeld if the thread holds a lock; called wherever a branch may yield to others."""
    if is_held():
        raise refused(LockHeld(), "wait", {})
