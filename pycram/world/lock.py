"""A world's lock: reentrant, and never held while handlers of events run.

Its holder may make any number of transactions. They defer the calls of event handlers until the thread has released the
lock altogether: a handler is user code, which may wait for another thread that needs this world.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pycram.foundation.error_chain import call_all, chained

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import TracebackType


class WorldLock:
    """The lock, as a context manager."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._depth = 0
        self._deferred: list[Callable[[], None]] = []

    @property
    def depth(self) -> int:
        """How often its holder has acquired it."""
        return self._depth

    def defer(self, calls: Iterable[Callable[[], None]]) -> None:
        """Have the holder's thread make calls, in order, when it has released the lock."""
        self._deferred.extend(calls)

    def __enter__(self) -> None:
        self._lock.acquire()
        self._depth += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Release it and make the deferred calls.

        Raises:
            Exception: The first error of a call, when all are made. An error that ends the block already propagates,
                with those of the calls in its context.
        """
        deferred: list[Callable[[], None]] = []
        self._depth -= 1
        if not self._depth:
            deferred, self._deferred = self._deferred, []
        self._lock.release()
        errors = call_all(deferred)
        if error is not None:
            chained(error, errors)
        elif errors:
            raise chained(errors[0], errors[1:])
