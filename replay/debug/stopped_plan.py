"""The process of a debugged plan: it compares each record with the recorded record, and stops the plan at a step.

While the plan is stopped, its process answers messages from the prompt, which are JSON on a socket. When the plan
continues, its process continues, or a forked child continues and the process waits as a copy.
"""

from __future__ import annotations

import gc
import inspect
import json
import os
import pprint
import random
import rlcompleter
import select
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from io import StringIO
from itertools import islice
from multiprocessing.connection import Connection
from pathlib import Path
from types import BuiltinFunctionType, FrameType, FunctionType, ModuleType
from typing import Any, Final, NamedTuple, NoReturn, TypeAlias

from pycram.projection.child import Child, die_with, has_children, obstacle
from pycram.scheduling.future import is_future
from pycram.scheduling.schedule import is_held, scheduler
from recorder.records import Record, Task, format_error
from recorder.records.tracebacks import result_or
from recorder.tracing import forking, interrupts, journal
from recorder.tracing.call_stack import is_plan, plan_frames
from recorder.tracing.journal import NullSink
from replay.retrace.guided_run import GuidedRun
from replay.retrace.plan_process import FirstDifference, Guidance

Message: TypeAlias = "dict[str, Any]"

PAUSE: Final = getattr(signal, "SIGURG", signal.SIGINT)  # systems that can fork have SIGURG
"""This signal stops a plan that makes no records, and so reads no messages. Without a handler, it is ignored."""
_IGNORED: Final = (ModuleType, FunctionType, BuiltinFunctionType, type)  # types of a module's imports and definitions
_MAX_NAMES: Final = 200  # maximum number of completions of a text
_CLOCKS: Final = ("time", "monotonic", "perf_counter")
_NS: Final = 10**9

# --- messages ---------------------------------------------------------------------------------------------------------


class Channel(Connection):
    """One end of a connection."""

    def send(self, message: Message) -> None:
        """Send a message, if the other end isn't closed."""
        with suppress(OSError):  # after that, receive() returns None
            self.send_bytes(json.dumps(message).encode())

    def receive(self) -> Message | None:
        """Wait for a message and return it, or None if the other end is closed."""
        try:
            message: Message = json.loads(self.recv_bytes())
        except (EOFError, OSError):
            return None
        return message


# --- the plan's frames ------------------------------------------------------------------------------------------------


class PlanFrame(NamedTuple):
    """A frame of the plan and its current line."""

    frame: FrameType
    line: int

    def facts(self, moved: tuple[str, str] | None) -> dict[str, object]:
        """Return the file, the line, the function, and the first line of the function.

        Files of a ``moved`` plan (:class:`replay.retrace.plan_process.Guidance`) are in the plan's own folder.
        """
        code = self.frame.f_code
        return {
            "file": code.co_filename.replace(*moved or ("", "")),
            "line": self.line,
            "function": code.co_name,
            "first": code.co_firstlineno,
        }


def stack(frame: FrameType | None, parents: Mapping[int, int], *, failing: bool) -> list[PlanFrame]:
    """Return the plan's frames, innermost first. Frames that wait for a branch come after the frames of the branch.

    ``parents`` contains the id of each task's parent. With ``failing``, the frames through which an error has passed
    come first.
    """
    own = [PlanFrame(each, each.f_lineno) for each in plan_frames(frame)]
    error = sys.exception() if failing else None
    if error is not None and error.__traceback__ is not None:
        left = [PlanFrame(each, line) for each, line in traceback.walk_tb(error.__traceback__) if is_plan(each)]
        lines = dict(left)
        running = {each for each, _ in own}
        own = [PlanFrame(each, lines.get(each, line)) for each, line in own]
        own = [*(each for each in reversed(left) if each.frame not in running), *own]
    waiting = {}
    for suspended, context in scheduler().suspended():
        task = context.get(journal.current_task)
        waiting[task.id if task is not None else 0] = suspended
    number: int | None = journal.task_id()
    while number is not None:  # 0 stands for code outside of tasks
        number = parents.get(number)
        if number in waiting:
            own += [PlanFrame(each, each.f_lineno) for each in plan_frames(waiting[number])]
    return own


