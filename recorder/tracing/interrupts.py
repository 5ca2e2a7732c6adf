"""Ctrl-C interrupts the plan's own Python immediately. Elsewhere, Ctrl-C is deferred, so that no state is broken.

Python raises KeyboardInterrupt between any two instructions. Ctrl-C therefore waits for the end of a section
(:class:`Uninterrupted`): a change or a record. In branches and in the plan language (:class:`Host`), Ctrl-C waits for
the next checkpoint. There, the main thread has our handler of SIGINT, which calls the previous handler.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # the enums of signal would take as long as keeping a record
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Final, Protocol, Self

_SIGINT: Final = int(signal.SIGINT)
_OURS: Final = ("pycram", "recorder", "replay", "_signal")  # packages whose handlers only interrupt the plan
_TERMINATING: Final = tuple(int(getattr(signal, name)) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class Terminated(SystemExit):
    """A signal has requested the end of the process. The exit code is 128 plus the signal's number, as in shells."""

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.signal = signal.Signals(number).name


class Host(Protocol):
    """A runner of code that can be interrupted only at checkpoints. Its methods are only called in the main thread."""

    @property
    def checkpoints(self) -> int:
        """Number of checkpoints that the main thread has passed."""

    def defers(self, frame: FrameType) -> bool:
        """Return whether a Ctrl-C in this frame must wait for the host's next checkpoint."""

    def interrupt(self) -> None:
        """Defer a Ctrl-C to the next checkpoint. The signal handler calls this method between any two instructions."""


_host: Host | None = None
_handler: Callable[[int, FrameType | None], Any] = signal.default_int_handler  # the previous handler
_holder = 0  # ident of the main thread; after a fork, the forking thread is the main thread
_open = 0  # number of open sections and scopes in the main thread; above 0, our handler is installed
_sections = 0
_pending = False
_terminated = 0  # signal of the last interrupt; 0 for Ctrl-C
_owner = 0  # id of the process that has called :func:`terminable`
_checkpoint = 0  # number of the host's checkpoint at which the last interrupt was raised


def _on_sigint(number: int, frame: FrameType | None) -> None:
    global _pending  # noqa: PLW0603  the process has only one main thread
    if _handler is _ignore and not _terminated:
        return
    if threading.get_ident() != _holder:  # if another thread forked this process, no section is open
        _signal.signal(_SIGINT, _handler)
        _handler(number, frame)
    elif _sections or (frame is not None and (frame.f_globals is globals() or _defers(frame))):
        if _host is not None:
            _host.interrupt()
        _pending = True
    else:
        _note_checkpoint()
        _handler(number, frame)


def _note_checkpoint() -> None:
    global _checkpoint  # noqa: PLW0603  as above
    _checkpoint = _host.checkpoints if _host is not None else 0


def interrupted_at() -> int:
    """Return the host's checkpoint at which the last interrupt was raised, from 1; 0 outside of checkpoints."""
    return _checkpoint


def _defers(frame: FrameType) -> bool:
    return _host is not None and _host.defers(frame)


def enter(host: Host | None = None) -> bool:
    """Install our handler until :func:`leave`, and return whether it is installed; only the main thread can do so.

    Until :func:`leave`, the host decides whether Ctrl-C is deferred.
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
    if handler is not _on_sigint:  # a parent process may already have installed our handler
        _handler = handler
    _holder, _host, _sections, _pending = thread, host, 0, False
    _signal.signal(_SIGINT, _on_sigint)
    _open = 1
    return True


def leave() -> None:
    """Undo :func:`enter`; the outermost call raises a deferred Ctrl-C."""
    global _open, _pending  # noqa: PLW0603  as above
    _open -= 1
    if not _open:
        if _signal.getsignal(_SIGINT) is _on_sigint:  # if not, the plan has set another handler
            _signal.signal(_SIGINT, _handler)
        if _pending:
            _pending = False
            signal.raise_signal(signal.SIGINT)


@contextmanager
def terminable() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP as Ctrl-C in the block, unless the program handles these signals.

    After such a signal, Terminated is raised at the end of the block, even if the plan has caught the interrupt.
    Outside of the main thread, this function has no effect.
    """
    taken = _take()
    try:
        yield
    except KeyboardInterrupt as interrupt:
        if taken and _terminated:
            raise Terminated(_terminated) from interrupt
        raise
    else:
        if taken and _terminated and os.getpid() == _owner:
            raise Terminated(_terminated)
    finally:
        for number, before in taken:
            if signal.getsignal(number) in (_on_termination, _ignore):  # if not, the plan has set another handler
                signal.signal(number, before)


