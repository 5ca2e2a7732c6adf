"""Runs a plan again in this process, guided by its recording; :mod:`.plan_process` starts the process.

Each new record is compared with the recorded one as soon as it is made. Their order is compared, but not clocks,
durations, ids of tasks and source lines (see :func:`replay.compare.differing`). A run without a file ends when the
comparison ends. A fork then continues into a recording of its own. The result is one line of JSON on a file descriptor:
stdout and stderr are the plan's. Call stacks of the plan end at this module.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NoReturn, TypeAlias

from pycram import running
from pycram.projection.child import die_with
from pycram.reasoning.queries.query import answered_by
from pycram.running import seed_random_numbers
from pycram.scheduling.cancellation import uninterruptible
from pycram.scheduling.schedule import guide_strikes, seed_order
from recorder.errors import PortableError, RecordingError
from recorder.mcap_sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected
from recorder.records import Change, Run, Task, escaped, format_error, format_failure
from recorder.records.text import text_of, values
from recorder.tracing.forking import process
from recorder.tracing.journal import NullSink
from replay.compare import differing
from replay.file.record_reader import RecordReader
from replay.retrace.changes import AnswerOracle, BadChange, PendingChanges, change_text, parse_setting
from replay.retrace.plan_process import FirstDifference, Guidance

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from google.protobuf.message import Message

    from recorder.records import Plain, Record
    from recorder.records.values import AssetFile
    from recorder.tracing.journal import Sink

_Stack: TypeAlias = "tuple[str, ...]"  # the plan's lines that called one another, outermost first

_STDOUT, _STDERR = 1, 2


class Guide(NullSink):
    """Compares the records of a run with a recording, up to the first difference.

    Args:
        log: the recording.
        report: called once, with the number of equal records and the first difference or None. It need not return.
        until: the last compared step; by default the recording's last step.
        path: the file that the run would record to; recordings of its projections are written beside it.
    """

    def __init__(
        self,
        log: RecordReader,
        report: Callable[[int, FirstDifference | None], None],
        until: int | None,
        path: Path,
    ) -> None:
        self.path = path
        self._log = log
        self._until = until
        self._recorded = log.records()
        self._ahead: Record | None = None  # the next record, if it was read before its comparison
        self._reading = threading.Lock()
        self._report = report
        self._ended = False
        self._stacks: tuple[dict[int, _Stack], dict[int, _Stack]] = {}, {}  # of running tasks, recorded and new
        self._strikes: dict[int, Collection[int]] | None = None  # by the number of the poll; None until needed
        self.equal = 0  # number of equal records so far
        self.recorded_ns = 0  # time of the last of them by the recording's clock

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  as sinks are called
        """Compare a record."""
        if self._ended:
            return
        recorded = self._next()
        if recorded is None or recorded.seq != self.equal:  # the recording ends here, or its next record is lost
            if recorded is not None or not self._log.closed:
                self._end(None)
                return
            stack = _stack(record, self._stacks[1])
            text = f"the plan continues with {_words(record)}{_at(stack)} where the recording ends"
            self._end(FirstDifference(self.equal, text, *_lines(stack)))
            return
        before, now = _stack(recorded, self._stacks[0]), _stack(record, self._stacks[1])
        fields = differing(recorded, record)
        if fields:
            failed = isinstance(record, Run) and record.HasField("failure")  # its line may be unknown
            self._end(_difference(recorded, record, fields, now if failed else now or before))
            return
        self.equal += 1
        self.recorded_ns = recorded.monotonic_ns
        if recorded.seq == self._until or (isinstance(record, Run) and record.phase == Run.FINISHED):
            self._end(None)

    def upcoming(self) -> Record | None:
        """Return the next recorded record; None at the end, or if it is lost."""
        if self._ended:
            return None
        with self._reading:
            if self._ahead is None:
                self._ahead = next(self._recorded, None)
            return self._ahead if self._ahead is not None and self._ahead.seq == self.equal else None

    def foreseen(self, look: int) -> Collection[int] | None:
        """Return the interruptions of the recorded run at a poll for them; None after the end of the comparison.

        All are read in advance: the record of an interruption follows it.
        """
        if self._ended:
            return None
        with self._reading:
            if self._strikes is None:
                stop = None if self._until is None else self._until + 1
                records = self._log.records(None, 0, stop)
                self._strikes = {each.look: each.which for record in records for each in record.strikes}
            return self._strikes.get(look, ())

    def _next(self) -> Record | None:
        with self._reading:
            record, self._ahead = self._ahead, None
            return record or next(self._recorded, None)

    def close(self) -> None:
        """Report the difference if the plan ended before its recording."""
        if not self._ended:
            recorded = self._next()
            if recorded is None or recorded.seq != self.equal:
                self._end(None)
                return
            stack = _stack(recorded, self._stacks[0])
            text = f"the plan ended where step {recorded.seq} has {_words(recorded)}{_at(stack)}"
            self._end(FirstDifference(recorded.seq, text, *_lines(stack)))

    def _end(self, difference: FirstDifference | None) -> None:
        self._ended = True
        self._report(self.equal, difference)


def _difference(
    recorded: Record, record: Record, fields: dict[str, tuple[Plain, Plain]], stack: _Stack
) -> FirstDifference:
    before, now = _words(recorded), _words(record)
    same = type(recorded) is type(record)
    if before == now and same:
        text = f"{now}{_at(stack)} differs from step {recorded.seq}"
    else:
        verb = "asks for" if isinstance(record, Task) and record.phase == Task.STARTED else "has"
        text = f"the plan {verb} {now}{_at(stack)} where step {recorded.seq} has {before}"
    return FirstDifference(recorded.seq, text, *_lines(stack), fields if same else {})


def _words(record: Record) -> str:
    """Return a record in words, without durations."""
    if isinstance(record, Task):
        if record.phase == Task.STARTED:
            return f"{record.name}({values(record.parameters)})"
        ended = "" if record.phase == Task.ASKED else Task.Status.Name(record.status).lower()
        failed = f": {format_failure(record.failure)}" if record.HasField("failure") else ""
        return f"{record.name} {ended or 'in the queue'}{failed}"
    if isinstance(record, Run) and record.phase == Run.FINISHED:
        return "its end" if record.succeeded else f"its end by {format_failure(record.failure)}"
    return text_of(record)[0]


def _stack(record: Record, tasks: dict[int, _Stack]) -> _Stack:
    """Return the plan's lines that led to a record, or else to its task; note the lines of a starting task."""
    file, line = getattr(record, "source_file", ""), getattr(record, "source_line", 0)
    stack = tasks.get(record.task, ())
    if file and line:
        callers = (f"{caller.file or file}:{caller.line}" for caller in getattr(record, "callers", ()))
        stack = (*callers, f"{file}:{line}")
    if isinstance(record, Task) and record.phase == Task.STARTED:
        stack = tasks[record.task] = stack or tasks.get(record.parent, ())
    elif isinstance(record, Task) and record.phase == Task.FINISHED:
        tasks.pop(record.task, None)
    elif isinstance(record, Run):
        stack = tuple(f"{frame.file}:{frame.line}" for frame in record.failure.frames)
    return stack


