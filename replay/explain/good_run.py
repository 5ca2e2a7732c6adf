"""Compare a failed run with the nearest run of the same plan that succeeded, from the same folder.

For the same source, the comparison finds the first call of the plan at which the runs went different ways, and the
answers before it that differ. If the plan's source was edited between the runs, the comparison lists the edits.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice, takewhile, zip_longest
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from recorder.records import Mutation, Plain, Query, Run, Task, argument_values, from_json
from recorder.records.text import is_choice
from replay.compare import NOTABLE_METRES, leaves
from replay.errors import ReplayError
from replay.file.lifetimes import closes_world
from replay.file.record_reader import RecordReader
from replay.history.source import Line, PlanSource, name_of
from replay.history.tasks import MAX_CHECKED
from replay.report import phrases

if TYPE_CHECKING:
    from replay.explain.why import Why

_OPENED: Final = 20  # maximum number of recordings that are opened, the nearest in time first
_COMPARED: Final = 3  # maximum number of good runs that are compared
_LISTED: Final = 3  # maximum number of edits, of values, and of answers

_Lines: TypeAlias = "tuple[tuple[str, int], ...]"


class _Call(NamedTuple):
    """A task, query or change that the plan's code began."""

    lines: _Lines  # files and lines of the plan that led to it, innermost first
    record: Task | Query | Mutation


@dataclass(frozen=True, slots=True)
class GoodRun:
    """The nearest good run, and what it does otherwise."""

    file: str  # name of the recording
    edits: tuple[tuple[Line, str], ...] = ()  # edited lines of the failed plan, and their texts in the good plan
    last: Line | None = None  # the last line of the plan that both runs called; None if the source was edited
    here: Line | None = None  # the next line that the failed run called; None if it failed before
    there: Line | None = None  # the next line that the good run called; None if it ended
    steps: tuple[int, int] = (-1, -1)  # steps of the last common call, in the failed run and in the good run
    answers: tuple[tuple[Query, Query], ...] = ()  # answers to the plan's queries that differ, the last ones
    values: Mapping[str, tuple[Plain, Plain]] | None = None  # arguments of the last common call that differ

    def lines(self) -> Iterator[str]:
        """Yield the comparison as text."""
        for line, text in self.edits:
            yield f"{phrases.place(line)} was edited: {text or 'a new line'} -> {line.text or 'deleted'}"
        if self.last is None:
            return
        here, there = self.steps
        yield f"both runs called the same lines up to {phrases.place(self.last)} (step {here}; there step {there})"
        for name, (own, other) in (self.values or {}).items():
            yield f"    {name} was {phrases.value(own)}; there it was {phrases.value(other)}"
        for query, same in self.answers:
            yield f"before it, {phrases.question(query)} was answered {phrases.answer(query)} at step {query.seq};"
            yield f"    there it was answered {phrases.answer(same)} at step {same.seq}"
        if self.here is not None or self.there is not None:
            yield f"next, this run {_went_on(self.here, 'failed')}; the good run {_went_on(self.there, 'ended')}"


def _went_on(line: Line | None, end: str) -> str:
    return end if line is None else f"went on with {phrases.place(line)}  {line.text}".rstrip()


def good_run(log: RecordReader, why: Why) -> GoodRun | None:
    """Compare a failed run with good runs of the same plan in its folder, and return the nearest; None without one."""
    if why.failure is None or why.case is None or not log.metadata.get("plan"):
        return None
    now = log.path.stat()
    if now.st_size > MAX_CHECKED:  # such a comparison would cost more than the explanation
        return None
    others = (file for file in log.path.parent.glob("*.mcap") if not file.samefile(log.path))
    files = sorted(others, key=lambda file: abs(file.stat().st_mtime - now.st_mtime))
    found = []
    for file in files[:_OPENED]:
        try:
            with RecordReader(file) as other:
                if other.metadata.get("plan") == log.metadata["plan"]:  # the end is only read for runs of the plan
                    end = next(other.backwards(), None)
                    found += [_compared(log, why, other)] if isinstance(end, Run) and end.succeeded else []
        except (ReplayError, OSError):  # such a file is no good run
            continue
        if len(found) == _COMPARED:
            break
    # a run of the same source that goes the same way for longest tells most
    return max(found, key=lambda run: (run.last is not None, run.steps[0]), default=None)