def variables(frame: FrameType, *, arguments: bool = False) -> list[dict[str, str | int]]:
    """Return the variables of a frame, except definitions of a module; or only the ``arguments``."""
    values = dict(frame.f_locals)
    if arguments:
        info = inspect.getargvalues(frame)
        names = [*info.args, *filter(None, (info.varargs, info.keywords))]
        values = {name: values[name] for name in names if name in values}
    elif frame.f_locals is frame.f_globals:
        values = {name: each for name, each in values.items() if not issubclass(type(each), _IGNORED)}
    return [_described(name, name, value) for name, value in values.items() if not (name[:2] == "__" == name[-2:])]


def parts(frame: FrameType, expression: str) -> list[dict[str, str | int]]:
    """Return the entries of a sequence or mapping, or the attributes of another value."""
    value = value_of(frame, expression)
    if is_future(value):
        return []
    if isinstance(value, dict):
        found = [(_repr(key), f"({expression})[{_repr(key)}]", each) for key, each in value.items()]
    elif isinstance(value, list | tuple):
        found = [(f"[{place}]", f"({expression})[{place}]", each) for place, each in enumerate(value)]
    else:
        found = [(name, f"({expression}).{name}", each) for name, each in _attributes(value).items()]
    return [_described(*each) for each in found[:_MAX_NAMES]]


def _described(name: str, expression: str, value: object) -> dict[str, str | int]:
    count = 0
    if not is_future(value):  # isinstance() would wait for a future's result
        count = len(value) if isinstance(value, dict | list | tuple) else len(_attributes(value))
    kind = type(value).__name__
    return {"name": name, "value": _repr(value), "type": kind, "expression": expression, "parts": count}


def _attributes(value: object) -> dict[str, object]:
    if isinstance(value, _IGNORED):
        return {}
    return {name: each for name, each in getattr(value, "__dict__", {}).items() if not name.startswith("_")}


def evaluate(frame: FrameType, expression: str, *, pretty: bool = False) -> dict[str, str]:
    """Return the value of an expression in a frame, or its error, and its printed output."""
    printed = StringIO()
    answer: dict[str, str] = {}
    with redirect_stdout(printed), redirect_stderr(printed):
        try:
            value = value_of(frame, expression)
            answer["value"] = pprint.pformat(value) if pretty else repr(value)
        except BaseException as error:  # noqa: BLE001  an expression of the user may raise any error
            answer["error"] = format_error(error)
    return {**answer, "printed": printed.getvalue()}


def value_of(frame: FrameType, expression: str) -> object:
    """Return an expression's value in a frame."""
    return eval(expression, {**frame.f_globals, **frame.f_locals})  # noqa: S307  the user's expression


def completions(frame: FrameType, text: str) -> list[str]:
    """Return completions of a text in a frame."""
    completer = rlcompleter.Completer({**frame.f_globals, **frame.f_locals})
    found = (completer.complete(text, number) for number in range(_MAX_NAMES))
    return [each for each in islice(found, _MAX_NAMES) if each is not None]


def _repr(value: object) -> str:
    return result_or(partial(repr, value), lambda error: f"<{type(value).__name__}: {format_error(error)}>")


# --- stopping ---------------------------------------------------------------------------------------------------------


