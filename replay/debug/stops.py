"""The sink of a plan that is debugged: it compares each record with the recorded one, and stops the plan at a step.

While the plan is stopped, its process answers messages. It goes on by itself, or stays and a forked child goes on, as
it does at checkpoints on the way: so there is a process that can go on from here again.
"""

from __future__ import annotations

import json
import os
import random
import select
import signal
import socket
import sys
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from pycram.projection import obstacle
from pycram.projection.child import Child, die_with, has_children
from pycram.scheduling.locks import is_held
from recorder.records import Task
from recorder.tracing import forking, interrupts, journal
from recorder.tracing.journal import NullSink
from replay.debug import frames
from replay.debug.channel import PAUSE, Channel
from replay.retrace.answers import Answers
from replay.retrace.guide import Guide
from replay.retrace.process import make_change, rename
from replay.retrace.steering import Steering

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path
    from types import FrameType
    from typing import NoReturn

    from recorder.records import Change, Record
    from replay.debug.channel import Message
    from replay.debug.standing_clock import StandingClock
    from replay.file.record_reader import RecordReader
    from replay.retrace.guide import Difference


def _refuse(error: Exception) -> NoReturn:
    sys.stderr.write(f"a change of the fork can't be made again: {error}\n")
    sys.stderr.flush()
    os._exit(1)


def _can_be_copied() -> bool:
    """Whether a copy would do what this process does: threads, and processes that are waited for, it would lack."""
    return not obstacle() and not has_children()


@dataclass(frozen=True, slots=True)
class Watched:
    """An expression that is watched where a function of the plan runs.

    Attributes:
        expression: the expression.
        file: of the function.
        first: its first line.
    """

    expression: str
    file: str
    first: int

    def value(self, stack: list[frames.PlanFrame]) -> str | None:
        """Return its value as text; None where no call of the function runs, or it has none there."""
        for each in stack:
            code = each.frame.f_code
            if (code.co_filename, code.co_firstlineno) == (self.file, self.first):
                try:
                    return repr(frames.value_of(each.frame, self.expression))
                except Exception:  # noqa: BLE001  a variable that isn't there yet, say
                    return None
        return None


@dataclass(slots=True)
class Course:
    """How far a plan goes on.

    Attributes:
        until: the step at which it stops.
        checkpoints: steps at which a copy stays.
        watched: what ends it when its value changes.
        through: whether changes are only noted.
        changes: steps, numbers of what was watched, values before and after.
    """

    until: int
    checkpoints: frozenset[int] = frozenset()
    watched: tuple[Watched, ...] = ()
    through: bool = False
    changes: list[tuple[int, int, str, str]] = field(default_factory=list)

    @classmethod
    def of(cls, message: Message, moved: tuple[str, str] | None) -> Course:
        """Return the course that a message asks for; files are named by where the plan was, and have moved."""
        new, old = moved or ("", "")
        watched = tuple(
            Watched(expression, file.replace(old, new), first) for expression, file, first in message["watched"]
        )
        return cls(message["until"], frozenset(message["checkpoints"]), watched, message["through"])


