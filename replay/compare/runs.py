"""Compares two recordings: the first record that differs, and the difference of the states at their ends.

Records are aligned by the path of their task and their index among that task's records, not by their step: concurrent
branches may be scheduled differently in each run. Clocks, durations, ids and threads aren't compared. Both recordings
are streamed.

A process numbers the worlds and fluents that a plan doesn't name (``world_3``), across all of its runs. Worlds are
paired by name; numbered worlds, and the remaining ones, in the order of opening. Fluents are paired by their offset
from the first numbered fluent.
"""

from __future__ import annotations

import json
import re
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Fluent, Mutation, Query, Refusal, Run, Task, without_addresses
from recorder.records.text import is_choice
from replay.compare import states
from replay.compare.states import Difference, difference
from replay.history.summary import Summary, summary
from replay.history.tasks import causing_tasks
from replay.report import phrases, report
from replay.state.fold import state_at
from replay.state.json_data import kind_of, record_data

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from recorder.records import Plain, Record
    from replay.file.record_reader import RecordReader


#: Records that are read on after the divergence, to distinguish missing records from those in another order.
_WINDOW: Final = 2000
#: Fields that differ from run to run.
_INCIDENTAL: Final = (
    "seq", "wall_time_ns", "monotonic_ns", "task", "parent", "thread", "cause", "duration_ns", "began_ns",
    "source_file", "source_line", "callers", "strikes",
)  # fmt: skip

#: Fields of a run's start that may differ where the same happens: the runs may be those of two versions of a plan.
_GIVEN: Final = (
    "name", "arguments", "directory", "seed", "order", "hash_seed", "plan", "pycram", "host", "cpu", "program",
    "by_program", "called_as", "number", "origin", "looks", "parameters", "sweep",
)  # fmt: skip
_MAX_LISTED: Final = 8  # fields that are listed one by one
_REQUESTS: Final = ("reference", "next_solution")

_Key: TypeAlias = "tuple[int, int]"  # hash of a task's path, and the number of the record among the task's
_Diverged: TypeAlias = "tuple[Record | None, Record | None, dict[str, tuple[Plain, Plain]]]"


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first record that differs between two runs."""

    first: Record | None  # None: only the second run has it
    second: Record | None  # None: only the first run has it
    task: str  # the path of their task; "" for the plan itself
    fields: dict[str, tuple[Plain, Plain]]  # values that differ, by the path of the field


@dataclass(frozen=True, slots=True)
class Comparison:
    """A comparison of two runs."""

    equal: int  # number of records that are equal until the divergence
    divergence: Divergence | None
    difference: Difference  # of the states at their ends, before worlds were closed
    outcomes: tuple[Summary, Summary]


def compare(first: RecordReader, second: RecordReader, tolerance: float = 0.0) -> Comparison:
    """Compare two recordings; numbers within the tolerance count as equal."""
    names = PairedNames(first, second)
    equal, divergence = _divergence(first, second, tolerance, names)
    ends = state_at(first, first.final_step()), state_at(second, second.final_step())
    return Comparison(equal, divergence, difference(*ends, names.worlds), (summary(first), summary(second)))


def _divergence(
    first: RecordReader, second: RecordReader, tolerance: float, names: PairedNames
) -> tuple[int, Divergence | None]:
    waiting: tuple[dict[_Key, Record], dict[_Key, Record]] = {}, {}
    explaining = [False, False]
    equal = since = 0
    diverged: _Diverged | None = None
    for pair in zip_longest(_keyed(first, names, 0), _keyed(second, names, 1)):
        for side, item in enumerate(pair):
            if item is None:
                continue
            key, record = item
            explaining[side] |= _explains(record)
            match = waiting[1 - side].pop(key, None)
            if match is None:
                waiting[side][key] = record
            elif diverged is None:
                a, b = (match, record) if side else (record, match)
                fields = differing(a, b, tolerance, names)
                if fields:
                    diverged = a, b, fields
                else:
                    equal += 1
        since += diverged is not None
        if since > _WINDOW:
            break
    return equal, _first(first, second, diverged, waiting, explaining)


def _first(
    first: RecordReader,
    second: RecordReader,
    diverged: _Diverged | None,
    waiting: Sequence[Mapping[_Key, Record]],
    explaining: Sequence[bool],
) -> Divergence | None:
    """Return the earlier of a pair that differs and a record that only one run has.

    Records of how something was chosen are ignored if the other run has none.
    """
    candidates: list[_Diverged] = [] if diverged is None else [diverged]
    for side, unmatched in enumerate(waiting):
        alone = next((each for each in unmatched.values() if explaining[1 - side] or not _explains(each)), None)
        if alone is not None:
            candidates.append((None, alone, {}) if side else (alone, None, {}))
    if not candidates:
        return None
    a, b, fields = min(candidates, key=_steps)
    log, record = (second, b) if a is None else (first, a)
    tasks = causing_tasks(log, record).tasks if record is not None else ()
    return Divergence(a, b, "/".join(task.started.name for task in reversed(tasks)), fields)


def _steps(diverged: _Diverged) -> list[int]:
    """Return the steps of a pair that differs, in order; of a record that only one run has twice its step."""
    steps = sorted(record.seq for record in diverged[:2] if record is not None)
    return [steps[0], steps[-1]]


def _keyed(log: RecordReader, names: PairedNames, run: int) -> Iterator[tuple[_Key, Record]]:
    """Yield the records with their alignment keys; only running tasks are kept in memory."""
    paths: dict[int, int] = {}  # by id of the task
    counts: dict[int, int] = {}  # records by path
    parts: dict[int, dict[tuple[str, str], int]] = {}  # by path: how many tasks of each kind and name are in it
    for record in log:
        names.note(run, record)
        if isinstance(record, Task) and record.phase == Task.STARTED:
            outer = paths.get(record.parent, 0)
            name = record.kind, names.text(record.name) if run else record.name
            siblings = parts.setdefault(outer, {})
            siblings[name] = siblings.get(name, 0) + 1
            paths[record.task] = hash((outer, *name, siblings[name]))
        path = paths.get(record.task, 0)
        if _explains(record):  # numbered separately, as early recordings lack them
            path = _explaining(path)
        elif isinstance(record, Mutation | Fluent) and record.by_fork:  # the plan's own are compared with each other
            path = hash((path, "by the fork"))
        counts[path] = counts.get(path, 0) + 1
        yield (path, counts[path]), record
        if isinstance(record, Task) and record.phase == Task.FINISHED:
            paths.pop(record.task, None)
            counts.pop(path, None)
            counts.pop(_explaining(path), None)
            parts.pop(path, None)


def _explaining(path: int) -> int:
    """Return the path of records of how a task chose something."""
    return hash((path, "explaining"))


def _explains(record: Record) -> bool:
    """Return whether a record explains a choice, or is a request of a designator."""
    return isinstance(record, Query) and (is_choice(record) or record.name in _REQUESTS)


def differing(
    first: Record, second: Record, tolerance: float = 0.0, names: PairedNames | None = None
) -> dict[str, tuple[Plain, Plain]]:
    """Return the different values of two records by the field's path; numbers within the tolerance are equal."""
    if type(first) is not type(second):
        return {"kind": (kind_of(first), kind_of(second))}
    a, b = _bare(first), _bare(second)
    if isinstance(a, Task) and isinstance(b, Task) and a.HasField("decision") != b.HasField("decision"):
        a.ClearField("decision")  # an early recording lacks it
        b.ClearField("decision")
    if isinstance(a, Query) and isinstance(b, Query) and a.HasField("chosen") != b.HasField("chosen"):
        for query in (a, b):  # an early recording lacks what was considered
            query.ClearField("candidates")
            query.ClearField("chosen")
    if a == b and a.SerializeToString(deterministic=True) == b.SerializeToString(deterministic=True):
        return {}  # the bytes distinguish -0.0 from 0.0
    after = record_data(b)
    if names is not None and names.any:
        after = {key: names.data(value, key) for key, value in after.items()}
    return dict(_leaves(record_data(a), after, "", tolerance))