class PausableClock:
    """Replaces Python's clocks. The clocks stop with the plan, so that no deadline passes while the prompt waits."""

    def __init__(self) -> None:
        self._now_ns = time.monotonic_ns
        self._paused_ns = 0

    def install(self) -> None:
        """Replace the functions of the module ``time``."""
        for name in _CLOCKS:
            setattr(time, f"{name}_ns", self._without(getattr(time, f"{name}_ns")))
            setattr(time, name, self._in_seconds(getattr(time, name)))

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Stop the clocks in the ``with`` block, even if a forked child leaves the block."""
        since = self._now_ns()
        try:
            yield
        finally:
            self._paused_ns += self._now_ns() - since

    def _without(self, clock: Callable[[], int]) -> Callable[[], int]:
        return lambda: clock() - self._paused_ns

    def _in_seconds(self, clock: Callable[[], float]) -> Callable[[], float]:
        return lambda: clock() - self._paused_ns / _NS


def _refuse(error: Exception) -> NoReturn:
    sys.stderr.write(f"a change of the fork can't be repeated: {error}\n")
    sys.stderr.flush()
    os._exit(1)


def _can_be_copied() -> bool:
    """Return whether a copy would behave like this process. Copies have neither threads nor child processes."""
    return not obstacle() and not has_children()


@dataclass(frozen=True, slots=True)
class WatchedExpression:
    """An expression that is watched while a function of the plan runs."""

    expression: str
    file: str  # file that contains the function
    first: int  # number of the first line of the function

    def value(self, frames: list[PlanFrame]) -> str | None:
        """Return the value as text; None outside of the function, or if there is no value."""
        function = (self.file, self.first)
        codes = ((each.frame, each.frame.f_code) for each in frames)
        frame = next((one for one, code in codes if (code.co_filename, code.co_firstlineno) == function), None)
        return None if frame is None else result_or(lambda: repr(value_of(frame, self.expression)), lambda _: None)


@dataclass(slots=True)
class StopConditions:
    """The conditions that stop a plan when it continues."""

    until: int  # step at which the plan stops
    checkpoints: frozenset[int] = frozenset()  # steps at which a copy is left
    watched: tuple[WatchedExpression, ...] = ()  # watched expressions; a change of any value stops the plan
    through: bool = False  # whether changes are collected without stopping the plan
    #: For each change: step, index in ``watched``, value before, value after.
    changes: list[tuple[int, int, str, str]] = field(default_factory=list)

    @classmethod
    def of(cls, message: Message, moved: tuple[str, str] | None) -> StopConditions:
        """Return the conditions that a message contains. Files in the message are relative to the plan's own folder."""
        new, old = moved or ("", "")
        watched = tuple(
            WatchedExpression(expression, file.replace(old, new), first)
            for expression, file, first in message["watched"]
        )
        return cls(message["until"], frozenset(message["checkpoints"]), watched, message["through"])


