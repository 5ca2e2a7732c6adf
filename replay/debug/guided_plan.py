"""A recorded plan that runs again, and stops at a step. The plan moves from step to step, forwards and back.

At any moment, one process of the plan is stopped or runs. Other processes are copies that wait at earlier steps. The
parent of a process is the copy from which the process continues. All processes are therefore descendants of the first
process, and end with the first process. The first process ends with the debugger's process.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NoReturn, Self

from replay.debug.stopped_plan import PAUSE, Channel, Message, WatchedExpression
from replay.errors import Damaged, ReplayError
from replay.retrace.plan_process import FirstDifference, PlanProcess, last_output
from replay.retrace.retrace import likely_reasons

_MAX_WAITING: Final = 64  # maximum number of waiting copies
_POLL: Final = 0.2  # time in s between checks for Ctrl-C and for the end of the process
_PARTS: Final = 40  # number of parts into which copies divide a run
_SHORTEST: Final = 50_000_000  # minimum duration of a part in ns
_FINEST: Final = 4  # minimum number of steps between two new copies before the target of a step back


class PlanEnded(ReplayError):
    """The plan's process ended before it reached a step: it was killed, or native code crashed."""

    def __init__(self, printed: str) -> None:
        super().__init__(f"the plan's process has ended{printed and f':{chr(10)}{printed}'}; goto runs the plan again")


class EndedByInterrupt(Exception):
    """Ctrl-C was pressed twice, and ended the running process."""


class PlanInterrupted(ReplayError):
    """Ctrl-C ended the plan's process. The plan is at its previous step again, or hasn't started."""

    def __init__(self, step: int) -> None:
        where = f"step {step} again" if step >= 0 else "no step"
        super().__init__(f"the plan reached no other step, and is at {where}")
        self.step = step  # step of the plan; -1 before the first step


@dataclass(frozen=True, slots=True)
class Arrival:
    """The step at which a plan has stopped, and why it has stopped."""

    step: int  # the last recorded step that the plan has made
    #: "step" (the target), "watch" (a watched value has changed), "interrupted" (Ctrl-C), or "parted" (the next record
    #: differs from the recorded record).
    reason: str = "step"
    text: str = ""  # text of the difference from the recording
    changes: list[tuple[int, int, str, str]] = field(default_factory=list)  # step, watch's index, values before, after


