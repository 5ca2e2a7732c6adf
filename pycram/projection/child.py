"""Forked children: processes that continue the plan and send one answer; they end no later than their parent."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import math
import os
import random
import select
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Generic, NoReturn, TypeVar

from pycram.language.nesting import nothing_open
from pycram.motions.process_module import forget_claims
from pycram.scheduling.cancellation import begin_alone, checkpoint
from pycram.scheduling.schedule import MISSED_SIGNALS_EVERY, is_held
from pycram.world.world import number_anew, open_worlds
from recorder.tracing import forking, interrupts

Job = TypeVar("Job")

GRACE: Final = 5.0  # seconds between the interrupt of a run and its SIGKILL
_PR_SET_PDEATHSIG: Final = 1
_SIZE: Final = "/proc/self/statm"  # the file with the size of the process in pages
_BLOCK: Final = 1 << 20  # maximum number of bytes of one read
_CRASHED: Final = 70  # exit code of a child with an error outside of the action
_prctl: Any = None  # loaded before any fork, because loading changes half a megabyte of memory in each child
with contextlib.suppress(OSError, AttributeError, TypeError):  # only Linux has this library
    _prctl = ctypes.CDLL(None).prctl


class Child:
    """A forked process that calls a function and sends the result as its answer."""

    def __init__(self, answer: Callable[[], bytes]) -> None:
        self.received = bytearray()  # the received part of the answer
        self.ended = False
        self.status = 0  # the status that os.waitpid returned
        self.began = time.monotonic()
        self._reading, writing = os.pipe()
        parent, dice = os.getpid(), random.getstate()  # forking would reseed Python's random numbers
        with contextlib.ExitStack() as undoing:
            undoing.callback(os.close, self._reading)
            undoing.callback(os.close, writing)
            self.pid = forking.fork()
            undoing.pop_all()
        if not self.pid:
            random.setstate(dice)
            _run(answer, writing, parent)
        os.close(writing)

    def fileno(self) -> int:
        """Return the file descriptor of the answer."""
        return self._reading

    def read(self) -> None:
        """Read a part of the answer; at the end of the answer, wait for the process."""
        part = os.read(self._reading, _BLOCK)
        self.received += part
        if not part:
            self._reap()

    def kill(self) -> None:
        """Kill the process if it still runs."""
        if not self.ended:
            os.kill(self.pid, signal.SIGKILL)
            self._reap()

    @property
    def how(self) -> str:
        """The end of the process, as text."""
        code = os.waitstatus_to_exitcode(self.status)  # the exit code is negative after a signal
        return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"

    def _reap(self) -> None:
        _, self.status = os.waitpid(self.pid, 0)  # after an interrupt here, a later kill() reaps the process
        self.ended = True
        os.close(self._reading)


def usable_cores() -> int:
    """Return the number of children that can run in parallel."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def obstacle() -> str:
    """Return why this process can't be copied now, and what to do; "" if it can be copied."""
    if not hasattr(os, "fork"):
        return "this system can't copy a process (os.fork)"
    for world in open_worlds():
        if world.mode == "GUI":
            return f"{world.name} has a window, which a copy can't have; open the world with BulletWorld()"
        if world.realtime:
            return f"{world.name} runs in real time; first call set_realtime(False)"
    threads = [thread.name for thread in forking.others()]
    if threads:
        return (
            f"the copy would lack the thread{'s' if threads[1:] else ''} {', '.join(threads)}; use branches of "
            "`with par` instead, and let in_thread(...) end first"
        )
    return ""


def has_children() -> bool:
    """Return whether this process has child processes; a copy couldn't wait for them."""
    if not hasattr(os, "waitid"):
        return False
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)  # this call doesn't reap a child
    except ChildProcessError:
        return False
    return True


def _run(answer: Callable[[], bytes], writing: int, parent: int) -> NoReturn:
    """Run the child, which doesn't write to, close or clean up anything of the parent."""
    try:
        die_with(parent)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        nothing = open(os.devnull, "r+", encoding="utf-8")  # noqa: SIM115, PTH123  it stays open until the process ends
        errors = open(os.devnull, "w", encoding="utf-8", errors="backslashreplace")  # noqa: SIM115, PTH123  as above
        for descriptor in range(3):  # native code and handlers of logging may print
            os.dup2(nothing.fileno(), descriptor)
        sys.stdin, sys.stdout, sys.stderr = nothing, nothing, errors
        os.register_at_fork(after_in_child=partial(_leave, writing, os.getpid()))
        begin_alone()
        interrupts.drop_pending()
        for world in open_worlds():
            world.waits.clear()  # the child doesn't continue the waiting branches
        nothing_open()
        forget_claims()
        text = answer()
        while text:
            text = text[os.write(writing, text) :]
    except BaseException:  # noqa: BLE001  errors of the action are part of the answer
        os._exit(_CRASHED)
    os._exit(0)


