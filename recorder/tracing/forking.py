"""Forks of a process that records: the only place where it forks.

Only the forking thread lives on in the child. Our other threads (those that flush a file, or feed a viewer) belong to
the parent's recordings, which the child leaves alone. So none of them may hold a lock at that moment.

A forked child is another process, unless it continues its parent, which then only waits. So a recording belongs to its
process and to the one that continues it, but not to other children.
"""

from __future__ import annotations

import os
import random
import signal
import stat
import sys
import threading
import weakref
from contextlib import nullcontext
from typing import TYPE_CHECKING, Final
from warnings import catch_warnings, simplefilter

from recorder.tracing import journal

if TYPE_CHECKING:
    from collections.abc import Callable


#: They wait for the end of a fork: Python drops what a handler raises within the hooks that it calls there.
_INTERRUPTS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_WARNS: Final = sys.version_info >= (3, 12)  # of a fork beside threads

_own: Final[weakref.WeakSet[threading.Thread]] = weakref.WeakSet()


def own(thread: threading.Thread) -> threading.Thread:
    """Mark a thread as ours: one that a forked child does without."""
    _own.add(thread)
    return thread


def others() -> list[threading.Thread]:
    """All threads that a forked child would lack but ours."""
    return [
        thread for thread in threading.enumerate() if thread is not threading.current_thread() and thread not in _own
    ]


def fork() -> int:
    """Fork while our threads are parked; returns 0 in the child, where no journal is open any more."""
    child = _fork(os.fork)
    if not child:
        journal.forget_all()
    return child


def fork_continuation() -> int:
    """Fork a child that goes on as this process, with its open journals, while this one waits; returns 0 in the child.

    Sinks of such journals have no thread and no file that both would write to.
    """
    dice = random.getstate()  # which Python seeds again in a child
    child = _fork(_fork_continuing)
    if not child:
        random.setstate(dice)
    return child


def _fork(fork: Callable[[], int]) -> int:
    with journal.still(), catch_warnings() if _WARNS else nullcontext():
        if _WARNS:
            simplefilter("ignore", DeprecationWarning)  # of threads: ours are parked
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
        try:
            child = fork()
            if not child:
                _separate_file_positions()
            return child
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


_identity: int | None = None  # of a process that continues another one
_continuing = False  # while one is forked


def process() -> int:
    """Return the identity of this process: its number, or that of the process that it continues."""
    return os.getpid() if _identity is None else _identity


def _fork_continuing() -> int:
    """Fork a child that continues this process, which must do nothing more that others see; return 0 in the child."""
    global _identity, _continuing  # noqa: PLW0603  a process has one identity
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


_OPEN: Final = "/proc/self/fd"  # only Linux has it
_OF_PATHS: Final = getattr(os, "O_NOFOLLOW", 0)  # the links there are to be followed


def _separate_file_positions() -> None:
    """Give this process, a forked child, positions of its own in the files that are open for reading alone.

    Else its parent would miss what it reads. Files that are written stay common, as logs are.
    """
    try:
        descriptors = os.listdir(_OPEN)  # noqa: PTH208  as little as can be: each page that this writes to is a copy's own
    except OSError:
        return
    for descriptor in descriptors:
        try:
            _reopen(int(descriptor))
        except OSError:  # it was closed meanwhile, or may not be opened any more
            continue


def _reopen(descriptor: int) -> None:
    import fcntl  # noqa: PLC0415  only systems that can fork have it

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