class GuidedPlan:
    """A recorded plan that runs again, and is at a step.

    With ``checkpoints``, copies of the process wait at some steps. Without copies, the plan runs again from its start
    when it must go back. If the beginning of the recording is lost, Damaged is raised.
    """

    def __init__(self, process: PlanProcess, *, checkpoints: bool = True) -> None:
        log = process.log
        self.recorded_files = process.recorded_files  # the recorded source by path, if the plan runs from it
        self.notes = tuple(process.notes())  # differences from the recorded conditions
        self.step = -1  # last step that the recorded plan made; -1 before the first step
        self.last = len(log) - 1  # last step that the plan can reach
        self.parted = ""  # first difference from the recording, and its possible causes outside of the plan
        self._log = log
        log.check_file()  # after this check, all losses of the recording are known
        gap = next(iter(log.lost()), None)
        if gap is not None:
            self.last, self.parted = gap.start - 1, f"step {gap.start} is lost"
        if self.last < 0:
            raise Damaged(log.path, "its beginning", "no record is left to guide the plan")
        # durations are those of the recording, because the machine may now be slower
        spacing = max(log[-1].monotonic_ns // _PARTS, _SHORTEST)
        self.copies = PlanCopies(process, spacing if checkpoints and hasattr(os, "fork") else None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.copies.close()

    def go(self, step: int, watched: Sequence[WatchedExpression] = (), *, through: bool = False) -> Arrival:
        """Move the plan to a step, forwards or back.

        With watched expressions, the plan continues from its present step, and stops when a value changes. With
        ``through``, the plan doesn't stop at such changes, but collects them until the step.

        Raises:
            PlanEnded: The process ended before the step, so the plan is at no step.
            PlanInterrupted: The user pressed Ctrl-C twice before the plan reached a step. After that, the plan is at
                its previous step.
            ReplayError: The first record already differs, so this is another plan.
        """
        copies = self.copies
        if copies.now is None and watched:
            self.go(self.step)
        now = copies.now
        usable = [now] if watched else [now, *copies.waiting]
        before = [
            each
            for each in usable
            if each is not None and not each.parted and (each.step < step or (each.step == step and not each.between))
        ]
        origin = max(before, key=lambda each: each.step, default=None)
        if now is not None and now is not origin and now not in copies.waiting:
            copies.end(now)
        if origin is not None and origin.step == step and not watched:
            copies.now, self.step = origin, step
            return Arrival(step)
        left = self.step
        try:
            message: Message | None = None
            if origin is None:
                message = copies.start()
                origin = copies.now
            if origin is not None and not origin.parted and (origin.step < step or watched):
                conditions = {
                    "until": step,
                    "checkpoints": list(_halving(origin.step, step)) if step < left else [],
                    "watched": [[each.expression, each.file, each.first] for each in watched],
                    "through": through,
                }
                message = copies.go_on(origin, conditions)
        except EndedByInterrupt:
            if step > 0 or left >= 0:
                self.go(max(left, 0))
            raise PlanInterrupted(self.step) from None
        arrival = self._arrived(message) if message is not None else Arrival(step)
        copies.thin_out(self.step)
        return arrival

    def _arrived(self, message: Message) -> Arrival:
        found = message["difference"]
        if message["step"] < 0 and found is not None:
            raise ReplayError(f"this isn't the plan of the recording: {found['text']}")
        self.step = message["step"]
        if found is not None:
            difference = FirstDifference(**found)
            self.last = difference.step - 1
            self.parted = "; ".join((difference.text, *message["notes"], *likely_reasons(self._log, difference)))
        return Arrival(self.step, message["reason"], self.parted if found else "", message["changes"])

    def ask(self, what: str, **arguments: object) -> Any:
        """Send a question to the stopped plan (:class:`replay.debug.stopped_plan.StoppingSink`).

        Raises:
            PlanEnded: The plan's process has ended.
            ReplayError: The question has no answer.
            KeyboardInterrupt: The user pressed Ctrl-C; nothing has changed.
        """
        answer = self.copies.ask({"do": what, **arguments})
        if "error" in answer:
            raise ReplayError(answer["error"])
        return answer["answer"]


def _halving(start: int, step: int) -> Iterator[int]:
    """Yield steps between two steps. Each yielded step halves the distance that remains."""
    while step - start >= _FINEST:
        start += (step - start) // 2
        yield start


# --- processes --------------------------------------------------------------------------------------------------------


@dataclass(eq=False, slots=True)
class PlanCopy:
    """A process of the plan at a step."""

    channel: Channel  # connection to this process
    pid: int
    parent: PlanCopy | None  # the copy from which this process was forked; None for the first process
    step: int = -1  # last known step of the process
    parted: bool = False  # whether the next record differs from the recorded record
    can_wait: bool = False  # whether a copy of the process can be made at this step
    between: bool = False  # whether the process has stopped after a step's record, before the next record


class PlanCopies:
    """The processes of a plan. ``spacing`` is the recorded time between two copies in ns; None for no copies."""

    def __init__(self, process: PlanProcess, spacing: int | None) -> None:
        self.waiting: list[PlanCopy] = []  # waiting copies, each after its parent
        self.now: PlanCopy | None = None  # the stopped process, which may be a waiting copy; None while the plan runs
        self.runs = 0  # number of times that the first process was started
        self._process = process
        self._spacing = spacing
        self._root: subprocess.Popen[bytes] | None = None
        self._ending = False
        self._interrupts = 0  # number of times that Ctrl-C was pressed since the last message to the plan
        self.pause_wanted = False  # whether another thread wants the plan to stop, as after Ctrl-C
        self.killed = False  # whether another thread wants the plan to end
        with ExitStack() as undoing:
            folder = tempfile.TemporaryDirectory(prefix="pycram-debug-", ignore_cleanup_errors=True)
            self._folder = undoing.enter_context(folder)
            self._errors = undoing.enter_context(tempfile.TemporaryFile())
            self._listener = undoing.enter_context(socket.socket(socket.AF_UNIX))
            self._address = str(Path(self._folder) / "prompt")
            self._listener.bind(self._address)
            self._listener.listen()
            self._open = undoing.pop_all()

    def close(self) -> None:
        """End all processes."""
        self.end_all()
        self._open.close()

    def checkpoints(self) -> list[int]:
        """Return the steps of the waiting copies."""
        return sorted(each.step for each in self.waiting)

    # --- commands ---------------------------------------------------------------------------------------------------

    def start(self) -> Message:
        """Run the plan until its first record, and return the message that its process then sends."""
        self.end_all()
        self.runs += 1
        folder = Path(self._folder) / f"run-{self.runs}"
        folder.mkdir()
        guidance = self._process.guidance()
        with self._noting_interrupts():
            self._root = self._process.start(
                "replay.debug.stopped_plan",
                guidance,
                str(folder),
                self._errors,
                address=self._address,
                until=0,
                spacing=self._spacing,
            )
            return self._stopped(None)

    def go_on(self, origin: PlanCopy, conditions: Message) -> Message:
        """Continue a copy of the plan, or a new child of a copy that is kept. Return the message about the stop.

        Raises:
            PlanEnded: The process ended before a stop.
            EndedByInterrupt: The user pressed Ctrl-C twice.
        """
        stay = origin in self.waiting or (origin.can_wait and origin.parent is None)
        if stay and origin not in self.waiting:
            self.waiting.append(origin)
        with self._noting_interrupts():
            self.now = None
            origin.channel.send({"do": "go", "stay": stay, **conditions})
            return self._stopped(None if stay else origin)

    def ask(self, question: Message) -> Message:
        """Send a question to the stopped process, and return its answer (:meth:`GuidedPlan.ask`)."""
        now, passed_on = self.now, False
        if now is None:
            raise PlanEnded(last_output(self._errors))
        with self._noting_interrupts():
            now.channel.send(question)
            while not now.channel.poll(_POLL):
                if (self._interrupts or self.pause_wanted or self.killed) and not passed_on:
                    passed_on = True
                    now.channel.send({"do": "interrupt"})
            answer = _received(now.channel)
        if answer is None:
            self._lost(now)
        if passed_on or "interrupted" in answer:
            raise KeyboardInterrupt
        return answer

    @contextmanager
    def _noting_interrupts(self) -> Iterator[None]:
        """Count Ctrl-C in the ``with`` block, so that no KeyboardInterrupt separates a message from its answer."""
        self._interrupts = 0
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def note(_: int, __: object) -> None:
            self._interrupts += 1

        before = signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _stopped(self, running: PlanCopy | None) -> Message:
        """Wait until the running process, or a continuing child, has stopped. Return its message."""
        passed_on = False  # whether Ctrl-C was sent to the running process
        while True:
            sources: list[socket.socket | Channel] = [self._listener, *([running.channel] if running else [])]
            ready = select.select(sources, (), (), _POLL)[0]
            if self._listener in ready:
                running, passed_on = self._next(running), False
            elif ready and running is not None:
                message = _received(running.channel)
                if message is None:
                    self._lost(running)
                running.step = message["step"]
                if message["reason"] != "waits":
                    running.parted, running.can_wait = message["reason"] == "parted", message["can_wait"]
                    running.between = message["between"]
                    self.now = running
                    return message
                self.waiting.append(running)
                running = None
            elif self.killed or (self._root is not None and self._root.poll() is not None):
                self._lost(running)
            if self._interrupts > 1:
                self.end(running)
                raise EndedByInterrupt
            if (self._interrupts or self.pause_wanted) and running is not None:
                if not passed_on:
                    passed_on = True
                    running.channel.send({"do": "interrupt"})
                # a process that makes no records reads no messages, but handles signals after its first record
                with suppress(ProcessLookupError):
                    os.kill(running.pid, PAUSE)

    def _next(self, running: PlanCopy | None) -> PlanCopy:
        """Accept the child that continues from a copy."""
        if running is not None:  # this process is the child's parent, so its next message says that it waits
            message = _received(running.channel)
            if message is None:
                self._lost(running)
            running.step = message["step"]
            self.waiting.append(running)
        connected, _ = self._listener.accept()
        channel = Channel(connected.detach())
        hello = channel.receive()
        if hello is None:
            self._lost(None)
        parent = next((each for each in self.waiting if each.pid == hello["parent"]), None)
        return PlanCopy(channel, hello["pid"], parent, hello["step"])

    # --- ends of processes ------------------------------------------------------------------------------------------

    def _lost(self, copy: PlanCopy | None) -> NoReturn:
        self.now = None
        self.end(copy)
        raise PlanEnded(last_output(self._errors))

    def end(self, copy: PlanCopy | None) -> None:
        """End a process that has no children. The end of the first process ends all processes."""
        if copy is None or copy.parent is None:
            self.end_all()
            return
        copy.channel.close()
        copy.parent.channel.send({"do": "end", "pid": copy.pid})
        if _received(copy.parent.channel) is None and not self._ending:  # the parent has already ended
            self.end_all()

    def end_all(self) -> None:
        """End all processes, children before parents."""
        self._ending = True
        for each in reversed([*self.waiting, *([self.now] if self.now and self.now not in self.waiting else [])]):
            if each.parent is not None:
                self.end(each)
            else:
                each.channel.close()
        if self._root is not None:  # all other processes end with the first process
            self._root.kill()
            self._root.wait()
        self._root, self.now, self._ending = None, None, False
        self.waiting.clear()

    def thin_out(self, step: int) -> None:
        """If too many copies wait, end those that are farthest from a step."""
        while len(self.waiting) > _MAX_WAITING:
            parents = {each.parent for each in (*self.waiting, self.now) if each is not None}
            ends = [each for each in self.waiting if each not in parents and each is not self.now]
            if not ends:
                return
            farthest = max(ends, key=lambda each: abs(each.step - step))
            self.waiting.remove(farthest)
            self.end(farthest)


def _received(channel: Channel) -> Message | None:
    """Return the next message. Answers to late interrupts are skipped."""
    while True:
        message = channel.receive()
        if message is None or "interrupt" not in message:
            return message
