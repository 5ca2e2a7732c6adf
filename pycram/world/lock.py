"""A world's lock: reentrant, and never held while handlers of events run, or while a branch gives way to another one.

Whoever holds it may make any number of changes. The calls of handlers that these owe are left with the lock, and made
when its thread has let it go altogether: a handler is user code, and one that waits for another thread that wants this
world would otherwise never end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.foundation.error_chain import chained
from pycram.scheduling.locks import Lock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import TracebackType


class WorldLock(Lock):
    """The lock, as a context manager."""

    def __init__(self) -> None:
        """Begins free."""
        super().__init__()
        self._depth = 0
        self._deferred: list[Callable[[], None]] = []

    @property
    def is_held(self) -> bool:
        """Whether the branch that runs here holds it; as none gives way with it, that is whether its thread does."""
        return self._lock._is_owned()  # type: ignore[attr-defined, no-any-return]  # noqa: SLF001  as Condition does

    def defer(self, calls: Iterable[Callable[[], None]]) -> None:
        """Leaves calls to be made when the lock is free; for its holder.

        Args:
            calls: what to call, in order.
        """
        self._deferred.extend(calls)

    def __enter__(self) -> None:
        """Waits for it."""
        super().__enter__()
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
        super().__exit__(kind, error, traceback)
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