def _lines(stack: _Stack) -> tuple[str, tuple[str, ...]]:
    return (stack[-1], stack[-2::-1]) if stack else ("", ())


def _at(stack: _Stack) -> str:
    return f" at {stack[-1]}" if stack else ""


class GuidedSink(NullSink):
    """Completes each record of a guided run, writes it to several sinks, and then reports its step as passed.

    Sinks are closed in reverse order. If the plan was ``moved`` (see :class:`Guidance`), records name its own folder.
    """

    def __init__(
        self,
        path: Path,
        sinks: Sequence[Sink],
        complete: Callable[[Record], None],
        passed: Callable[[int], None],
        moved: tuple[str, str] | None,
        lock: threading.Lock | None = None,
    ) -> None:
        self.path = path
        self.lock = lock
        self._sinks = sinks
        self._complete = complete
        self._passed = passed
        self._moved = moved

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  the record is completed first
        """Complete and forward a record."""
        self._complete(record)
        if self._moved is not None:
            _rename(record, *self._moved)
        completed = record.SerializeToString()
        for sink in self._sinks:
            sink.write(topic, record, completed)
        self._passed(record.seq)

    def attach(self, asset: AssetFile) -> None:
        """Forward a file."""
        for sink in self._sinks:
            sink.attach(asset)

    def flush(self) -> None:
        """Flush all sinks."""
        for sink in self._sinks:
            sink.flush()

    def close(self) -> None:
        """Close all sinks."""
        for sink in reversed(self._sinks):
            sink.close()


