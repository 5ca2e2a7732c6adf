"""Holds interrupts back while a record is being kept.

Ctrl-C raises in the main thread between any two instructions: in the middle of a record it would leave a number without
a record, or drop a chunk of them. Inside the block the interrupt is only noted; it is raised when the block has ended.
"""

from __future__ import annotations

import signal
import threading
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class Uninterrupted:
    """A block that SIGINT and SIGTERM, where Python handles them, don't break off.

    For the main thread: signals raise in no other, where it does nothing.
    """

    __slots__ = ("_handlers", "_noted")

    def __enter__(self) -> None:
        # each handler is known before the next instruction can be interrupted: signal.signal looks for signals first
        self._handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
        self._noted: list[int] = []
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                handler = signal.getsignal(number)
                if callable(handler):
                    self._handlers[number] = handler
                    signal.signal(number, self._note)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self._noted.append(number)

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(self._noted):
            signal.raise_signal(number)
