"""Holds Ctrl-C back while a world is changed and a record is being kept.

It raises in the main thread between any two instructions: in the middle of a change it would leave a world that differs
from its log, in the middle of a record a number without a record. Inside the block the interrupt is only noted; it is
raised when the block has ended. What takes long in there asks now and then whether there is one, and ends early.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # without the enums of signal, which take as long as to keep a record
import signal
import threading
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType
    from typing import Self

_SIGINT: Final = int(signal.SIGINT)
_holder = 0  # identifies the main thread while it is in such a block


class Uninterrupted:
    """A block that SIGINT doesn't break off, where Python handles it.

    For the main thread: signals raise in no other, where it does nothing. Blocks may nest; the outermost does it all.

    Attributes:
        noted: whether an interrupt is being held back.
    """

    __slots__ = ("_handler", "noted")

    def __enter__(self) -> Self:
        global _holder  # noqa: PLW0603  there is one main thread
        self._handler: Callable[[int, FrameType | None], Any] | None = None
        self.noted = False
        thread = threading.get_ident()
        if thread != _holder and thread == threading.main_thread().ident:
            handler = _signal.getsignal(_SIGINT)
            if callable(handler):
                self._handler = handler  # first: an interrupt may raise up to the moment when it is only noted
                _signal.signal(_SIGINT, self._note)
                _holder = thread
        return self

    def _note(self, number: int, frame: FrameType | None) -> None:
        handler = self._handler
        if handler is not None and threading.get_ident() != _holder:  # forked by another thread: nobody is in the block
            _signal.signal(_SIGINT, handler)
            handler(number, frame)
        else:
            self.noted = True

    def __exit__(self, *_: object) -> None:
        global _holder  # noqa: PLW0603  see above
        if self._handler is not None:
            _holder = 0
            _signal.signal(_SIGINT, self._handler)
            if self.noted:
                signal.raise_signal(signal.SIGINT)