class StoppingSink(NullSink):
    """Guides a plan by its recording, and stops it.

    Args:
        recorded: the recording.
        address: the prompt's socket.
        path: what would be the recording's file, beside which projections are recorded.
        clock: stands still while the plan is stopped.
        course: how far it goes at first.
        spacing: nanoseconds of the recording between checkpoints; None for no checkpoints.
        changes: what was changed after its steps, where the recorded run is a fork.
        moved: the folder that the plan's recorded source was written to, and the one that it came from.

    Attributes:
        path: as given.
        answers: those that the fork was given.
        foreseen: gives the strikes of the recorded run.
    """

    def __init__(
        self,
        recorded: RecordReader,
        address: str,
        path: Path,
        clock: StandingClock,
        course: Course,
        spacing: int | None,
        changes: Sequence[Change] = (),
        moved: tuple[str, str] | None = None,
    ) -> None:
        self.path = path
        self._recorded = recorded
        self._address = address
        self._clock = clock
        self._course = course
        self._spacing = spacing
        self._moved = moved
        self._guide = Guide(recorded, self._report, None, path)
        self.foreseen = self._guide.foreseen
        self.answers = Answers(self._guide, taken=False, refuse=_refuse)
        self._steering = Steering(changes, self.answers, make_change, _refuse)
        self._difference: Difference | None = None
        self._over = False
        self._last_checkpoint = -float("inf")
        self._parents: dict[int, int] = {}
        self._values: list[str | None] = []
        self._failing = False
        self._step = -1
        self._frame: FrameType | None = None  # that the record comes from, while the plan is stopped
        self._serving = False
        signal.signal(PAUSE, self._pause)
        self._channel = self._connected(parent=0)

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Compare a record, and stop if it is where to."""
        if self._over:
            return
        self._steering.complete(record)
        if self._moved is not None:
            rename(record, *self._moved)
        self._guide.write(topic, record, payload)
        if isinstance(record, Task) and record.phase in (Task.STARTED, Task.ASKED):
            self._parents[record.task] = record.parent
        self._failing = "failure" in record.DESCRIPTOR.fields_by_name and record.HasField("failure")
        if self._difference is not None:
            self._end()
        elif not self._over:
            self._step = record.seq
            self._frame = sys._getframe(1)  # noqa: SLF001  inspect.currentframe() gives no other
            self._pass()
            self._frame = None
            self._steering.passed(record.seq, lambda: None)

    def close(self) -> None:
        """Stop for good: the plan has ended where its recording goes on."""
        if not self._over:
            self._guide.close()
            self._end()

    def _report(self, equal: int, difference: Difference | None) -> None:
        self._difference = difference
        if difference is None and equal <= self._step + 1:
            self._over = True  # what comes now isn't in the recording, which was cut

    def _end(self) -> None:
        self._over = True
        self._frame = sys._getframe(2)  # noqa: SLF001  as above
        self._stop("parted")

    # --- on its way -------------------------------------------------------------------------------------------------

    def _pass(self) -> None:
        """Go on from a record, or stop and go on later."""
        stopping = self._step >= self._course.until
        changed = self._noted_changes() if self._course.watched else False
        if stopping or (changed and not self._course.through) or self._channel.pending:
            self._stop("step" if stopping else "watch" if changed else "interrupted")
        elif self._due():
            self._check_point()

    def _pause(self, _: int, frame: FrameType | None) -> None:
        """Stop between two records, where the plan makes none: it may hang. In the midst of one, that is to come."""
        if self._step >= 0 and not (self._over or self._serving or interrupts.is_uninterrupted() or is_held()):
            self._frame = frame
            self._stop("interrupted", between=True)
            self._frame = None

    def _noted_changes(self) -> bool:
        values = self._watched_values()
        changes = [
            (self._step, number, before, value)
            for number, (before, value) in enumerate(zip(self._values, values, strict=True))
            if before is not None and value is not None and before != value
        ]
        self._values = [
            value if value is not None else before for before, value in zip(self._values, values, strict=True)
        ]
        self._course.changes += changes
        return bool(changes)

    def _watched_values(self) -> list[str | None]:
        """Return the values of what is watched; the plan's random numbers stay as they are, and nothing is recorded."""
        stack = self._stack()
        dice = random.getstate()
        with journal.unrecorded():
            values = [each.value(stack) for each in self._course.watched]
        random.setstate(dice)
        return values

    def _due(self) -> bool:
        if self._spacing is None:
            return False
        return (
            self._step in self._course.checkpoints or self._guide.recorded_ns - self._last_checkpoint >= self._spacing
        )

    def _check_point(self) -> None:
        self._last_checkpoint = self._guide.recorded_ns
        if not _can_be_copied():
            return
        if not self._went_on_in_child():
            self._channel.send({"step": self._step, "reason": "waits"})
            self._serve()

    def _went_on_in_child(self) -> bool:
        """Fork; True in the child, which goes on."""
        parent = os.getpid()
        if forking.fork_continuation():
            return False
        die_with(parent)
        self._channel.close()
        self._recorded.after_fork()
        self._channel = self._connected(parent)
        return True

    def _connected(self, parent: int) -> Channel:
        connected = socket.socket(socket.AF_UNIX)
        connected.connect(self._address)
        channel = Channel(connected)
        channel.send({"pid": os.getpid(), "parent": parent, "step": self._step})
        return channel

    # --- stopped ----------------------------------------------------------------------------------------------------

    def _stop(self, reason: str, *, between: bool = False) -> None:
        found = None if self._difference is None else asdict(self._difference)
        can_wait = reason != "parted" and not between and self._spacing is not None and _can_be_copied()
        self._channel.send(
            {
                "step": self._step,
                "reason": reason,
                "difference": found,
                "changes": self._course.changes,
                "can_wait": can_wait,
                "between": between,
            }
        )
        self._serve()

    def _serve(self) -> None:
        """Answer messages; return where the plan goes on."""
        self._serving = True
        with self._clock.standing():
            while True:
                message = self._channel.receive()
                if message is None:
                    os._exit(0)
                if message["do"] == "go":
                    if not message["stay"] or self._went_on_in_child():
                        break
                else:
                    self._channel.send(self._answer(message))
        self._serving = False
        self._course = Course.of(message, self._moved)
        self._values = self._watched_values()

    def _answer(self, message: Message) -> Message:
        match message:
            case {"do": "end", "pid": pid}:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                return {"answer": pid}
            case {"do": "interrupt"}:  # of what was done already
                return {"interrupt": "late"}
            case {"do": "where"}:
                return {"answer": [each.facts(self._moved) for each in self._stack()]}
        frame = self._stack()[message["frame"]].frame
        doing: dict[str, Callable[[], Any]] = {
            "variables": lambda: frames.variables(frame, arguments=message["arguments"]),
            "evaluate": lambda: frames.evaluate(frame, message["expression"], pretty=message["pretty"]),
            "complete": lambda: frames.completions(frame, message["text"]),
        }
        return self._in_copy(doing[message["do"]])

    def _in_copy(self, work: Callable[[], Any]) -> Message:
        """Do something in a copy of this process, as it may call any code: the plan itself doesn't notice."""
        if not hasattr(os, "fork"):
            return {"answer": work()}
        child = Child(lambda: json.dumps({"answer": work()}).encode())
        while not child.ended:
            sources: list[Child | Channel] = [child, self._channel]
            if self._channel in select.select(sources, (), ())[0]:
                child.kill()
                return {"interrupted": True}
            child.read()
        if not child.received:
            return {"error": f"that can't be looked at: the copy of the plan in which it was done {child.how}"}
        answer: Message = json.loads(child.received)
        return answer

    def _stack(self) -> list[frames.PlanFrame]:
        return frames.stack(self._frame, self._parents, failing=self._failing)