def _compared(log: RecordReader, why: Why, other: RecordReader) -> GoodRun:
    name, source, others = other.path.name, PlanSource(log), PlanSource(other)
    edited = [file for file in source.files if others.has(file) and source.text(file) != others.text(file)]
    if edited:
        edits = [edit for file in edited for edit in _edits(file, source, others.text(file))]
        return GoodRun(name, tuple(edits[:_LISTED]))
    thread = log[why.step].thread
    own, good = list(_calls(log, thread, why.step + 1)), list(_calls(other, thread, len(other)))
    pairs = list(takewhile(lambda pair: pair[0].lines == pair[1].lines, zip(own, good, strict=False)))
    if not pairs:
        return GoodRun(name)
    queries = [(a.record, b.record) for a, b in pairs if isinstance(a.record, Query) and isinstance(b.record, Query)]
    here, there = pairs[-1][0].record, pairs[-1][1].record
    return GoodRun(
        name,
        last=_line(source, pairs[-1][0]),
        here=_line(source, *own[len(pairs) :][:1]),
        there=_line(source, *good[len(pairs) :][:1]),
        steps=(here.seq, there.seq),
        answers=tuple(pair for pair in queries if _is_other(*pair))[-_LISTED:],
        values=dict(islice(_values(here, there), _LISTED)),
    )


def _edits(file: str, source: PlanSource, other: str) -> Iterator[tuple[Line, str]]:
    """Yield the edited lines of a file, and their texts in the other version of the file."""
    own, good = source.text(file).splitlines(), other.splitlines()
    for kind, start, stop, first, last in difflib.SequenceMatcher(None, good, own, autojunk=False).get_opcodes():
        if kind != "equal":
            for before, number in zip_longest(good[start:stop], range(first, last)):
                text = "" if number is None else own[number].strip()
                if text or (before or "").strip():
                    yield Line(file, first + 1 if number is None else number + 1, "", text), (before or "").strip()


def _calls(log: RecordReader, thread: str, stop: int) -> Iterator[_Call]:
    """Yield the calls of a plan's thread, each once: tasks, queries and changes that its code began itself."""
    calls: dict[int, _Lines] = {}  # by id of the task
    for record in log.records((Task, Query, Mutation), 0, stop):
        if not isinstance(record, Task | Query | Mutation) or record.thread != thread or not record.source_line:
            continue
        callers = ((name_of(each.file or record.source_file), each.line) for each in record.callers)
        lines = ((name_of(record.source_file), record.source_line), *callers)
        within = calls.get(record.parent if isinstance(record, Task) else record.task)
        if isinstance(record, Task):
            if record.phase != Task.STARTED:
                continue
            calls[record.task] = lines
        if lines != within and not (isinstance(record, Query) and is_choice(record)) and not closes_world(record):
            yield _Call(lines, record)


def _line(source: PlanSource, call: _Call | None = None) -> Line | None:
    return None if call is None else source.line(*call.lines[0])


def _is_other(own: Query, good: Query) -> bool:
    """Return whether two answers differ otherwise than by numbers, which differ from seed to seed."""
    pair = from_json(own.answer_json), from_json(good.answer_json)
    return own.name == good.name and pair[0] != pair[1] and not any(isinstance(each, float | list) for each in pair)


def _values(own: object, good: object) -> Iterator[tuple[str, tuple[Plain, Plain]]]:
    """Yield the arguments of two calls that differ, by more than objects settle if they are numbers."""
    if isinstance(own, Task) and isinstance(good, Task):
        others = argument_values(good.parameters)
        for name, value in argument_values(own.parameters).items():
            if name in others and any(leaves(value, others[name], name, NOTABLE_METRES)):
                yield name, (value, others[name])
