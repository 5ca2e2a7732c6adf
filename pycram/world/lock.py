"""A world's lock: reentrant, and never held while event handlers run or while a branch gives way to another one.

Its holder may make any number of transactions. They defer the calls of event handlers until the thread has released the
lock altogether: a handler is user code, which may wait for another thread that needs this world.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pycram.foundation.errors import call_all, chained
from pycram.scheduling.locks import Lock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import TracebackType


class WorldLock(Lock):
    """The lock, as a context manager."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0
        self._contenders: dict[int, None] = {}
        self._deferred: list[Callable[[], None]] = []

    def defer(self, calls: Iterable[Callable[[], None]]) -> None:
        """Have the holder's thread make calls, in order, when it has released the lock."""
        self._deferred.extend(calls)

    @property
    def is_contended(self) -> bool:
        """Whether another thread waits for it."""
        return bool(self._contenders)

    def __enter__(self) -> None:
        if not self._try():
            thread = threading.get_ident()
            self._contenders[thread] = None
            try:
                super().__enter__()
            finally:
                del self._contenders[thread]
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
        super().__exit__(kind, error, traceback)
        errors = call_all(deferred)
        if error is not None:
            chained(error, errors)
        elif errors:
            raise chained(errors[0], errors[1:])
