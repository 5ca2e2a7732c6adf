"""A recorded plan that runs again, stopped at a step; copies of it that wait at steps before; from step to step.

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
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

from recorder.records import Run
from replay.debug.channel import Channel
from replay.errors import Damaged, ReplayError
from replay.retrace.plan_process import PlanProcess

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Collection, Iterator, Sequence
    from typing import Self

    from replay.debug.channel import Message
    from replay.debug.stops import Watched
    from replay.file.record_reader import RecordReader

_PARTS: Final = 40  # of a run, with a checkpoint at the beginning of each
_SHORTEST: Final = 0.05  # s of a part
_MOST: Final = 64  # copies that wait
_FINEST: Final = 4  # steps from a checkpoint to where one goes back to
_SHOWN: Final = 2000  # characters of stderr of a process that has ended
_POLL: Final = 0.2  # s until a process that ended without a word is noticed


class PlanEnded(ReplayError):
    """The plan's process has ended by itself, before it came to a step: killed, or by a crash of native code.

    Attributes:
        step: the last step that it is known to have come to.
    """

    def __init__(self, step: int, printed: str) -> None:
        super().__init__(f"the plan's process has ended after step {step}{printed and f':{chr(10)}{printed}'}")
        self.step = step


class Interrupted(ReplayError):
    """Somebody has pressed Ctrl-C until the plan's process was ended; the plan is where it was before."""

    def __init__(self, step: int) -> None:
        super().__init__(f"the plan came to no other step; it is at step {step} again")


@dataclass(eq=False, slots=True)
class _Copy:
    """A process of the plan that is at a step, or goes on from there."""

    channel: Channel
    pid: int
    parent: _Copy | None
    step: int = -1
    parted: bool = False
    can_wait: bool = False


@dataclass(frozen=True, slots=True)
class Arrival:
    """Where a plan has stopped.

    Attributes:
        step: the last recorded step that it has made.
        reason: "step": it was to come there; "watch": what was watched has changed; "interrupted": by Ctrl-C; "parted":
            what comes next is another record than the recorded one.
        text: how it differs.
        changes: steps, numbers of what was watched, values before and after.
    """

    step: int
    reason: str = "step"
    text: str = ""
    changes: list[tuple[int, int, str, str]] = field(default_factory=list)


