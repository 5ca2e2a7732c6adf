"""The sink that a plan which runs again records to: it compares each record with the recorded one, at once.

It guides a fork, too, which is compared up to the step at which it leaves the recording.

What differs from run to run (clocks, durations, ids of tasks) and where in the source a call stands is not compared:
see :func:`replay.explain.compare_runs.differing`. The order of records is.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

from recorder.records import Run, Task, format_failure
from recorder.records.text import text_of, values
from recorder.tracing.journal import NullSink
from replay.explain.compare_runs import differing

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from recorder.records import Plain, Record
    from replay.file.record_reader import RecordReader

_Stack: TypeAlias = "tuple[str, ...]"  # the plan's lines that called one another, outermost first


@dataclass(frozen=True, slots=True)
class Difference:
    """The first record that came out differently.

    Attributes:
        step: in the recording; its length where the plan goes on after its end.
        text: one sentence, in the plan's words.
        line: the plan's line that made the new record, as FILE:LINE; that of the recorded one where the plan ended.
        callers: the plan's lines that called it, innermost first.
        fields: recorded and new values that differ, by the path of the field; empty where it is another record.
    """

    step: int
    text: str
    line: str = ""
    callers: tuple[str, ...] = ()
    fields: dict[str, tuple[Plain, Plain]] = field(default_factory=dict)


class Guide(NullSink):
    """Compares the records of a run with a recording's, up to the first that differs.

    Args:
        log: the recording.
        report: called once: with the number of equal records, and the first difference if there is one. It need not
            return, where the plan is of no interest any more.
        until: the last step that is compared; by default the recording's last.
        path: what would be its file, beside which the plan's projections are recorded.

    Attributes:
        equal: number of records that were the same so far.
        recorded_ns: when the last of them was made, by the recording's clock.
        path: as given.
    """

    def __init__(
        self,
        log: RecordReader,
        report: Callable[[int, Difference | None], None],
        until: int | None,
        path: Path,
    ) -> None:
        self.path = path
        self._log = log
        self._until = until
        self._recorded = log.records()
        self._ahead: Record | None = None  # what was looked up of them
        self._reading = threading.Lock()
        self._report = report
        self._ended = False
        self._stacks: tuple[dict[int, _Stack], dict[int, _Stack]] = {}, {}  # of tasks that run, recorded and now
        self._strikes: dict[int, Collection[int]] | None = None  # by their looks; None until they matter
        self.equal = 0
        self.recorded_ns = 0

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  as sinks are called
        """Compare a record."""
        if self._ended:
            return
        recorded = self._next()
        if recorded is None or recorded.seq != self.equal:  # it ends here, or what comes next is lost
            self._end(None if recorded is not None or not self._log.closed else self._goes_on(record))
            return
        before, now = _stack(recorded, self._stacks[0]), _stack(record, self._stacks[1])
        fields = differing(recorded, record)
        if fields:
            failed = isinstance(record, Run) and record.HasField("failure")  # at no known line, perhaps
            self._end(_difference(recorded, record, fields, now if failed else now or before))
            return
        self.equal += 1
        self.recorded_ns = recorded.monotonic_ns
        if recorded.seq == self._until or (isinstance(record, Run) and record.phase == Run.FINISHED):
            self._end(None)

    def upcoming(self) -> Record | None:
        """Return the record that has to come next; None if none has, or what comes next is lost."""
        if self._ended:
            return None
        with self._reading:
            if self._ahead is None:
                self._ahead = next(self._recorded, None)
            return self._ahead if self._ahead is not None and self._ahead.seq == self.equal else None

    def foreseen(self, look: int) -> Collection[int] | None:
        """Return what struck at a look of the recorded run; None where it isn't guided any more.

        They are read ahead: a record that tells one comes after it, and those of a worker come when they do.
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
        """Report that the plan has ended, where the recording goes on."""
        if not self._ended:
            recorded = self._next()
            if recorded is None or recorded.seq != self.equal:
                self._end(None)
                return
            stack = _stack(recorded, self._stacks[0])
            text = f"the plan ended where step {recorded.seq} has {_words(recorded)}{_at(stack)}"
            self._end(Difference(recorded.seq, text, *_lines(stack)))

    def _goes_on(self, record: Record) -> Difference:
        stack = _stack(record, self._stacks[1])
        text = f"the plan goes on with {_words(record)}{_at(stack)} where the recording ends"
        return Difference(self.equal, text, *_lines(stack))

    def _end(self, difference: Difference | None) -> None:
        self._ended = True
        self._report(self.equal, difference)


def _difference(recorded: Record, record: Record, fields: dict[str, tuple[Plain, Plain]], stack: _Stack) -> Difference:
    before, now = _words(recorded), _words(record)
    same = type(recorded) is type(record)
    if before == now and same:
        text = f"{now}{_at(stack)} comes out differently than at step {recorded.seq}"
    else:
        verb = "asks for" if isinstance(record, Task) and record.phase == Task.STARTED else "comes to"
        text = f"the plan {verb} {now}{_at(stack)} where step {recorded.seq} has {before}"
    return Difference(recorded.seq, text, *_lines(stack), fields if same else {})


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
    """Return the plan's lines that led to a record, or else to its task, and keep those of the tasks that run."""
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
