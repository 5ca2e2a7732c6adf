"""Holds Ctrl-C back while a record is being kept.

It raises in the main thread between any two instructions: in the middle of a record it would leave a number without a
record, or drop a chunk of them. Inside the block the interrupt is only noted; it is raised when the block has ended.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # without the enums of signal, which take as long as to keep a record
import signal
import threading
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

_SIGINT: Final = int(signal.SIGINT)


class Uninterrupted:
    """A block that SIGINT doesn't break off, where Python handles it.

    For the main thread: signals raise in no other, where it does nothing.
    """

    __slots__ = ("_handler", "_noted")

    def __enter__(self) -> None:
        self._handler: Callable[[int, FrameType | None], Any] | None = None
        self._noted = False
        if threading.get_ident() == threading.main_thread().ident:
            handler = _signal.getsignal(_SIGINT)
            if callable(handler):
                self._handler = handler  # first: an interrupt may raise up to the moment when it is only noted
                _signal.signal(_SIGINT, self._note)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self._noted = True

    def __exit__(self, *_: object) -> None:
        if self._handler is not None:
            _signal.signal(_SIGINT, self._handler)
            if self._noted:
                signal.raise_signal(signal.SIGINT)
