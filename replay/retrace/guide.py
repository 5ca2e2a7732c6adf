"""Guide a run by its recording: each new record is immediately compared with the recorded record.

The order of the records is compared, too. Clocks, durations, ids of tasks and source lines aren't compared
(:func:`replay.compare.differing`).
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Final, TypeAlias

from google.protobuf.message import Message

from recorder.records import Keyframe, LoadBody, Mutation, Plain, Record, Run, Task, format_failure
from recorder.records.text import text_of, values
from recorder.records.values import AssetFile
from recorder.tracing.journal import NullSink, Sink
from replay.compare import differing, is_worded_alike
from replay.file.record_reader import RecordReader
from replay.history.source import sites
from replay.retrace.plan_process import FirstDifference

#: Fields that contain the files of an object. If a different file matters, a pose, a contact or an answer also differs.
_FILES: Final = re.compile(r"(?:load_body|loaded\[(\d+)\])\.(?:assets|robot_description)\b")

_Stack: TypeAlias = "tuple[str, ...]"  # the lines of a call stack, outermost first


class Guide(NullSink):
    """A sink that compares the records of a run with a recording, up to the first difference or the step ``until``.

    At the end, ``report`` is called with the number of equal records, and the first difference or None. ``report`` may
    end the process. Recordings of the run's projections are written into the folder of ``path``.
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
        self._worded = is_worded_alike(log)
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
        fields = differing(recorded, record, worded=self._worded)
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
        """Return the next recorded record; None at the end, or if the next record is lost."""
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
    own = sites(record)
    stack = tuple(f"{file}:{line}" for file, line in own) if own and own[-1][1] else tasks.get(record.task, ())
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


@dataclass(eq=False)
class GuidedSink(NullSink):
    """A sink that completes each record of a guided run, passes the record to several sinks, and reports its step."""

    path: Path
    sinks: Sequence[Sink]  # these sinks are closed in reverse order
    complete: Callable[[Record], None]  # a function that completes a record
    passed: Callable[[int], None]  # a function that is called with the step
    #: Folder of a moved plan, and the plan's own folder, which records contain (:class:`.plan_process.Guidance`).
    moved: tuple[str, str] | None
    lock: threading.Lock | None

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  first, the record is completed
        """Complete a record, and pass it on."""
        self.complete(record)
        if self.moved is not None:
            _rename(record, *self.moved)
        completed = record.SerializeToString()
        for sink in self.sinks:
            sink.write(topic, record, completed)
        self.passed(record.seq)

    def attach(self, asset: AssetFile) -> None:
        """Forward a file."""
        for sink in self.sinks:
            sink.attach(asset)

    def flush(self) -> None:
        """Flush all sinks."""
        for sink in self.sinks:
            sink.flush()

    def close(self) -> None:
        """Close all sinks."""
        for sink in reversed(self.sinks):
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
