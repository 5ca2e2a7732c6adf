"""Run a plan again in this process, guided by its recording. :mod:`.plan_process` starts the process.

A run without a file ends when the comparison has ended. With a file, a fork continues, and writes a recording of its
own. The result is written as a line of JSON to another file descriptor, because stdout and stderr belong to the plan.
The plan's call stacks end at the first frame of this module. The plan calls the sinks of records, so the sinks are in
:mod:`.guide`.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path, PurePath
from types import ModuleType
from typing import Final, NoReturn, TypeAlias

from google.protobuf.message import Message

from pycram import running
from pycram.foundation.forcing import decided_by
from pycram.projection.child import die_with
from pycram.reasoning.queries.query import answered_by
from pycram.running import seed_random_numbers
from pycram.scheduling.cancellation import guide_strikes, uninterruptible
from pycram.scheduling.schedule import seed_order
from recorder.errors import RecordingError
from recorder.mcap_sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected
from recorder.records import (
    Change,
    Check,
    Keyframe,
    LoadBody,
    Mutation,
    Plain,
    Record,
    Run,
    Task,
    escaped,
    format_failure,
)
from recorder.records.text import text_of, values
from recorder.records.values import AssetFile
from recorder.tracing.forking import process
from recorder.tracing.journal import NullSink, Sink
from replay.compare import differing
from replay.file.record_reader import RecordReader
from replay.retrace.changes import AnswerOracle, PendingChanges, change_text, parse_setting
from replay.retrace.decisions import BadChange
from replay.retrace.plan_process import FirstDifference, Guidance

#: Fields that contain the files of an object. If a different file matters, a pose, a contact or an answer also differs.
_FILES: Final = re.compile(r"(?:load_body|loaded\[(\d+)\])\.(?:assets|robot_description)\b")

_Stack: TypeAlias = "tuple[str, ...]"  # the lines of a call stack, outermost first


class Guide(NullSink):
    """A sink that compares the records of a run with a recording, up to the first difference or the step ``until``.

    At the end, ``report`` is called with the number of equal records, and the first difference or None. ``report`` need
    not return. Recordings of the run's projections are written into the folder of ``path``.
    """

    def __init__(
        self, log: RecordReader, report: Callable[[int, FirstDifference | None], None], until: int | None, path: Path
    ) -> None:
        self.path = path
        self._log = log
        self._until = until
        self._recorded = log.records()
        self._ahead: Record | None = None  # the next recorded record, which was read in advance
        self._reading = threading.Lock()
        self._report = report
        self._ended = False
        self._stacks: tuple[dict[int, _Stack], dict[int, _Stack]] = {}, {}  # call stacks, recorded and new
        # the recorded interruptions, by the number of the poll that they interrupt; None until they are read
        self._strikes: dict[int, Collection[int]] | None = None
        self.equal = 0  # number of equal records so far
        self.recorded_ns = 0  # time of the last equal record, by the clock of the recording
        self._other_files: dict[str, str] = {}  # names of files that differ from the recorded files, by object

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  as sinks are called
        """Compare a record."""
        if self._ended:
            return
        recorded = self._next()
        if recorded is None or recorded.seq != self.equal:  # the recording ends, or its next record is lost
            if recorded is not None or not self._log.closed:
                self._end(None)
                return
            stack = _stack(record, self._stacks[1])
            text = f"the plan continues with {_words(record)}{_at(stack)} where the recording ends"
            self._end(FirstDifference(self.equal, text, *_lines(stack)))
            return
        before, now = _stack(recorded, self._stacks[0]), _stack(record, self._stacks[1])
        fields = differing(recorded, record)
        for path, loaded in [*_other_files(record, fields)]:
            del fields[path]
            self._other_files[loaded.body] = PurePath(loaded.path).name
        if fields:
            failed = isinstance(record, Run) and record.HasField("failure")  # the line of a failure isn't always known
            self._end(_difference(recorded, record, fields, now if failed else now or before))
            return
        self.equal += 1
        self.recorded_ns = recorded.monotonic_ns
        if recorded.seq == self._until or (isinstance(record, Run) and record.phase == Run.FINISHED):
            self._end(None)

    def notes(self) -> tuple[str, ...]:
        """Return a text about files of objects that differ from the recorded files; no text if none differ."""
        files = ", ".join(f"{file} of {body}" for body, file in self._other_files.items())
        return (f"other files than recorded: {files}",) if files else ()

    def upcoming(self) -> Record | None:
        """Return the next recorded record; None at the end, or if it is lost."""
        if self._ended:
            return None
        with self._reading:
            if self._ahead is None:
                self._ahead = next(self._recorded, None)
            return self._ahead if self._ahead is not None and self._ahead.seq == self.equal else None

    def foreseen(self, look: int) -> Collection[int] | None:
        """Return the recorded interruptions at a poll; None after the end of the comparison.

        All interruptions are read in advance, because each is recorded after its poll.
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