def _bare(record: Record) -> Record:
    """Return a record without fields that differ from run to run."""
    bare = type(record)()
    bare.CopyFrom(record)  # type: ignore[arg-type]
    for field in _INCIDENTAL:
        if field in bare.DESCRIPTOR.fields_by_name:
            bare.ClearField(field)
    if isinstance(bare, Run | Task | Query | Refusal) and bare.HasField("failure"):
        bare.failure.ClearField("traceback")
        del bare.failure.frames[:]
    if isinstance(bare, Run):
        for field in _GIVEN:
            bare.ClearField(field)
    if isinstance(bare, Task) and '"recording"' in bare.result_json:
        with suppress(ValueError):
            bare.result_json = json.dumps(_without_files(json.loads(bare.result_json)))
    return bare


def _without_files(result: Plain) -> Plain:
    """Return a task's result without names of projections' recordings, which are derived from the run's name."""
    if isinstance(result, list):
        return [_without_files(each) for each in result]
    if isinstance(result, dict):
        outcome = {"recording", "succeeded", "duration"} <= result.keys()
        return {key: _without_files(value) for key, value in result.items() if not (outcome and key == "recording")}
    return result


def _leaves(a: Plain, b: Plain, name: str, tolerance: float) -> Iterator[tuple[str, tuple[Plain, Plain]]]:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in {**a, **b}:
            yield from _leaves(a.get(key), b.get(key), f"{name}.{key}" if name else key, tolerance)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for at, pair in enumerate(zip(a, b, strict=True)):
            yield from _leaves(*pair, f"{name}[{at}]", tolerance)
    elif isinstance(a, str) and isinstance(b, str):
        if a != b and without_addresses(a) != without_addresses(b):
            yield name, (a, b)
    elif a != b and not (isinstance(a, int | float) and isinstance(b, int | float) and abs(a - b) <= tolerance):
        yield name, (a, b)


_NUMBERED: Final = re.compile(r"\b(world|fluent)_([1-9]\d*)\b")
_WAITS: Final = frozenset({"wait", "whenever"})  # kinds of tasks that are named after a fluent