def _rename(message: Message, old: str, new: str) -> None:
    """Replace a folder's name in all texts of a message."""
    for each, value in message.ListFields():
        repeated = hasattr(value, "append")
        if each.cpp_type == each.CPPTYPE_MESSAGE:
            for part in value if repeated else [value]:
                _rename(part, old, new)
        elif each.type == each.TYPE_STRING and repeated:
            value[:] = [text.replace(old, new) for text in value]
        elif each.type == each.TYPE_STRING and old in value:
            setattr(message, each.name, value.replace(old, new))


# --- the run ----------------------------------------------------------------------------------------------------------


def make_change(change: Change) -> None:
    """Make a change of a fork."""
    if change.seed:
        seed_random_numbers(int(change.seed))
        seed_order(int(change.seed))
        return
    with uninterruptible():
        parse_setting(change.set, fluent=not change.world).make(change.world)


class GuidedRun:
    """A run of a plan in this process: its records are compared, queries answered, and changes made after their steps.

    Args:
        guidance: how the recording guides it.
        folder: for the recordings of its projections.
        report: see :class:`Guide`.
        refuse: called with the error of a change that can't be made; it doesn't return.
    """

    def __init__(
        self,
        guidance: Guidance,
        folder: Path,
        report: Callable[[int, FirstDifference | None], None],
        refuse: Callable[[Exception], NoReturn],
    ) -> None:
        self.guidance = guidance
        self.recorded = RecordReader(guidance.log)
        began = self.recorded[0]
        if not isinstance(began, Run):
            raise TypeError("the recording doesn't begin with a run")  # the other process has checked this
        self.began = began
        self.guide = Guide(self.recorded, report, guidance.until, folder / self.recorded.path.name)
        self.answers = AnswerOracle(self.guide, taken=guidance.take_answers, refuse=refuse)
        self.changes = PendingChanges(guidance.changes, self.answers, make_change, refuse)

    def sink(self, *sinks: Sink, file: McapSink | None = None, passed: Callable[[], None] = lambda: None) -> GuidedSink:
        """Return the sink for the run's records: a file if there is one, then the comparison, then other sinks.

        ``passed`` is called after each step and the changes that follow it.
        """
        return GuidedSink(
            self.guide.path if file is None else file.path,
            [*([] if file is None else [file]), self.guide, *sinks],
            self.changes.complete,
            lambda step: self.changes.passed(step, passed),
            self.guidance.moved,
            None if file is None else file.lock,
        )

    def run(
        self, plan: str, arguments: Sequence[str], sink_of: Callable[[Run], Sink], file: Path = Path(os.devnull)
    ) -> None:
        """Run a plan as a program, and return however it ends.

        When the plan starts the recording again, ``sink_of`` returns its sink, instead of the file.
        """
        owner, began, by_program, guided = process(), self.began, self.guidance.by_program, False

        def redirect(run: Run) -> Sink | None:
            nonlocal guided
            if run.by_program != by_program:
                return None
            named = run.name in (began.name, escaped(Path(plan).stem))
            same_number = run.number == (began.number or 1)  # older releases have no number
            if guided or not (named and same_number):
                return NullSink()  # another recording of the program
            guided = True
            if began.HasField("looks"):  # older releases have none
                guide_strikes(lambda look: self.guide.foreseen(look) if process() == owner else None, began.looks)
            return sink_of(run)

        with answered_by(self.answers), redirected(redirect):
            if by_program:
                sys.argv = [began.called_as or plan, *arguments]
                sys.path.insert(0, str(Path(plan).parent.resolve()))
                with contextlib.suppress(BaseException):  # whatever it raises: the recording has it
                    _run_program(plan)
            else:
                seed = int(began.seed) if began.seed.isdecimal() else None
                given = {each.name: json.loads(each.value_json) for each in began.parameters}
                spec = running.RunSpec(Path(plan), tuple(arguments), seed, began.order, began.environment, given)
                running.run(spec, file)