def _leave(writing: int, parent: int) -> None:
    """Let a process that the child's action has forked send no answer, and end with the child."""
    if os.getppid() == parent:
        os.close(writing)
        die_with(parent)


def die_with(parent: int) -> None:
    """Make the kernel kill this process when its parent ends."""
    if _prctl is not None:
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(_CRASHED)


def can_limit_memory() -> bool:
    """Return whether this system can limit the additional memory of a process, as Linux can."""
    return Path(_SIZE).exists()


def limit_memory(memory: int) -> None:
    """Limit the additional memory of this process to some bytes; larger requests raise MemoryError."""
    import resource  # noqa: PLC0415  this module exists only on systems that can fork

    with open(_SIZE, encoding="ascii") as file:  # noqa: PTH123  the limit is given by its name
        pages = int(file.read().split()[0])
    limit = pages * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


@dataclass(frozen=True, slots=True)
class ChildResult:
    """The result of a child."""

    answer: bytes  # the answer of the child; b"" if it sent none
    late: bool  # whether the child exceeded its time limit
    how: str  # how the process ended, as text
    seconds: float  # duration


class _Running:
    """A child with a time limit. At the limit the child is interrupted, and after a grace time it is killed."""

    def __init__(self, child: Child, limit: float | None, grace: float) -> None:
        self.child = child
        self._end = math.inf if limit is None else child.began + limit
        self._grace = grace
        self._late = False

    def time_left(self) -> float:
        """Return the seconds until the next signal, at most the period after which missed signals are noticed."""
        return min(max(0.0, self._end - time.monotonic()), MISSED_SIGNALS_EVERY)

    def result(self) -> ChildResult | None:
        """Send the signal that is due. Return the child's result, or None while it runs."""
        child = self.child
        if not child.ended and time.monotonic() >= self._end:
            if self._late or not self._grace:
                child.kill()
            else:
                self._end = time.monotonic() + self._grace
                os.kill(child.pid, signal.SIGTERM)
            self._late = True
        if not child.ended:
            return None
        return ChildResult(bytes(child.received), self._late, child.how, time.monotonic() - child.began)


class ChildPool(Generic[Job]):
    """Children that run in parallel, each for at most ``limit`` seconds of wall-clock time.

    ``grace`` is the time in s between a SIGTERM at the limit and a SIGKILL; without it, SIGKILL comes at the limit.
    """

    def __init__(self, cores: int, limit: float | None, grace: float = 0.0) -> None:
        self.cores = cores
        self.limit = limit
        self._grace = grace
        self._running: dict[Job, _Running] = {}

    def run(self, waiting: deque[Job], start: Callable[[Job], Child]) -> Generator[tuple[Job, ChildResult], None, None]:
        """Yield each job and its child's result when the child ends. Closing the generator kills the other children.

        Between results, the caller may add jobs to ``waiting`` or remove them. ``start`` starts a job's child.
        """
        running = self._running
        try:
            while waiting or running:
                while waiting and len(running) < self.cores:
                    job = waiting.popleft()
                    running[job] = _Running(start(job), self.limit, self._grace)
                timeout = min(each.time_left() for each in running.values())
                for child in select.select([each.child for each in running.values()], (), (), timeout)[0]:
                    child.read()
                if interrupts.is_pending():
                    checkpoint()
                for job, each in list(running.items()):
                    if job in running and (result := each.result()) is not None:
                        del running[job]
                        yield job, result
        finally:
            for job in list(running):
                self.kill(job)

    def is_running(self, job: Job) -> bool:
        """Return whether a job's child runs."""
        return job in self._running

    def kill(self, job: Job) -> None:
        """Kill a job's child; the job isn't yielded."""
        self._running.pop(job).child.kill()


def first_true(questions: Sequence[Callable[[], bool]]) -> int | None:
    """Return the index of the first question with the answer True; None if there is none, or if copying is impossible.

    A copy of this process answers each question. Nothing is recorded, and an error counts as False.
    """
    if obstacle() or is_held():
        return None
    answers: dict[int, bytes] = {}
    waiting = deque(range(len(questions)))

    def start(number: int) -> Child:
        return Child(lambda: b"yes" if questions[number]() else b"")

    pool: ChildPool[int] = ChildPool(usable_cores(), None)
    with contextlib.closing(pool.run(waiting, start)) as results:
        for number, result in results:
            answers[number] = result.answer
            known = itertools.takewhile(answers.__contains__, itertools.count())
            first = next((each for each in known if answers[each]), None)
            if first is not None:
                return first
    return None


def run_from_start(answer: Callable[[], bytes]) -> Child:
    """Fork a child that runs a program from its start; its worlds get the same names as in a new process."""

    def answer_from_start() -> bytes:
        number_anew()
        return answer()

    return Child(answer_from_start)