class StoppingSink(NullSink):
    """A sink that stops a guided run, after :attr:`guided` has compared the record.

    The prompt listens at the socket ``address``. While the plan is stopped, the clock stands still. The plan stops for
    the first time at the step ``until``. ``spacing`` is the recorded time between two copies in ns; None for no copies.
    """

    def __init__(
        self, guidance: Guidance, folder: Path, address: str, clock: PausableClock, until: int, spacing: int | None
    ) -> None:
        self.guided = GuidedRun(guidance, folder, self._report, _refuse)
        self._address = address
        self._clock = clock
        self._conditions = StopConditions(until)
        self._spacing = spacing
        self._moved = guidance.moved
        self._difference: FirstDifference | None = None
        self._over = False
        self._last_checkpoint = -float("inf")
        self._parents: dict[int, int] = {}
        self._values: list[str | None] = []
        self._failing = False
        self._step = -1
        self._frame: FrameType | None = None  # while the plan is stopped, the frame that made the record
        self._serving = False
        signal.signal(PAUSE, self._pause)
        self._channel = self._connected(parent=0)

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  as sinks are called
        """Stop at the record's step, if a condition holds."""
        if self._over:
            return
        if isinstance(record, Task) and record.phase in (Task.STARTED, Task.ASKED):
            self._parents[record.task] = record.parent
        self._failing = "failure" in record.DESCRIPTOR.fields_by_name and record.HasField("failure")
        if self._difference is not None:
            self._end()
        elif not self._over:
            self._step = record.seq
            self._frame = sys._getframe(1)  # noqa: SLF001  the caller's frame
            self._pass()
            self._frame = None

    def close(self) -> None:
        """Stop once more if the plan ended before its recording."""
        if not self._over:
            self.guided.guide.close()
            self._end()

    def _report(self, equal: int, difference: FirstDifference | None) -> None:
        self._difference = difference
        if difference is None and equal <= self._step + 1:
            self._over = True  # the recording was cut off

    def _end(self) -> None:
        self._over = True
        self._frame = sys._getframe(2)  # noqa: SLF001  as above
        self._stop("parted")

    # --- while the plan runs ----------------------------------------------------------------------------------------

    def _pass(self) -> None:
        stopping = self._step >= self._conditions.until
        changed = self._noted_changes() if self._conditions.watched else False
        now_ns = self.guided.guide.recorded_ns
        if stopping or (changed and not self._conditions.through) or self._channel.poll():
            self._stop("step" if stopping else "watch" if changed else "interrupted")
        elif self._spacing is not None and (
            self._step in self._conditions.checkpoints or now_ns - self._last_checkpoint >= self._spacing
        ):
            self._last_checkpoint = now_ns
            if _can_be_copied() and not self._went_on_in_child():
                self._channel.send({"step": self._step, "reason": "waits"})
                self._serve()

    def _pause(self, _: int, frame: FrameType | None) -> None:
        """Stop between two records, where the plan may hang. During a record, :meth:`_pass` stops the plan."""
        if self._step >= 0 and not (self._over or self._serving or interrupts.is_uninterrupted() or is_held()):
            self._frame = frame
            self._stop("interrupted", between=True)
            self._frame = None

    def _noted_changes(self) -> bool:
        changed = False
        for number, (before, value) in enumerate(zip(self._values, self._watched_values(), strict=True)):
            if value is not None:
                self._values[number] = value
            if before is not None and value is not None and before != value:
                self._conditions.changes.append((self._step, number, before, value))
                changed = True
        return changed

    def _watched_values(self) -> list[str | None]:
        """Return the watched values, without making records or using random numbers of the plan."""
        stack = self._stack()
        dice = random.getstate()
        with journal.unrecorded():
            values = [each.value(stack) for each in self._conditions.watched]
        random.setstate(dice)
        return values

    def _went_on_in_child(self) -> bool:
        """Fork, and return True in the child process, which continues."""
        parent = os.getpid()
        if forking.fork_continuation():
            return False
        die_with(parent)
        self._channel.close()
        self.guided.recorded.after_fork()
        self._channel = self._connected(parent)
        return True

    def _connected(self, parent: int) -> Channel:
        connected = socket.socket(socket.AF_UNIX)
        connected.connect(self._address)
        channel = Channel(connected.detach())
        channel.send({"pid": os.getpid(), "parent": parent, "step": self._step})
        return channel

    # --- stopped ----------------------------------------------------------------------------------------------------

    def _stop(self, reason: str, *, between: bool = False) -> None:
        facts = {
            "step": self._step,
            "reason": reason,
            "difference": None if self._difference is None else asdict(self._difference),
            "notes": self.guided.guide.notes(),
            "changes": self._conditions.changes,
            "can_wait": reason != "parted" and not between and self._spacing is not None and _can_be_copied(),
            "between": between,
        }
        self._channel.send(facts)
        self._serve()

    def _serve(self) -> None:
        self._serving = True
        with self._clock.paused():
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
        self._conditions = StopConditions.of(message, self._moved)
        self._values = self._watched_values()

    def _answer(self, message: Message) -> Message:
        match message:
            case {"do": "end", "pid": pid}:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                return {"answer": pid}
            case {"do": "interrupt"}:  # the plan has already stopped
                return {"interrupt": "late"}
            case {"do": "where"}:
                return {"answer": [each.facts(self._moved) for each in self._stack()]}
        frame = self._stack()[message["frame"]].frame
        doing: dict[str, Callable[[], Any]] = {
            "variables": lambda: variables(frame, arguments=message["arguments"]),
            "parts": lambda: parts(frame, message["expression"]),
            "evaluate": lambda: evaluate(frame, message["expression"], pretty=message["pretty"]),
            "complete": lambda: completions(frame, message["text"]),
        }
        return self._in_copy(doing[message["do"]])

    def _in_copy(self, work: Callable[[], Any]) -> Message:
        """Work in a forked copy, so that the plan's process doesn't change."""
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
            return {"error": f"the value can't be computed: the copy of the plan that computed it {child.how}"}
        answer: Message = json.loads(child.received)
        return answer

    def _stack(self) -> list[PlanFrame]:
        return stack(self._frame, self._parents, failing=self._failing)


def main() -> None:
    """Run a plan up to a step, as requested in JSON by :class:`replay.debug.guided_plan.PlanCopies`."""
    request = json.loads(sys.argv[1])
    gc.freeze()  # garbage collection writes to all objects; copies would then no longer share their memory
    os.setsid()  # Ctrl-C at the prompt doesn't reach the plan
    die_with(request.pop("parent"))
    clock = PausableClock()
    clock.install()
    plan, arguments = request.pop("plan"), request.pop("arguments")
    guidance, folder = Guidance.of_json(request.pop("guidance")), Path(request.pop("folder"))
    sink = StoppingSink(guidance, folder, clock=clock, **request)
    sink.guided.run(plan, arguments, lambda _: sink.guided.sink(sink))
    sink.close()
    os._exit(0)