def _run_program(plan: str) -> None:
    """Run a file as Python does: runpy would name the module by its path."""
    module = ModuleType("__main__")
    module.__file__ = plan
    sys.modules["__main__"] = module
    exec(compile(Path(plan).read_bytes(), plan, "exec"), module.__dict__)  # noqa: S102  the plan


def main() -> None:
    """Run a plan again by a request in JSON, the only argument of the process; see :meth:`.PlanProcess.run`."""
    request = json.loads(sys.argv[1])
    die_with(request.pop("parent"))
    guidance = Guidance.of_json(request.pop("guidance"))
    plan, arguments = request.pop("plan"), request.pop("arguments")
    _ReportedRun(guidance, **request).run(plan, arguments)


class _ReportedRun:
    """A guided run whose result another process reads from the file descriptor ``result``.

    A fork records to a file, and prints to the file descriptor ``output``; without a file, the run ends with the
    comparison.
    """

    def __init__(self, guidance: Guidance, *, result: int, output: int, file: str | None, folder: str) -> None:
        self._guided = GuidedRun(guidance, Path(folder), self._report, self._refuse)
        self._result = result
        self._output = output
        self._file = file
        self._sent = False
        self._equal: int | None = None  # number of equal records, after the end of the comparison

    def run(self, plan: str, arguments: Sequence[str]) -> None:
        """Run the plan to its end, unless the process ends before."""
        self._guided.run(plan, arguments, self._sink_of, Path(self._file or os.devnull))
        self._guided.guide.close()
        if self._guided.changes.due:
            change = self._guided.changes.due[0]
            self._refuse(
                BadChange(change_text(change), f"the plan ended before it could be made after step {change.step}")
            )

    def _sink_of(self, run: Run) -> Sink:
        recorded, began, guidance = self._guided.recorded, self._guided.began, self._guided.guidance
        if guidance.moved is not None:  # the moved plan is in no repository
            run.plan.CopyFrom(began.plan)
        file = None
        if self._file is not None:
            run.origin.recording, run.origin.wall_time_ns = recorded.path.name, began.wall_time_ns
            run.origin.step = len(recorded) - 1 if guidance.until is None else guidance.until
            run.origin.changes.extend(guidance.changes)
            try:
                file = McapSink(Path(self._file), metadata(run))
            except RecordingError as error:
                self._refuse(error)
        return self._guided.sink(file=file, passed=self._leave)

    def _report(self, equal: int, difference: FirstDifference | None) -> None:
        self._equal = equal
        if self._file is None or difference is not None:
            self._send(difference=None if difference is None else asdict(difference))
            os._exit(0)

    def _leave(self) -> None:
        """Leave the recording after the last compared step and its changes."""
        if self._equal is None or self._sent:
            return
        self._send(difference=None)
        for stream, descriptor in ((sys.__stdout__, _STDOUT), (sys.__stderr__, _STDERR)):
            if stream is not None:
                stream.flush()
            os.dup2(self._output, descriptor)  # from here on, the plan's output is new

    def _refuse(self, error: Exception) -> NoReturn:
        self._send(error=str(error) if isinstance(error, PortableError) else format_error(error))
        os._exit(0)

    def _send(self, **facts: object) -> None:
        self._sent = True
        answer = {"equal": self._equal, "taken": self._guided.answers.taken, **facts}
        os.write(self._result, json.dumps(answer).encode() + b"\n")