def _other_files(record: Record, fields: Iterable[str]) -> Iterator[tuple[str, LoadBody]]:
    """Yield the fields that differ because of an object's files, and the records that loaded the object."""
    for path in fields:
        found = _FILES.match(path)
        if found and isinstance(record, Mutation):
            yield path, record.load_body
        elif found and isinstance(record, Keyframe):
            yield path, record.loaded[int(found[1])]


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
    """Return a record as text, without durations."""
    if isinstance(record, Task):
        if record.phase == Task.STARTED:
            return f"{record.name}({values(record.parameters)})"
        ended = "" if record.phase == Task.ASKED else Task.Status.Name(record.status).lower()
        failed = f": {format_failure(record.failure)}" if record.HasField("failure") else ""
        return f"{record.name} {ended or 'in the queue'}{failed}"
    if isinstance(record, Run) and record.phase == Run.FINISHED:
        return "its end" if record.succeeded else f"its end with the failure {format_failure(record.failure)}"
    return text_of(record)[0]


def _stack(record: Record, tasks: dict[int, _Stack]) -> _Stack:
    """Return the plan's lines that led to a record, or else to its task. Store the lines of a task that starts."""
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
    """A sink that completes each record of a guided run, passes the record to several sinks, and reports its step.

    Sinks are closed in reverse order. Records of a ``moved`` plan (:class:`Guidance`) contain the plan's own folder.
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

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  first, the record is completed
        """Complete a record, and pass it on."""
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
    for each, value in message.ListFields():
        repeated = hasattr(value, "append")
        if each.cpp_type == each.CPPTYPE_MESSAGE:
            for part in value if repeated else [value]:
                _rename(part, old, new)
        elif each.type == each.TYPE_STRING and repeated:
            value[:] = [text.replace(old, new) for text in value]
        elif each.type == each.TYPE_STRING and old in value:
            setattr(message, each.name, value.replace(old, new))


_STDOUT, _STDERR = 1, 2


def make_change(change: Change) -> None:
    """Make a change of a fork."""
    if change.seed:
        seed_random_numbers(int(change.seed))
        seed_order(int(change.seed))
        return
    with uninterruptible():
        parse_setting(change.set, fluent=not change.world).make(change.world)


class GuidedRun:
    """A run of a plan in this process: records are compared, queries answered, and changes made after their steps.

    The folder is for recordings of projections. :class:`replay.retrace.guided_run.Guide` explains ``report``, and
    :class:`replay.retrace.changes.PendingChanges` ``refuse``.
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
        """Return the sink for the run's records: a file if given, the comparison, and other sinks.

        ``passed`` is called after each step and the changes after it.
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
        """Run a plan as a program. The function returns even if the plan raises an exception.

        When the plan starts its recording, ``sink_of`` returns a sink that replaces the file.
        """
        owner, began, by_program, guided = process(), self.began, self.guidance.by_program, False

        def redirect(run: Run) -> Sink | None:
            nonlocal guided
            if run.by_program != by_program:
                return None
            named = run.name in (began.name, escaped(Path(plan).stem))
            same_number = run.number == (began.number or 1)  # older recordings don't contain this number
            if guided or not (named and same_number):
                return NullSink()  # the program has started another recording
            guided = True
            if began.HasField("looks"):  # older recordings don't contain the number of polls
                guide_strikes(lambda look: self.guide.foreseen(look) if process() == owner else None, began.looks)
            return sink_of(run)

        decided = any(change.answer for change in self.guidance.changes)
        forcing = decided_by(self.answers) if decided else contextlib.nullcontext()
        with answered_by(self.answers), forcing, redirected(redirect):
            run_plan(began, spec_of(self.recorded, plan, arguments), file)


def spec_of(recorded: RecordReader, plan: str | Path, arguments: Sequence[str]) -> running.RunSpec:
    """Return the settings of a recorded run, for the plan and its arguments."""
    began = recorded[0]
    if not isinstance(began, Run):
        raise TypeError("the recording doesn't begin with a run")  # the caller has checked that
    watched = [each for each in recorded.records(Check) if each.by_run and each.phase == Check.WATCHED]
    return running.RunSpec(
        Path(plan),
        tuple(arguments),
        int(began.seed) if began.seed.isdecimal() else None,
        began.order,
        began.environment,
        {each.name: json.loads(each.value_json) for each in began.parameters},
        tuple(each.property for each in watched),
        any(each.only_record for each in watched),
    )


def run_plan(began: Run, spec: running.RunSpec, file: Path, *, overwrite: bool = False) -> None:
    """Run a recorded plan in this process, as the recorded command or program did; return even if the plan fails."""
    if not began.by_program:
        running.run(spec, file, overwrite=overwrite)
        return
    plan = str(spec.plan)
    sys.argv = [began.called_as or plan, *spec.arguments]
    sys.path.insert(0, str(spec.plan.parent.resolve()))
    with contextlib.suppress(BaseException):  # the recording contains the exception
        _run_program(plan)


def _run_program(plan: str) -> None:
    """Run a file in the way Python does. :mod:`runpy` would name the module by its path."""
    module = ModuleType("__main__")
    module.__file__ = plan
    sys.modules["__main__"] = module
    exec(compile(Path(plan).read_bytes(), plan, "exec"), module.__dict__)  # noqa: S102  the plan


def main() -> None:
    """Run a plan again as the JSON argument of the process requests (:meth:`.PlanProcess.run`)."""
    request = json.loads(sys.argv[1])
    die_with(request.pop("parent"))
    guidance = Guidance.of_json(request.pop("guidance"))
    plan, arguments = request.pop("plan"), request.pop("arguments")
    _ReportedRun(guidance, **request).run(plan, arguments)


class _ReportedRun:
    """A guided run whose result another process reads from the file descriptor ``result``.

    A fork records into a file, and prints to the file descriptor ``output``; without a file, the run ends with the
    comparison.
    """

    def __init__(self, guidance: Guidance, *, result: int, output: int, file: str | None, folder: str) -> None:
        self._guided = GuidedRun(guidance, Path(folder), self._report, self._refuse)
        self._result = result
        self._output = output
        self._file = file
        self._sent = False
        self._equal: int | None = None  # number of equal records, once the comparison has ended

    def run(self, plan: str, arguments: Sequence[str]) -> None:
        """Run the plan to its end, unless the process ends earlier."""
        self._guided.run(plan, arguments, self._sink_of, Path(self._file or os.devnull))
        self._guided.guide.close()
        if self._file is not None and self._sent:
            self._send(difference=None)
        if self._guided.changes.due:
            change = self._guided.changes.due[0]
            self._refuse(
                BadChange(
                    change_text(change), f"the plan ended before this change, which comes after step {change.step}"
                )
            )

    def _sink_of(self, run: Run) -> Sink:
        recorded, began, guidance = self._guided.recorded, self._guided.began, self._guided.guidance
        if guidance.moved is not None:  # the folder of a moved plan isn't in a repository
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
        """End the run after the last compared step and the changes after it."""
        if self._equal is None or self._sent:
            return
        self._send(difference=None)
        for stream, descriptor in ((sys.__stdout__, _STDOUT), (sys.__stderr__, _STDERR)):
            if stream is not None:
                stream.flush()
            os.dup2(self._output, descriptor)  # from this moment on, the plan's output is new

    def _refuse(self, error: Exception) -> NoReturn:
        self._send(error=str(error))
        os._exit(0)

    def _send(self, **facts: object) -> None:
        self._sent = True
        taken, notes = self._guided.answers.taken, self._guided.guide.notes()
        answer = {"equal": self._equal, "taken": taken, "notes": notes, "unused": self._guided.answers.unused, **facts}
        os.write(self._result, json.dumps(answer).encode() + b"\n")
