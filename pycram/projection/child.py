"""Forked children: processes that continue the plan, send one answer, and never outlive their parent.

Projections, explorations and local sweeps run their children in a :class:`ChildPool`.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import random
import select
import signal
import sys
import time
from collections import deque
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, NoReturn, TypeVar

from pycram.language.nesting import nothing_open
from pycram.motions.process_module import forget_claims
from pycram.scheduling.cancellation import begin_alone, checkpoint
from pycram.scheduling.schedule import MISSED_SIGNALS_EVERY, is_held
from pycram.world.world import number_anew, open_worlds
from recorder.tracing import forking, interrupts

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence


Job = TypeVar("Job")

GRACE: Final = 5.0  # seconds that an interrupted run of a plan is given to end
_PR_SET_PDEATHSIG: Final = 1
_SIZE: Final = "/proc/self/statm"  # file with the size of this process, in pages
_BLOCK: Final = 1 << 20  # bytes of one read
_CRASHED: Final = 70  # exit code of a child that has an error of its own
_prctl: Any = None  # looked up once: in each child, the lookup would change half a megabyte of memory
with contextlib.suppress(OSError, AttributeError, TypeError):  # only Linux has it
    _prctl = ctypes.CDLL(None).prctl


class Child:
    """A forked process that calls a function and sends the result as its answer."""

    def __init__(self, answer: Callable[[], bytes]) -> None:
        self.received = bytearray()  # the part of the answer that has arrived
        self.ended = False
        self.status = 0  # as ``os.waitpid`` returns it
        self.began = time.monotonic()
        self._reading, writing = os.pipe()
        parent, dice = os.getpid(), random.getstate()  # Python seeds its generator again in a child
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
        """Return the file descriptor of its answer."""
        return self._reading

    def read(self) -> None:
        """Read a part of its answer; at its end, wait for the process."""
        part = os.read(self._reading, _BLOCK)
        self.received += part
        if not part:
            self._reap()

    def kill(self) -> None:
        """Kill the process, if it runs."""
        if not self.ended:
            os.kill(self.pid, signal.SIGKILL)
            self._reap()

    @property
    def how(self) -> str:
        """How the process ended, in words."""
        code = os.waitstatus_to_exitcode(self.status)  # negative for a signal
        return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"

    def _reap(self) -> None:
        _, self.status = os.waitpid(
            self.pid, 0
        )  # first: after an interrupt here, the process is killed and reaped again
        self.ended = True
        os.close(self._reading)


def usable_cores() -> int:
    """Return the number of children that can run in parallel."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def obstacle() -> str:
    """Return why this process can't be copied now, and what to do; "" if it can."""
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
    """Return whether this process has child processes, which a copy of it couldn't wait for."""
    if not hasattr(os, "waitid"):
        return False
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)  # leaves all of them
    except ChildProcessError:
        return False
    return True


def wait(children: Sequence[Child], timeout: float | None) -> None:
    """Read from the first children that send data; return after the timeout in s if none does."""
    for child in select.select(children, (), (), timeout)[0]:
        child.read()


def _run(answer: Callable[[], bytes], writing: int, parent: int) -> NoReturn:
    """Run the child; it doesn't write to, close or clean up anything of the parent."""
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
    except BaseException:  # noqa: BLE001  an error of the child itself: the answer has errors of the action
        os._exit(_CRASHED)
    os._exit(0)


def _leave(writing: int, parent: int) -> None:
    """Run in a process that the child's action has forked: it sends no part of the answer, and ends with the child."""
    if os.getppid() == parent:  # its own children inherit its open files
        os.close(writing)
        die_with(parent)


def die_with(parent: int) -> None:
    """Make the kernel kill this process when its parent ends."""
    if _prctl is not None:
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(_CRASHED)


def can_limit_memory() -> bool:
    """Return whether this system limits the additional memory of a process; only Linux tells its present size."""
    return Path(_SIZE).exists()


def limit_memory(memory: int) -> None:
    """Limit the additional memory of this process, in bytes; larger requests raise MemoryError."""
    import resource  # noqa: PLC0415  only systems that can fork have it

    with open(_SIZE, encoding="ascii") as file:  # noqa: PTH123  of this very process
        pages = int(file.read().split()[0])
    limit = pages * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


@dataclass(frozen=True, slots=True)
class ChildResult:
    """The result of a child."""

    answer: bytes  # the answer of the child; b"" if it sent none
    late: bool  # whether it exceeded the time limit
    how: str  # how its process ended, in words
    seconds: float  # its duration


class _Running:
    """A child with a time limit: it is interrupted at the limit, and killed after a grace time."""

    def __init__(self, child: Child, limit: float | None, grace: float) -> None:
        self.child = child
        self._end = None if limit is None else child.began + limit
        self._grace = grace
        self._late = False

    def time_left(self) -> float:
        """Return the seconds until its next signal, at most the period in which missed signals are checked."""
        if self._end is None:
            return MISSED_SIGNALS_EVERY
        return min(max(0.0, self._end - time.monotonic()), MISSED_SIGNALS_EVERY)

    def result(self) -> ChildResult | None:
        """Return its result, None while it runs; send a due signal."""
        child = self.child
        if not child.ended and self._end is not None and time.monotonic() >= self._end:
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
    """Children that run in parallel.

    Args:
        cores: Maximum number of children.
        limit: Seconds of wall-clock time for each; None for no limit.
        grace: Seconds between a SIGTERM at the limit and a SIGKILL; 0 for a SIGKILL at the limit.
    """

    def __init__(self, cores: int, limit: float | None, grace: float = 0.0) -> None:
        self.cores = cores
        self.limit = limit
        self._grace = grace
        self._running: dict[Job, _Running] = {}

    def run(self, waiting: deque[Job], start: Callable[[Job], Child]) -> Generator[tuple[Job, ChildResult], None, None]:
        """Yield each job with its child's result when it ends; closing the generator kills the remaining children.

        Args:
            waiting: The jobs in order; the caller may add or remove jobs between results.
            start: Starts the child of a job.
        """
        running = self._running
        try:
            while waiting or running:
                while waiting and len(running) < self.cores:
                    job = waiting.popleft()
                    running[job] = _Running(start(job), self.limit, self._grace)
                wait([each.child for each in running.values()], min(each.time_left() for each in running.values()))
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
        """Kill a job's child; the job is not yielded."""
        self._running.pop(job).child.kill()


def first_true(questions: Sequence[Callable[[], bool]]) -> int | None:
    """Return the number of the first question that is true, each answered in a copy of this process.

    A question may change the worlds of its copy. Nothing is recorded, and an error is no.

    Returns:
        None if none is true, or if the process can't be copied now.
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
    """Fork a child that runs a program from its start, with the same names of worlds as in a new process."""

    def answer_from_start() -> bytes:
        number_anew()
        return answer()

    return Child(answer_from_start)
