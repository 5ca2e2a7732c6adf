"""Forks of a process that records: the one place where threads of ours are parked for one.

Only the forking thread lives on in the child. Our other threads (those that flush a file, or feed a viewer) belong to
the parent's recordings, which the child leaves alone. So it is enough that none of them holds a lock at that moment.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import threading
import weakref
from contextlib import nullcontext
from typing import TYPE_CHECKING, Final
from warnings import catch_warnings, simplefilter

from recorder.tracing import file_positions, journal, process_identity

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
    child = _fork(process_identity.fork_continuation)
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
                file_positions.have_own()
            return child
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