def _take() -> list[tuple[int, signal.Handlers]]:
    """Install handlers for signals that the program doesn't handle. Return the signals and their previous handlers."""
    global _terminated, _owner
    if threading.current_thread() is not threading.main_thread():
        return []
    taken = [(number, signal.SIG_DFL) for number in _TERMINATING if signal.getsignal(number) is signal.SIG_DFL]
    if taken:
        _terminated, _owner = 0, os.getpid()
        if signal.getsignal(_SIGINT) is signal.SIG_IGN:  # background jobs ignore SIGINT, but sections need a handler
            signal.signal(_SIGINT, _ignore)
            taken.append((_SIGINT, signal.SIG_IGN))
    for number, before in taken:
        if before is signal.SIG_DFL:
            signal.signal(number, _on_termination)
    return taken


def _on_termination(number: int, frame: FrameType | None) -> None:
    global _terminated  # noqa: PLW0603  as above
    _terminated = number
    interrupt = signal.getsignal(_SIGINT)
    (interrupt if callable(interrupt) else signal.default_int_handler)(_SIGINT, frame)


def _in_child() -> None:
    """Let SIGTERM and SIGHUP kill a forked process, such as a worker of a pool, even while native code waits."""
    for number in _TERMINATING:
        if signal.getsignal(number) is _on_termination:
            signal.signal(number, signal.SIG_DFL)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)


def _ignore(number: int, frame: FrameType | None) -> None:
    """Ignore Ctrl-C, but not SIGTERM and SIGHUP."""
    if _terminated:
        signal.default_int_handler(number, frame)


def interrupted_by() -> str:
    """Return the name of the signal that caused an interrupt: "SIGINT", "SIGTERM" or "SIGHUP"."""
    return signal.Signals(_terminated or _SIGINT).name


def has_handlers() -> bool:
    """Return whether the program handles a signal in Python. Handlers of PyCRAM's packages don't count."""
    handlers = (*map(signal.getsignal, signal.valid_signals()), _handler if _open else None)
    return any(callable(each) and str(each.__module__).partition(".")[0] not in _OURS for each in handlers)


def is_uninterrupted() -> bool:
    """Return whether the main thread is in a section."""
    return bool(_open and _sections)


def is_pending() -> bool:
    """Return whether a Ctrl-C is deferred."""
    return _pending


def raise_pending() -> None:
    """Raise a deferred Ctrl-C, unless a section is open. Only code that may be interrupted calls this function."""
    if _pending and not _sections and threading.get_ident() == _holder:
        drop_pending()
        _note_checkpoint()
        _handler(_SIGINT, sys._getframe(1))  # noqa: SLF001  the caller's frame


def drop_pending() -> None:
    """Drop a deferred Ctrl-C, because the plan is already interrupted."""
    global _pending  # noqa: PLW0603  as above
    _pending = False


_soon: Callable[[], bool] | None = None


def call_soon(function: Callable[[], bool]) -> None:
    """Call a function after each outermost section of the main thread, until the function returns True."""
    global _soon  # noqa: PLW0603  the process has only one main thread
    _soon = function


def _call() -> None:
    """Call the function of :func:`call_soon` once; sections that this function opens don't call the function again."""
    global _soon  # noqa: PLW0603  as above
    if threading.get_ident() != threading.main_thread().ident:
        return
    function, _soon = _soon, None
    if function is not None and not function():
        _soon = function


class Uninterrupted:
    """A section that SIGINT doesn't interrupt. Sections may be nested; outside of the main thread, they do nothing."""

    def __enter__(self) -> Self:
        global _sections  # noqa: PLW0603  as above
        self._held = enter()
        _sections += self._held
        return self

    @property
    def noted(self) -> bool:
        """Whether a Ctrl-C waits for the end of this section. Long sections poll this property, and end early."""
        return self._held and _pending and not _defers(sys._getframe(1))  # noqa: SLF001  as above

    def __exit__(self, *_: object) -> None:
        global _sections  # noqa: PLW0603  as above
        if self._held:
            _sections -= 1
            leave()
            if _pending and not _defers(sys._getframe(1)):  # noqa: SLF001  as above
                raise_pending()
        if _soon is not None and not _sections:
            _call()


@contextmanager
def partial_folder(path: Path) -> Iterator[Path]:
    """Make a hidden folder beside ``path``, for what is moved there when it is complete. Ctrl-C leaves no folder."""
    from tempfile import TemporaryDirectory  # noqa: PLC0415  slow to import

    with Uninterrupted():  # otherwise, Ctrl-C might come before anybody is to remove the folder
        folder = TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent, ignore_cleanup_errors=True)
    with folder:
        yield Path(folder.name)
