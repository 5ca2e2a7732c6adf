"""Forks of a process that records; no other module forks.

The child has only the thread that forked, so no other thread of PyCRAM may hold a lock during the fork. A recording
belongs to its process. If a child continues its parent, the recording belongs to the child, and the parent only waits.
"""

from __future__ import annotations

import os
import random
import signal
import stat
import sys
import threading
import weakref
from collections.abc import Callable
from contextlib import nullcontext
from typing import Final
from warnings import catch_warnings, simplefilter

from recorder.tracing import journal

#: Signals that are blocked during a fork, because Python would drop errors of their handlers.
_INTERRUPTS: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

_WARNS: Final = sys.version_info >= (3, 12)  # Python warns if a process with threads forks

_own: Final[weakref.WeakSet[threading.Thread]] = weakref.WeakSet()


def own(thread: threading.Thread) -> threading.Thread:
    """Mark a thread as one of PyCRAM's own. Forked children don't need this thread."""
    _own.add(thread)
    return thread


def others() -> list[threading.Thread]:
    """Return the other threads of this process, except PyCRAM's own. A forked child would not have these threads."""
    return [
        thread for thread in threading.enumerate() if thread is not threading.current_thread() and thread not in _own
    ]


def fork() -> int:
    """Fork while PyCRAM's own threads are paused. In the child, return 0; no journal is open there."""
    child = _fork(os.fork)
    if not child:
        journal.forget_all()
    return child


def fork_continuation() -> int:
    """Fork a child that continues this process with its open journals. Return 0 in the child.

    From then on, this process may only wait. Sinks must not have threads, nor files that both processes would write.
    """
    state = random.getstate()  # in a child, Python would reseed random numbers
    child = _fork(_fork_continuing)
    if not child:
        random.setstate(state)
    return child


def _fork(fork: Callable[[], int]) -> int:
    with journal.still(), catch_warnings() if _WARNS else nullcontext():
        if _WARNS:
            simplefilter("ignore", DeprecationWarning)  # PyCRAM's own threads are paused
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
        try:
            child = fork()
            if not child:
                _separate_file_positions()
            return child
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


_identity: int | None = None  # identity of the process that this process continues
_continuing = False  # whether a child that continues this process is being forked


def process() -> int:
    """Return the identity of this process: its process id, or the identity of the process that it continues."""
    return os.getpid() if _identity is None else _identity


def _fork_continuing() -> int:
    global _identity, _continuing  # noqa: PLW0603  a process has only one identity
    before, _identity, _continuing = _identity, process(), True
    child = -1
    try:
        child = os.fork()
    finally:
        _continuing = False
        if child:
            _identity = before
    return child


def _in_forked_child() -> None:
    global _identity  # noqa: PLW0603  as above
    if not _continuing:
        _identity = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_forked_child)

_OPEN: Final = "/proc/self/fd"  # only Linux has this folder, which lists the open files
_OF_PATHS: Final = getattr(os, "O_NOFOLLOW", 0)  # flag for not following links; 0 on systems without this flag


def _separate_file_positions() -> None:
    """Give this child its own positions in files open for reading, so that the parent reads the whole content, too."""
    try:
        descriptors = os.listdir(_OPEN)  # noqa: PTH208  few allocations, because each written page is copied
    except OSError:
        return
    for descriptor in descriptors:
        try:
            _reopen(int(descriptor))
        except OSError:  # the file was closed, or can't be opened again
            continue


def _reopen(descriptor: int) -> None:
    import fcntl  # noqa: PLC0415  only systems that can fork have this module

    flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
    if flags & os.O_ACCMODE != os.O_RDONLY or not stat.S_ISREG(os.fstat(descriptor).st_mode):
        return
    position = os.lseek(descriptor, 0, os.SEEK_CUR)
    again = os.open(f"{_OPEN}/{descriptor}", flags & ~_OF_PATHS)
    try:
        os.lseek(again, position, os.SEEK_SET)
        os.dup2(again, descriptor, inheritable=os.get_inheritable(descriptor))
    finally:
        os.close(again)
