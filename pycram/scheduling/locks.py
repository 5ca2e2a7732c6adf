"""Re-entrant locks of threads, held for a short time and never across a checkpoint."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from pycram.foundation.errors import UsageError
from pycram.foundation.refusals import refused

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType


class LockHeld(UsageError):
    """A branch waits or yields while it holds a lock: other branches of its thread would hold the lock too."""

    def __init__(self) -> None:
        super().__init__("a branch must not wait or perform a motion while it holds the lock of a world or of fluents")


class _Held(threading.local):
    count = 0  # number of locks that the thread holds


_held: Final = _Held()
_shared: Final[list[Callable[[], bool]]] = []  # for each shared lock, whether the thread holds it


def shared_lock() -> threading.RLock:
    """Return a lock of the whole process, which is never freed; entering it takes a fifth of a Lock's time."""
    lock = threading.RLock()
    _shared.append(lock._is_owned)  # type: ignore[attr-defined]  # noqa: SLF001  as threading.Condition does
    return lock


class Lock:
    """A re-entrant lock, as a context manager; the locks that a thread holds are counted."""

    __slots__ = ("_lock",)

    def __init__(self) -> None:
        self._lock = threading.RLock()

    @property
    def is_mine(self) -> bool:
        """Whether this thread holds the lock."""
        return bool(self._lock._is_owned())  # type: ignore[attr-defined]  # noqa: SLF001  as above

    def __enter__(self) -> None:
        self._lock.acquire()
        _held.count += 1

    def _try(self) -> bool:
        """Acquire the lock unless another thread holds it; return whether it was acquired."""
        acquired = self._lock.acquire(blocking=False)
        _held.count += acquired
        return acquired

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        _held.count -= 1
        self._lock.release()


def is_held() -> bool:
    """Return whether the thread holds a lock."""
    if _held.count:
        return True
    for is_owned in _shared:  # noqa: SIM110  any() takes three times as long
        if is_owned():
            return True
    return False


def refuse_held() -> None:
    """Raise LockHeld if the thread holds a lock; called wherever a branch may yield."""
    if is_held():
        raise refused(LockHeld(), "wait", {})