class GuidedPlan:
    """A recorded plan, at a step.

    Args:
        log: the recording.
        plan: another file than the recorded one.
        arguments: other arguments than the recorded ones.
        checkpoints: whether copies of it wait at some steps; else going back is to run it again from its start.

    Attributes:
        step: the last recorded step that it has made; -1 before the first.
        notes: what is different from when it was recorded.
        runs: how often it was run from its start.
        last: the last step that it can come to.
        parted: how it differs from the recording after that step; "" if it isn't known to.

    Raises:
        CantRetrace: the plan isn't there, or the recording doesn't tell how it was run.
    """

    def __init__(
        self,
        log: RecordReader,
        plan: str | Path | None = None,
        arguments: Sequence[str] | None = None,
        *,
        checkpoints: bool = True,
    ) -> None:
        self._log = log
        self._process = PlanProcess(log, plan, arguments)
        self.notes = tuple(self._process.notes())
        self.step = -1
        self.runs = 0
        self.last = len(log) - 1
        self.parted = ""
        gap = next(iter(log.lost()), None)
        if gap is not None:
            self.last, self.parted = gap.start - 1, f"step {gap.start} is lost"
        if self.last < 0:
            raise Damaged(log.path, "its beginning", "nothing of it is left to guide the plan")
        self._spacing = self._part() if checkpoints and hasattr(os, "fork") else None
        self._waiting: list[_Copy] = []
        self._now: _Copy | None = None
        self._ending = False
        self._interrupts = 0  # by Ctrl-C, since the plan was asked for something
        self._open = ExitStack()
        self._root: subprocess.Popen[bytes] | None = None
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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all processes."""
        self._end_all()
        self._open.close()

    @property
    def checkpoints(self) -> list[int]:
        """The steps at which copies wait."""
        return sorted(each.step for each in self._waiting)

    def _part(self) -> float:
        """Return the seconds between checkpoints."""
        end = self._log[-1]
        took = end.duration_ns if isinstance(end, Run) else end.monotonic_ns
        return max(took / 1e9 / _PARTS, _SHORTEST)

    # --- from step to step ------------------------------------------------------------------------------------------

    def go(self, step: int, watched: Sequence[Watched] = (), *, through: bool = False) -> Arrival:
        """Bring the plan to a step, forwards or back.

        Args:
            step: the step.
            watched: expressions; the plan goes on from where it is, and stops where one of their values changes.
            through: whether it doesn't: the changes are only noted, up to the step.

        Raises:
            PlanEnded: its process has ended before; it is at no step then.
            Interrupted: by Ctrl-C, twice, as it came to no step; it is where it was before.
        """
        now = self._now
        if now is None and watched:
            self.go(self.step)
            now = self._now
        if now is not None and not now.parted and now.step == step and not watched:
            return Arrival(step)
        copies = [now] if watched and now is not None else self._usable()
        origin = max((each for each in copies if each.step <= step), key=lambda each: each.step, default=None)
        if now is not None and now is not origin and now not in self._waiting:
            self._end(now)
        if origin is not None and origin.step == step and not watched:
            self._now, self.step = origin, step
            return Arrival(step)
        self._now = None
        halves = list(_halving(origin.step, step)) if origin is not None and step < self.step else []
        before = self.step
        try:
            with self._noting_interrupts():
                arrival = self._start() if origin is None else None
                origin = origin or self._now
                if origin is not None and (arrival is None or arrival.step < step or watched):
                    arrival = self._sent(origin, step, halves, watched, through=through)
        except _EndedByInterrupt:
            if before >= 0:
                self.go(before)
            raise Interrupted(before) from None
        self._drop_superfluous()
        return arrival or Arrival(step)

    def ask(self, what: str, **arguments: object) -> Any:
        """Ask the stopped plan something; see :meth:`replay.debug.stops.StoppingSink._answer`.

        Raises:
            PlanEnded: its process has ended.
            ReplayError: it can't be answered there.
            KeyboardInterrupt: somebody has pressed Ctrl-C; nothing has changed.
        """
        if self._now is None:
            raise PlanEnded(self.step, self._printed())
        now, told = self._now, False
        with self._noting_interrupts():
            now.channel.send({"do": what, **arguments})
            while not (now.channel.has_read or select.select([now.channel], (), (), _POLL)[0]):
                if self._interrupts and not told:
                    told = True
                    now.channel.send({"do": "interrupt"})
            answer = _received(now.channel)
        if answer is None:
            self._lost(now)
        if told or "interrupted" in answer:
            raise KeyboardInterrupt
        if "error" in answer:
            raise ReplayError(answer["error"])
        return answer["answer"]

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

    def _usable(self) -> list[_Copy]:
        """Return the processes that can go on from their steps as recorded."""
        now = self._now
        return [*self._waiting, *([now] if now is not None and not now.parted and now not in self._waiting else [])]

    def _start(self) -> Arrival:
        """Run the plan from its start to its first record."""
        self._end_all()
        request = {
            "address": self._address,
            "parent": os.getpid(),
            "folder": self._folder,
            "until": 0,
            "spacing": self._spacing,
        }
        self.runs += 1
        self._root = self._process.start("replay.debug.process", request, self._errors)
        return self._arrived(None)

    def _sent(
        self, origin: _Copy, step: int, halves: Collection[int], watched: Sequence[Watched], *, through: bool
    ) -> Arrival:
        """Have a copy, or its child, go on to a step."""
        stay = origin in self._waiting or (origin.can_wait and origin.parent is None)
        if stay and origin not in self._waiting:
            self._waiting.append(origin)
        expressions = [[each.expression, each.file, each.first] for each in watched]
        origin.channel.send(
            {
                "do": "go",
                "stay": stay,
                "until": step,
                "checkpoints": list(halves),
                "watched": expressions,
                "through": through,
            }
        )
        return self._arrived(None if stay else origin)

    def _arrived(self, running: _Copy | None) -> Arrival:
        """Wait until the process that runs, or the one that comes next, has stopped."""
        told = False
        while True:
            sources: list[socket.socket | Channel] = [
                self._listener,
                *([running.channel] if running is not None else []),
            ]
            read = running is not None and running.channel.has_read
            ready = sources[1:] if read else select.select(sources, (), (), _POLL)[0]
            if self._listener in ready:
                running = self._next(running)
            elif ready and running is not None:
                message = _received(running.channel)
                if message is None:
                    self._lost(running)
                elif "parked" in message:
                    self._parked(running, message)
                    running = None
                else:
                    return self._stopped(running, message)
            elif not ready and self._root is not None and self._root.poll() is not None:
                self._lost(running)
            if self._interrupts > 1:
                self._end(running)
                raise _EndedByInterrupt
            if self._interrupts and running is not None and not told:
                told = True
                running.channel.send({"do": "interrupt"})

    def _next(self, running: _Copy | None) -> _Copy:
        """Take the process that a copy has forked, which goes on."""
        if running is not None:  # it has told that it waits, or is about to
            message = _received(running.channel)
            if message is None:
                self._lost(running)
            else:
                self._parked(running, message)
        connected, _ = self._listener.accept()
        channel = Channel(connected)
        hello = channel.receive() or {"hello": 0, "parent": 0, "step": -1}
        parent = next((each for each in self._waiting if each.pid == hello["parent"]), None)
        return _Copy(channel, hello["hello"], parent, hello["step"])

    def _parked(self, running: _Copy, message: Message) -> None:
        running.step = message["parked"]
        self._waiting.append(running)

    def _stopped(self, running: _Copy, message: Message) -> Arrival:
        self._now = running
        self.step = running.step = message["stopped"]
        running.parted = message["reason"] == "parted"
        running.can_wait = message["can_wait"]
        found = message["difference"]
        if found is not None:
            self.last, self.parted = found["step"] - 1, found["text"]
        return Arrival(self.step, message["reason"], self.parted if found else "", message["changes"])

    # --- ends -------------------------------------------------------------------------------------------------------

    def _lost(self, copy: _Copy | None) -> NoReturn:
        """Raise that a process has ended by itself."""
        self._now = None
        step = self.step if copy is None else max(copy.step, self.step)
        self._end(copy)
        raise PlanEnded(step, self._printed())

    def _printed(self) -> str:
        self._errors.seek(0)
        return self._errors.read().decode("utf-8", "replace").strip()[-_SHOWN:]

    def _end(self, copy: _Copy | None) -> None:
        """End a process, which has no children."""
        if copy is None or copy.parent is None:
            self._end_all()
            return
        copy.channel.close()
        copy.parent.channel.send({"do": "end", "pid": copy.pid})
        if _received(copy.parent.channel) is None and not self._ending:  # somebody else has ended the parent
            self._end_all()

    def _end_all(self) -> None:
        """End all processes, each before its parent, which waits for its end: none becomes a zombie."""
        self._ending = True
        ended = [*self._waiting, *([self._now] if self._now is not None and self._now not in self._waiting else [])]
        for each in reversed(ended):  # children come after their parents
            if each.parent is not None:
                self._end(each)
            else:
                each.channel.close()
        if self._root is not None:  # it ends what is left, too
            self._root.kill()
            self._root.wait()
        self._root, self._now, self._ending = None, None, False
        self._waiting.clear()

    def _drop_superfluous(self) -> None:
        """End those copies that wait farthest from where the plan is, if there are too many."""
        while len(self._waiting) > _MOST:
            parents = {each.parent for each in (*self._waiting, self._now) if each is not None}
            ends = [each for each in self._waiting if each not in parents and each is not self._now]
            if not ends:
                return
            farthest = max(ends, key=lambda each: abs(each.step - self.step))
            self._waiting.remove(farthest)
            self._end(farthest)


class _EndedByInterrupt(Exception):
    """Ctrl-C, twice: the process that ran was ended."""


def _received(channel: Channel) -> Message | None:
    """Return the next message but for answers to interrupts that came too late."""
    while True:
        message = channel.receive()
        if message is None or "interrupt" not in message:
            return message


def _halving(start: int, step: int) -> Iterator[int]:
    """Yield steps from one to another, each half as far from it as the one before."""
    while step - start >= _FINEST:
        start += (step - start) // 2
        yield start
