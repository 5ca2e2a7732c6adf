"""Forks of a process that records: only this module forks.

Only the forking thread exists in the child. Our other threads, which flush a file or feed a viewer, belong to the
parent's recordings. The child doesn't touch these recordings, but no such thread may hold a lock during the fork.

A forked child is a new process, unless it continues its parent, which only waits from then on. So a recording belongs
to its process and to a child that continues this process, but not to other children.
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


#: Signals that are blocked during a fork: Python drops errors that signal handlers raise within the hooks of a fork.
_INTERRUPTS: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

_WARNS: Final = sys.version_info >= (3, 12)  # whether Python warns if a process with threads forks

_own: Final[weakref.WeakSet[threading.Thread]] = weakref.WeakSet()


def own(thread: threading.Thread) -> threading.Thread:
    """Mark a thread as ours, so that it needn't exist in forked children."""
    _own.add(thread)
    return thread


def others() -> list[threading.Thread]:
    """Return the other threads of this process that aren't ours; a forked child would lack them."""
    return [
        thread for thread in threading.enumerate() if thread is not threading.current_thread() and thread not in _own
    ]


def fork() -> int:
    """Fork while our threads are paused; return 0 in the child, where no journal is open."""
    child = _fork(os.fork)
    if not child:
        journal.forget_all()
    return child


def fork_continuation() -> int:
    """Fork a child that continues this process with its open journals while this process waits; return 0 in the child.

    The sinks of these journals must have no threads, and no files that both processes would write.
    """
    state = random.getstate()  # Python seeds the random numbers of a child again
    child = _fork(_fork_continuing)
    if not child:
        random.setstate(state)
    return child


def _fork(fork: Callable[[], int]) -> int:
    with journal.still(), catch_warnings() if _WARNS else nullcontext():
        if _WARNS:
            simplefilter("ignore", DeprecationWarning)  # Python warns about other threads, but ours are paused
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
        try:
            child = fork()
            if not child:
                _separate_file_positions()
            return child
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


_identity: int | None = None  # identity of the original process, if this process continues it
_continuing = False  # True while a continuing child is forked


def process() -> int:
    """Return the identity of this process: its process id, or the id of the process that it continues."""
    return os.getpid() if _identity is None else _identity


def _fork_continuing() -> int:
    """Fork a child that continues this process, after which this process may only wait; return 0 in the child."""
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


_OPEN: Final = "/proc/self/fd"  # folder of open files, which only Linux has
_OF_PATHS: Final = getattr(os, "O_NOFOLLOW", 0)  # flag that forbids to follow links; 0 on systems that lack it


def _separate_file_positions() -> None:
    """Give this process, a forked child, its own positions in files that are open for reading only.

    With shared positions, the parent would miss the content that the child reads. Files that are written, such as logs,
    stay shared.
    """
    try:
        descriptors = os.listdir(_OPEN)  # noqa: PTH208  few allocations: each written page is copied
    except OSError:
        return
    for descriptor in descriptors:
        try:
            _reopen(int(descriptor))
        except OSError:  # another thread has closed the file, or it can't be opened again
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
