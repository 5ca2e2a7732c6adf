"""Ctrl-C: raised at once in the plan's own Python, and elsewhere where nothing is left half done.

Python raises KeyboardInterrupt in the main thread between any two instructions. In the middle of a change it would
leave a world that differs from its log, in the middle of a record a number without a record, in the middle of a block a
branch that nobody waits for. So it is held back

- in a section (:class:`Uninterrupted`): a change, a record; until the section ends;
- where the :class:`Host` says so, which the plan language is: in branches and in its own code, until it calls
  :func:`raise_pending`, as it does at every checkpoint (:mod:`pycram.scheduling`).

Our handler of SIGINT is there only as long as a section or a scope of the plan language is open in the main thread. It
hands on to the handler that was there before, so a program's own handler is called at the same moments.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # without the enums of signal, which take as long as to keep a record
import signal
import sys
import threading
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType
    from typing import Self

_SIGINT: Final = int(signal.SIGINT)


class Host(Protocol):
    """Who runs code that must not be broken off anywhere; asked and told in the main thread only."""

    def defers(self, frame: FrameType) -> bool:
        """Whether Ctrl-C has to wait until the host raises it.

        Args:
            frame: the code that it has met.
        """

    def interrupt(self) -> None:
        """Ctrl-C is being held back; called by the handler of the signal, so between any two instructions."""


_host: Host | None = None
_handler: Callable[[int, FrameType | None], Any] = signal.default_int_handler  # the one before ours
_holder = 0  # identifies the main thread, to tell it from that of a process which another thread has forked
_open = 0  # sections and scopes in the main thread; our handler is there as long as there are any
_sections = 0  # the sections among them
_pending = False


def _on_sigint(number: int, frame: FrameType | None) -> None:
    global _pending  # noqa: PLW0603  there is one main thread
    if threading.get_ident() != _holder:  # forked by another thread: here nobody is in a section
        _signal.signal(_SIGINT, _handler)
        _handler(number, frame)
    elif _sections or (frame is not None and (frame.f_globals is globals() or _defers(frame))):
        if _host is not None:
            _host.interrupt()
        _pending = True
    else:
        _handler(number, frame)


def _defers(frame: FrameType) -> bool:
    return _host is not None and _host.defers(frame)


def enter(host: Host | None = None) -> bool:
    """Has our handler act until :func:`leave`; returns whether it does, as signals raise in the main thread only.

    Args:
        host: who is asked from now on whether Ctrl-C has to wait, until our handler goes.
    """
    global _handler, _holder, _host, _open, _sections, _pending  # noqa: PLW0603  as above
    thread = threading.get_ident()
    if _open and thread == _holder:
        _host = _host or host
        _open += 1
        return True
    if thread != threading.main_thread().ident:
        return False
    handler = _signal.getsignal(_SIGINT)
    if not callable(handler):
        return False
    if handler is not _on_sigint:  # else it is inherited from the process that forked this one
        _handler = handler
    _holder, _host, _sections, _pending = thread, host, 0, False
    _signal.signal(_SIGINT, _on_sigint)
    _open = 1
    return True


def leave() -> None:
    """Ends what :func:`enter` began. The last one raises what is held back."""
    global _open, _pending  # noqa: PLW0603  as above
    _open -= 1
    if not _open:
        if _signal.getsignal(_SIGINT) is _on_sigint:  # else the plan has set another one
            _signal.signal(_SIGINT, _handler)
        if _pending:
            _pending = False
            signal.raise_signal(signal.SIGINT)


def is_pending() -> bool:
    """Whether Ctrl-C is being held back."""
    return _pending


def raise_pending() -> None:
    """Raises what is held back; for code of the main thread that isn't in a section and may be broken off here."""
    if _pending and not _sections and threading.get_ident() == _holder:
        drop_pending()
        _handler(_SIGINT, sys._getframe(1))  # noqa: SLF001  inspect.currentframe() gives no other


def drop_pending() -> None:
    """Forgets what is held back: the plan is being broken off already."""
    global _pending  # noqa: PLW0603  as above
    _pending = False


class Uninterrupted:
    """A section that SIGINT doesn't break off, where Python handles it.

    For the main thread: signals raise in no other, where it does nothing. Sections may nest; the outermost does it all.
    """

    __slots__ = ("_held",)

    def __enter__(self) -> Self:
        global _sections  # noqa: PLW0603  as above
        self._held = enter()
        _sections += self._held
        return self

    @property
    def noted(self) -> bool:
        """Whether an interrupt waits for the end of this section: what takes long asks now and then, and ends early."""
        return self._held and _pending and not _defers(sys._getframe(1))  # noqa: SLF001  as above

    def __exit__(self, *_: object) -> None:
        global _sections  # noqa: PLW0603  as above
        if self._held:
            _sections -= 1
            leave()
            if _pending and not _defers(sys._getframe(1)):  # noqa: SLF001  as above
                raise_pending()