class PairedNames:
    """Translates names of the second run into names of the first.

    Attributes:
        worlds: names of the first run's worlds by those of the second's; equal ones are left out.
    """

    def __init__(self, first: RecordReader, second: RecordReader) -> None:
        opened = (list(dict.fromkeys(lifetime.world for lifetime in log.lifetimes)) for log in (first, second))
        self.worlds = dict(_pairs(*opened))
        self._offsets: list[int | None] = [None, None]  # numbers of the first fluents that are seen, by run

    def note(self, run: int, record: Record) -> None:
        """Note a record of run 0 or 1 before its comparison: the first numbered fluent sets the offset."""
        if self._offsets[run] is None and (
            isinstance(record, Fluent) or (isinstance(record, Task) and record.kind in _WAITS)
        ):
            numbers = [int(number) for word, number in _NUMBERED.findall(record.name) if word == "fluent"]
            self._offsets[run] = min(numbers, default=None)

    @property
    def any(self) -> bool:
        """Whether any name is known to differ so far."""
        return bool(self.worlds) or self._shift != 0

    @property
    def _shift(self) -> int:
        before, after = self._offsets
        return before - after if before is not None and after is not None else 0

    def text(self, text: str) -> str:
        """Return a text of the second run, translated."""
        return _NUMBERED.sub(self._renamed, text)

    def _renamed(self, match: re.Match[str]) -> str:
        if match[1] == "world":
            return self.worlds.get(match[0], match[0])
        return f"fluent_{int(match[2]) + self._shift}"

    def data(self, value: Plain, key: str = "") -> Plain:
        """Return data of a record of the second run, translated."""
        if isinstance(value, dict):
            return {self.text(name): self.data(item, name) for name, item in value.items()}
        if isinstance(value, list):
            return [self.data(item) for item in value]
        if isinstance(value, str):
            return self.worlds[value] if key == "world" and value in self.worlds else self.text(value)
        return value


def _pairs(first: list[str], second: list[str]) -> Iterable[tuple[str, str]]:
    """Yield pairs of names of worlds, second run first, for counterparts with different names."""
    numbered = [[name for name in names if _NUMBERED.fullmatch(name)] for names in (first, second)]
    yield from zip(numbered[1], numbered[0], strict=False)
    paired = [set(names[: min(map(len, numbered))]) for names in numbered]
    others = [[name for name in names if name not in done] for names, done in zip((first, second), paired, strict=True)]
    rest = [
        [name for name in names if name not in both] for names in others for both in [set(others[0]) & set(others[1])]
    ]
    yield from zip(rest[1], rest[0], strict=False)


# --- as JSON data and as text ----------------------------------------------------------------------------------------


@report.data.register(Comparison)
def _(compared: Comparison) -> dict[str, object]:
    return {
        "alike": compared.equal,
        "parting": report.data(compared.divergence),
        "world": report.data(compared.difference),
        "outcomes": [_outcome(each) for each in compared.outcomes],
        "failures": [each.failure for each in compared.outcomes],
    }


def lines(compared: Comparison, *, whole: bool) -> Iterator[str]:
    """Yield a comparison as text; ``whole`` includes settling of physics and every joint."""
    first, second = compared.outcomes
    if compared.divergence is None:
        yield f"the runs are the same: {compared.equal} records"
    else:
        yield from _divergence_lines(compared.divergence, compared.equal)
    if compared.difference:
        yield ""
        yield "at the end, first -> second:"
        yield from (f"  {line}" for line in states.lines(compared.difference, whole=whole))
    ends = _ended(first), _ended(second)
    yield ""
    yield f"both {ends[0]}" if ends[0] == ends[1] else f"the first {ends[0]}; the second {ends[1]}"


def _ended(run: Summary) -> str:
    """Return how a run ended, as a verb."""
    verbs = {"cut off": "broke off", "running": "had not ended", "lost": "lost its end"}
    return verbs.get(run.outcome) or _outcome(run)


def _outcome(run: Summary) -> str:
    return run.outcome + (f" ({run.failure})" if run.failure else "")


def _divergence_lines(divergence: Divergence, equal: int) -> Iterator[str]:
    where = f" in {divergence.task}" if divergence.task else ""
    yield f"the runs are equal for {equal} records, then they diverge{where}:"
    for name, record in (("first", divergence.first), ("second", divergence.second)):
        yield f"  {name:6} {_record(record)}"
    for field, (before, after) in list(divergence.fields.items())[:_MAX_LISTED]:
        apart = f"  (by {abs(after - before):.3g})" if isinstance(before, float) and isinstance(after, float) else ""
        yield f"    {field}: {phrases.value(before)} -> {phrases.value(after)}{apart}"
    if len(divergence.fields) > _MAX_LISTED:
        yield f"    ... {len(divergence.fields) - _MAX_LISTED} more values"


def _record(record: Record | None) -> str:
    return (
        f"step {record.seq}: {phrases.short(phrases.record_line(record))}"
        if record is not None
        else "has no such record"
    )
