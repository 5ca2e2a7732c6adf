"""Forked children: processes that continue the plan, send one answer, and never outlive their parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import select
import signal
import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NoReturn

from pycram.language.nesting import nothing_open
from pycram.motions.process_module import forget_claims
from pycram.scheduling.cancellation import begin_alone
from pycram.world.world import open_worlds
from recorder.tracing import forking, interrupts

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_PR_SET_PDEATHSIG: Final = 1
_BLOCK: Final = 1 << 20  # bytes that are read at once
_CRASHED: Final = 70
_prctl: Any = None  # looked up here, as each child would change half a megabyte of memory in doing so
with contextlib.suppress(OSError, AttributeError, TypeError):  # only Linux has it
    _prctl = ctypes.CDLL(None).prctl


class Child:
    """A forked process that calls a function, and sends the result as its answer."""

    def __init__(self, answer: Callable[[], bytes]) -> None:
        self.received = bytearray()  # of the answer, so far
        self.ended = False
        self.status = 0  # of ``os.waitpid``
        self.began = time.monotonic()
        self._reading, writing = os.pipe()
        parent, dice = os.getpid(), random.getstate()  # which Python seeds again in a child
        try:
            self.pid = forking.fork()
        except BaseException:
            os.close(self._reading)
            os.close(writing)
            raise
        if not self.pid:
            random.setstate(dice)
            _run(answer, writing, parent)
        os.close(writing)

    def fileno(self) -> int:
        """Return the file descriptor of its answer."""
        return self._reading

    def read(self) -> None:
        """Read a part of its answer; at its end, wait for the process."""
        part = os.read(self._reading, _BLOCK)
        self.received += part
        if not part:
            self._reap()

    def kill(self) -> None:
        """Kill it, if it runs."""
        if not self.ended:
            os.kill(self.pid, signal.SIGKILL)
            self._reap()

    @property
    def how(self) -> str:
        """How it ended, in words."""
        code = os.waitstatus_to_exitcode(self.status)  # negative for a signal
        return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"

    def _reap(self) -> None:
        os.close(self._reading)
        _, self.status = os.waitpid(self.pid, 0)
        self.ended = True


def usable_cores() -> int:
    """Return the number of children of this process that can run in parallel."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def obstacle() -> str:
    """Return why this process can't be copied at this moment, and what to do; "" if it can."""
    if not hasattr(os, "fork"):
        return "this system can't copy a process (os.fork)"
    for world in open_worlds():
        if world.mode == "GUI":
            return f"{world.name} has a window, which a copy can't have; open it with BulletWorld()"
        if world.realtime:
            return f"{world.name} runs in real time; call set_realtime(False) before"
    threads = [thread.name for thread in forking.others()]
    if threads:
        return (
            f"the copy would lack the thread{'s' if threads[1:] else ''} {', '.join(threads)}; branches of `with par` "
            "are copied, in_thread(...) has to end before"
        )
    return ""


def has_children() -> bool:
    """Return whether this process has child processes, which a copy of it couldn't wait for."""
    if not hasattr(os, "waitid"):
        return False
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)  # takes none of them
    except ChildProcessError:
        return False
    return True


def wait(children: Sequence[Child], timeout: float | None) -> None:
    """Read from the first children that send; return after the timeout in s if none does."""
    for child in select.select(children, (), (), timeout)[0]:
        child.read()


def _run(answer: Callable[[], bytes], writing: int, parent: int) -> NoReturn:
    """Run the child; it writes to, closes and cleans up nothing of the parent's."""
    try:
        die_with(parent)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        nothing = open(os.devnull, "r+", encoding="utf-8")  # noqa: SIM115, PTH123  until its end
        errors = open(os.devnull, "w", encoding="utf-8", errors="backslashreplace")  # noqa: SIM115, PTH123  as Python's
        for descriptor in range(3):  # also what native code and handlers of logging print
            os.dup2(nothing.fileno(), descriptor)
        sys.stdin, sys.stdout, sys.stderr = nothing, nothing, errors
        os.register_at_fork(after_in_child=partial(_leave, writing, os.getpid()))
        begin_alone()
        interrupts.drop_pending()
        for world in open_worlds():
            world.waits.forget()
        nothing_open()
        forget_claims()
        text = answer()
        while text:
            text = text[os.write(writing, text) :]
    except BaseException:  # noqa: BLE001  the answer has errors of the action; this is the child's own
        os._exit(_CRASHED)
    os._exit(0)


def _leave(writing: int, parent: int) -> None:
    """Run in a process that the child's action has forked: it has no part in the answer, and ends with the child."""
    if os.getppid() == parent:  # its own children inherit what it has
        os.close(writing)
        die_with(parent)


def die_with(parent: int) -> None:
    """Have the kernel end this process with its parent."""
    if _prctl is not None:
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(_CRASHED)


def limit_memory(memory: int) -> None:
    """Limit this process's additional memory to some bytes; larger requests raise MemoryError."""
    import resource  # noqa: PLC0415  only systems that can fork have it

    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123  of this very process
        pages = int(file.read().split()[0])
    limit = pages * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
