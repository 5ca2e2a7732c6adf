"""A world's lock: reentrant, and never held while handlers of events run.

Whoever holds it may make any number of changes. The calls of handlers that these owe are left with the lock, and made
when its thread has let it go altogether: a handler is user code, and one that waits for another thread that wants this
world would otherwise never end.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pycram.foundation.error_chain import chained

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import TracebackType


class WorldLock:
    """The lock, as a context manager."""

    def __init__(self) -> None:
        """Begins free."""
        self._lock = threading.RLock()
        self._depth = 0
        self._deferred: list[Callable[[], None]] = []

    @property
    def depth(self) -> int:
        """How often its holder has taken it."""
        return self._depth

    def defer(self, calls: Iterable[Callable[[], None]]) -> None:
        """Leaves calls to be made when the lock is free; for its holder.

        Args:
            calls: what to call, in order.
        """
        self._deferred.extend(calls)

    def __enter__(self) -> None:
        """Waits for it."""
        self._lock.acquire()
        self._depth += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Lets it go, and makes the calls that are owed.

        Raises:
            Exception: the first error of a call, when all are made. If an error ends the block already it goes on, and
                those of the calls hang behind it.
        """
        deferred: list[Callable[[], None]] = []
        self._depth -= 1
        if not self._depth:
            deferred, self._deferred = self._deferred, []
        self._lock.release()
        errors = [failed for call in deferred if (failed := _made(call)) is not None]
        if error is not None:
            chained(error, errors)
        elif errors:
            raise chained(errors[0], errors[1:])


def _made(call: Callable[[], None]) -> Exception | None:
    try:
        call()
    except Exception as error:  # noqa: BLE001  the others must be made too; whoever let the lock go raises it
        return error
    return None
