"""The processes of a debugged plan: the one that has stopped or runs, and copies of it that wait at steps before.

A copy that waits is the parent of the process that went on from it. So all are descendants of the first one, and end
with it, which ends with this process.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import tempfile
import threading
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NoReturn

from replay.debug.channel import PAUSE, Channel
from replay.errors import ReplayError

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterator

    from replay.debug.channel import Message
    from replay.retrace.plan_process import PlanProcess

_MAX_WAITING: Final = 64  # copies that wait
_SHOWN: Final = 2000  # characters of stderr of a process that has ended
_POLL: Final = 0.2  # s until Ctrl-C, or a process that ended without a word, is noticed


class PlanEnded(ReplayError):
    """The plan's process has ended by itself, before it came to a step: killed, or by a crash of native code.

    Attributes:
        printed: what it has last written to stderr.
    """

    def __init__(self, printed: str) -> None:
        super().__init__(f"the plan's process has ended{printed and f':{chr(10)}{printed}'}; goto runs it again")
        self.printed = printed


class EndedByInterrupt(Exception):
    """Ctrl-C, twice: the process that ran was ended."""


@dataclass(eq=False, slots=True)
class Copy:
    """A process of the plan that is at a step, or goes on from there.

    Attributes:
        channel: to it.
        pid: its number.
        parent: the copy that it was forked from; None for the first process.
        step: the last recorded step that it is known to have made.
        parted: whether it did something else after that than the recording has.
        can_wait: whether it could be copied there.
        between: whether it has stopped after that step's record, on its way to the next one.
    """

    channel: Channel
    pid: int
    parent: Copy | None
    step: int = -1
    parted: bool = False
    can_wait: bool = False
    between: bool = False


class Copies:
    """The processes of a plan.

    Args:
        process: starts the first one.
        spacing: nanoseconds of the recording between copies; None for no copies.

    Attributes:
        waiting: copies that wait, each after its parent.
        now: the process that has stopped, which may be one of these; None while another one comes.
        runs: how often the first process was started.
    """

    def __init__(self, process: PlanProcess, spacing: int | None) -> None:
        self.waiting: list[Copy] = []
        self.now: Copy | None = None
        self.runs = 0
        self._process = process
        self._spacing = spacing
        self._root: subprocess.Popen[bytes] | None = None
        self._ending = False
        self._interrupts = 0  # by Ctrl-C, since the plan was asked for something
        with ExitStack() as undoing:
            self._folder = undoing.enter_context(
                tempfile.TemporaryDirectory(prefix="pycram-debug-", ignore_cleanup_errors=True)
            )
            self._errors = undoing.enter_context(tempfile.TemporaryFile())
            self._listener = undoing.enter_context(socket.socket(socket.AF_UNIX))
            self._address = str(Path(self._folder) / "prompt")
            self._listener.bind(self._address)
            self._listener.listen()
            self._open = undoing.pop_all()

    def close(self) -> None:
        """End all of them."""
        self.end_all()
        self._open.close()

    # --- what they do -----------------------------------------------------------------------------------------------

    def start(self) -> Message:
        """Run the plan from its start to its first record; return what :meth:`go_on` does."""
        self.end_all()
        request = {
            "address": self._address,
            "parent": os.getpid(),
            "folder": self._folder,
            "until": 0,
            "spacing": self._spacing,
            "changes": list(self._process.recorded_changes()),
        }
        self.runs += 1
        request |= self._process.placed(str(Path(self._folder) / f"run-{self.runs}"))
        with self._noting_interrupts():
            self._root = self._process.start("replay.debug", request, self._errors)
            return self._stopped(None)

    def go_on(self, origin: Copy, course: Message) -> Message:
        """Have a copy go on, or its child if it stays; wait until that has stopped, and return what it tells.

        Raises:
            PlanEnded: it has ended before.
            EndedByInterrupt: by Ctrl-C, twice.
        """
        stay = origin in self.waiting or (origin.can_wait and origin.parent is None)
        if stay and origin not in self.waiting:
            self.waiting.append(origin)
        with self._noting_interrupts():
            self.now = None
            origin.channel.send({"do": "go", "stay": stay, **course})
            return self._stopped(None if stay else origin)

    def ask(self, question: Message) -> Message:
        """Ask the process that has stopped something, and return its answer.

        Raises:
            PlanEnded: it has ended.
            KeyboardInterrupt: somebody has pressed Ctrl-C; nothing has changed.
        """
        now, passed_on = self.now, False
        if now is None:
            raise PlanEnded(self._printed())
        with self._noting_interrupts():
            now.channel.send(question)
            while not (now.channel.has_read or select.select([now.channel], (), (), _POLL)[0]):
                if self._interrupts and not passed_on:
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
        """Note Ctrl-C while the block runs, where else it would be raised between a message and its answer."""
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

    def _stopped(self, running: Copy | None) -> Message:
        """Wait until the process that runs, or the one that comes next, has stopped."""
        passed_on = False  # Ctrl-C, to the process that runs
        while True:
            sources: list[socket.socket | Channel] = [self._listener, *([running.channel] if running else [])]
            read = running is not None and running.channel.has_read
            ready = sources[1:] if read else select.select(sources, (), (), _POLL)[0]
            if self._listener in ready:
                running = self._next(running)
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
            elif self._root is not None and self._root.poll() is not None:
                self._lost(running)
            if self._interrupts > 1:
                self.end(running)
                raise EndedByInterrupt
            if self._interrupts and running is not None and not passed_on:
                passed_on = True
                running.channel.send({"do": "interrupt"})
                with suppress(ProcessLookupError):  # where it makes no record, it hears only this
                    os.kill(running.pid, PAUSE)

    def _next(self, running: Copy | None) -> Copy:
        """Take the process that a copy has forked, which goes on."""
        if running is not None:  # it tells that it waits, or has told it
            message = _received(running.channel)
            if message is None:
                self._lost(running)
            running.step = message["step"]
            self.waiting.append(running)
        connected, _ = self._listener.accept()
        channel = Channel(connected)
        hello = channel.receive()
        if hello is None:
            self._lost(None)
        parent = next((each for each in self.waiting if each.pid == hello["parent"]), None)
        return Copy(channel, hello["pid"], parent, hello["step"])

    # --- their ends -------------------------------------------------------------------------------------------------

    def _lost(self, copy: Copy | None) -> NoReturn:
        """Raise that a process has ended by itself."""
        self.now = None
        self.end(copy)
        raise PlanEnded(self._printed())

    def _printed(self) -> str:
        self._errors.seek(0)
        return self._errors.read().decode("utf-8", "replace").strip()[-_SHOWN:]

    def end(self, copy: Copy | None) -> None:
        """End a process that has no children; all, if it is the first one."""
        if copy is None or copy.parent is None:
            self.end_all()
            return
        copy.channel.close()
        copy.parent.channel.send({"do": "end", "pid": copy.pid})
        if _received(copy.parent.channel) is None and not self._ending:  # somebody else has ended the parent
            self.end_all()

    def end_all(self) -> None:
        """End all processes, each before its parent, which waits for its end: none becomes a zombie."""
        self._ending = True
        for each in reversed([*self.waiting, *([self.now] if self.now and self.now not in self.waiting else [])]):
            if each.parent is not None:
                self.end(each)
            else:
                each.channel.close()
        if self._root is not None:  # it ends what is left, too
            self._root.kill()
            self._root.wait()
        self._root, self.now, self._ending = None, None, False
        self.waiting.clear()

    def thin_out(self, step: int) -> None:
        """End those copies that wait farthest from a step, if there are too many."""
        while len(self.waiting) > _MAX_WAITING:
            parents = {each.parent for each in (*self.waiting, self.now) if each is not None}
            ends = [each for each in self.waiting if each not in parents and each is not self.now]
            if not ends:
                return
            farthest = max(ends, key=lambda each: abs(each.step - step))
            self.waiting.remove(farthest)
            self.end(farthest)


def _received(channel: Channel) -> Message | None:
    """Return the next message but for answers to interrupts that came too late."""
    while True:
        message = channel.receive()
        if message is None or "interrupt" not in message:
            return message
