"""Compare two states, or two recordings.

Records are aligned by the path of their task and by their index in the task, because parallel branches change the
steps. Clocks, durations, ids and threads aren't compared. Worlds are paired by name. Unnamed worlds have numbers
(``world_3``) that continue in the next run of a process; such worlds are paired in the order of opening. Numbered
fluents are paired by their offset from the first numbered fluent.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import zip_longest
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.provenance import pycram_revision
from recorder.records import Failure, Fluent, Mutation, Plain, Query, Record, Refusal, Run, Task, without_addresses
from recorder.records.text import is_choice
from replay.file.lifetimes import title
from replay.history.tasks import Summary, causing_tasks, summary
from replay.report import phrases, report
from replay.state.fold import state_at
from replay.state.json_data import kind_of, record_data
from replay.state.state import Attachment, Body, State, World, turn

if TYPE_CHECKING:
    from recorder.geometry import Pose
    from replay.file.record_reader import RecordReader

#: Distances in m and rad below which a body isn't reported as moved, because it settles in simulation.
NOTABLE_METRES: Final = 1e-3
NOTABLE_RADIANS: Final = math.radians(0.5)
_MAX_LISTED: Final = 8  # at most this many joints or fields are listed
_MIN_TURN: Final = math.radians(0.05)  # angle below which a turn isn't mentioned
#: Maximum number of records after the divergence in which a missing record is searched, because the order may differ.
_WINDOW: Final = 2000
_NUMBER: Final = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
#: Fields that differ from run to run.
_INCIDENTAL: Final = (
    "seq", "wall_time_ns", "monotonic_ns", "task", "parent", "thread", "cause", "duration_ns", "began_ns",
    "source_file", "source_line", "callers", "strikes",
)  # fmt: skip

#: Fields of a run's start that may differ, for example because the runs executed two versions of a plan.
_GIVEN: Final = (
    "name", "arguments", "directory", "seed", "order", "hash_seed", "plan", "pycram", "host", "cpu", "program",
    "by_program", "called_as", "number", "origin", "looks", "parameters", "sweep",
)  # fmt: skip
_REQUESTS: Final = ("reference", "next_solution")

_Key: TypeAlias = "tuple[int, int]"  # hash of a task's path, and number of the record within the task
_Diverged: TypeAlias = "tuple[Record | None, Record | None, dict[str, tuple[Plain, Plain]]]"


@dataclass(frozen=True, slots=True)
class BodyChange:
    """A body that differs between two states."""

    world: str
    body: str
    before: Pose
    after: Pose
    distance: float  # distance between both positions of the base, m
    angle: float  # angle between both orientations of the base, rad
    joints: Mapping[str, tuple[float, float]]  # joints with different positions: before and after
    carrier: tuple[Attachment | None, Attachment | None]  # carriers to which the body was attached before and after
    details: tuple[str, ...] = ()  # other fields that differ: color, type, fixed_base, models

    @property
    def moved(self) -> bool:
        """Whether the base moved more than objects move when they settle."""
        return self.distance >= NOTABLE_METRES or self.angle >= NOTABLE_RADIANS

    @property
    def moved_joints(self) -> dict[str, tuple[float, float]]:
        """The joints that moved more than joints move when objects settle."""
        return {name: pair for name, pair in self.joints.items() if abs(pair[1] - pair[0]) >= NOTABLE_METRES}

    @property
    def carrier_changed(self) -> bool:
        """Whether the carrier, or its link that carries the body, has changed."""
        before, after = self.carrier
        return (before and (before.carrier, before.carrier_link)) != (after and (after.carrier, after.carrier_link))

    @property
    def notable(self) -> bool:
        """Whether the body changed more than objects change when they settle."""
        return bool(self.moved or self.moved_joints or self.carrier_changed or self.details)


@dataclass(frozen=True, slots=True)
class Difference:
    """The difference between two states."""

    opened: tuple[str, ...] = ()  # titles of worlds that are open only in the second state
    closed: tuple[str, ...] = ()  # titles of worlds that are open only in the first state
    added: tuple[tuple[str, str], ...] = ()  # worlds and bodies that are only in the second state
    removed: tuple[tuple[str, str], ...] = ()  # worlds and bodies that are only in the first state
    changed: tuple[BodyChange, ...] = ()  # bodies that differ, even if only in one bit
    #: Different values of worlds, before and after, by world and name: gravity, robot, realtime, seconds, and beliefs
    #: of robots (the position of an object, or None).
    facts: Mapping[tuple[str, str], tuple[object, object]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.opened or self.closed or self.added or self.removed or self.changed or self.facts)

    @property
    def notable(self) -> tuple[BodyChange, ...]:
        """The bodies that changed more than objects change when they settle."""
        return tuple(change for change in self.changed if change.notable)


def difference(before: State, after: State, names: Mapping[str, str] = MappingProxyType({})) -> Difference:
    """Compare two states, which may belong to two recordings.

    ``names`` maps names of worlds in the second state to names in the first state, if these differ.
    """
    first = {world.title: world for world in before.worlds.values() if world.open}
    second = {
        title(names.get(world.name, world.name), world.lifetime): world for world in after.worlds.values() if world.open
    }
    both = [(world, second[name]) for name, world in first.items() if name in second]
    return Difference(
        opened=tuple(world.title for name, world in second.items() if name not in first),
        closed=tuple(name for name in first if name not in second),
        added=tuple((b.name, body) for a, b in both for body in b.bodies if body not in a.bodies),
        removed=tuple((a.name, body) for a, b in both for body in a.bodies if body not in b.bodies),
        changed=tuple(
            change
            for a, b in both
            for name, body in a.bodies.items()
            if name in b.bodies and (change := _change(a, body, b, b.bodies[name])) is not None
        ),
        facts={fact: pair for a, b in both for fact, pair in _facts(a, b)},
    )


def _facts(a: World, b: World) -> Iterator[tuple[tuple[str, str], tuple[object, object]]]:
    for name in ("gravity", "robot", "realtime", "seconds"):
        pair = getattr(a, name), getattr(b, name)
        if pair[0] != pair[1]:
            yield (a.name, name), pair
    for robot, body in dict.fromkeys([*a.beliefs, *b.beliefs]):
        one, other = a.beliefs.get((robot, body)), b.beliefs.get((robot, body))
        if one is None or other is None or math.dist(one.position, other.position) >= NOTABLE_METRES:
            yield (a.name, f"where {robot} believes {body}"), (one and one.position, other and other.position)


def _change(a: World, before: Body, b: World, after: Body) -> BodyChange | None:
    joints = {
        joint: (before.joints.get(joint, math.nan), after.joints.get(joint, math.nan))
        for joint in {**before.joints, **after.joints}
        if before.joints.get(joint) != after.joints.get(joint)
    }
    carrier = a.carrier(before.name), b.carrier(before.name)
    details = tuple(
        name for name in ("color", "type", "fixed_base", "models") if getattr(before, name) != getattr(after, name)
    )
    speeds = before.velocity != after.velocity or before.joint_velocities != after.joint_velocities
    if before.pose == after.pose and not (speeds or joints or details) and carrier[0] == carrier[1]:
        return None
    return BodyChange(
        a.name,
        before.name,
        before.pose,
        after.pose,
        math.dist(before.position, after.position),
        turn(before.orientation, after.orientation),
        joints,
        carrier,
        details,
    )


# --- as JSON data and as text ----------------------------------------------------------------------------------------


@report.data.register(Difference)
def _difference_data(delta: Difference) -> dict[str, object]:
    return {
        "opened": delta.opened,
        "closed": delta.closed,
        "came": [{"world": world, "object": body} for world, body in delta.added],
        "went": [{"world": world, "object": body} for world, body in delta.removed],
        "changed": report.data(delta.changed),
        "facts": [{"world": world, "fact": name, "values": pair} for (world, name), pair in delta.facts.items()],
    }


@report.data.register(BodyChange)
def _body_change_data(change: BodyChange) -> dict[str, object]:
    joints = {name: [None if math.isnan(value) else value for value in pair] for name, pair in change.joints.items()}
    carrier = [held and {"object": held.carrier, "link": held.carrier_link} for held in change.carrier]
    return report.fields_data(change, body="object") | {"joints": joints, "carrier": carrier, "notable": change.notable}


def difference_lines(delta: Difference, *, whole: bool = False) -> Iterator[str]:
    """Yield the text of a difference. With ``whole``, the text includes settling objects and every joint."""
    yield from (f"{world} was opened" for world in delta.opened)
    yield from (f"{world} was closed" for world in delta.closed)
    yield from (f"{body} is new" for _, body in delta.added)
    yield from (f"{body} is gone" for _, body in delta.removed)
    for (world, name), (before, after) in delta.facts.items():
        yield f"{world}: {name} {_plain(before)} -> {_plain(after)}"
    shown = delta.changed if whole else delta.notable
    for change in shown:
        changes = []
        if change.moved or (whole and (change.distance or change.angle)):
            is_turned = change.angle > 0 and (whole or change.angle >= _MIN_TURN)
            turned = f", turned by {phrases.degrees(change.angle)}" if is_turned else ""
            before, after = phrases.vectors(change.before[0], change.after[0])
            changes.append(f"moved by {phrases.length(change.distance)}{turned}: {before} -> {after}")
        if change.carrier_changed:
            holder, former = change.carrier[1], change.carrier[0]
            changes.append(f"now held by {_carrier(holder)}, before by {_carrier(former)}")
        changes += [f"has another {detail}" for detail in change.details]
        joints = change.joints if whole else change.moved_joints
        if len(joints) > _MAX_LISTED and not whole:
            changes.append(
                f"{len(joints)} joints moved, farthest "
                + _joint(*max(joints.items(), key=lambda item: abs(item[1][1] - item[1][0])))
            )
            joints = {}
        changes += [_joint(name, pair) for name, pair in joints.items()]
        if len(changes) == 1:
            yield f"{change.body} {changes[0]}"
        else:
            yield change.body
            yield from (f"  {line}" for line in changes)
    rest = len(delta.changed) - len(shown)
    if rest:
        yield (
            f"{rest} other objects settled by less than 1 mm" if shown else f"{rest} objects settled by less than 1 mm"
        )
    if not delta:
        yield "no difference"


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return phrases.vector(value)
    if value is None:
        return "unknown"
    return phrases.number(value) if isinstance(value, float) else str(value) or "none"


def _joint(name: str, pair: tuple[float, float]) -> str:
    before, after = phrases.apart(*pair)
    return f"{name} {before} -> {after}"


def _carrier(held: Attachment | None) -> str:
    return "nothing" if held is None else phrases.carrier(held)


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first record that differs between two runs."""

    first: Record | None  # the record of the first run; None if only the second run has the record
    second: Record | None  # the record of the second run; None if only the first run has the record
    task: str  # path of the task; "" outside of tasks
    fields: dict[str, tuple[Plain, Plain]]  # different values, by path of the field


@dataclass(frozen=True, slots=True)
class Comparison:
    """A comparison of two runs."""

    equal: int  # number of equal records before the first difference
    divergence: Divergence | None
    difference: Difference  # difference of the final states, before worlds were closed
    outcomes: tuple[Summary, Summary]


def compare_recordings(first: RecordReader, second: RecordReader, tolerance: float = 0.0) -> Comparison:
    """Compare two recordings. Numbers within the tolerance are equal."""
    names = PairedNames(first, second)
    equal, divergence = _divergence(first, second, tolerance, names)
    ends = state_at(first, first.final_step()), state_at(second, second.final_step())
    return Comparison(equal, divergence, difference(*ends, names.worlds), (summary(first), summary(second)))


def divergence(first: RecordReader, second: RecordReader) -> Divergence | None:
    """Return the first record that differs between two recordings; None without a difference."""
    return _divergence(first, second, 0.0, PairedNames(first, second))[1]


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
            explaining[side] |= _explains_choice(record)
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
    return equal, _first_divergence(first, second, diverged, waiting, explaining)


def _first_divergence(
    first: RecordReader,
    second: RecordReader,
    diverged: _Diverged | None,
    waiting: Sequence[Mapping[_Key, Record]],
    explaining: Sequence[bool],
) -> Divergence | None:
    """Return the earliest divergence: two different records, or a record of only one run.

    Records that explain a choice are ignored if the other run has no such records.
    """
    candidates: list[_Diverged] = [] if diverged is None else [diverged]
    for side, unmatched in enumerate(waiting):
        alone = next((each for each in unmatched.values() if explaining[1 - side] or not _explains_choice(each)), None)
        if alone is not None:
            candidates.append((None, alone, {}) if side else (alone, None, {}))
    if not candidates:
        return None
    a, b, fields = min(candidates, key=lambda each: sorted(record.seq for record in each[:2] if record is not None))
    log, record = (second, b) if a is None else (first, a)
    tasks = causing_tasks(log, record).tasks if record is not None else ()
    return Divergence(a, b, "/".join(task.started.name for task in reversed(tasks)), fields)


def _keyed(log: RecordReader, names: PairedNames, run: int) -> Iterator[tuple[_Key, Record]]:
    """Yield records with their keys. Memory contains only running tasks."""
    paths: dict[int, int] = {}  # hashes of paths, by id of the task
    counts: dict[int, int] = {}  # number of records, by path
    parts: dict[int, dict[tuple[str, str], int]] = {}  # number of tasks, by path of the parent task, kind and name
    for record in log:
        names.note(run, record)
        if isinstance(record, Task) and record.phase == Task.STARTED:
            outer = paths.get(record.parent, 0)
            name = record.kind, names.text(record.name) if run else record.name
            siblings = parts.setdefault(outer, {})
            siblings[name] = siblings.get(name, 0) + 1
            paths[record.task] = hash((outer, *name, siblings[name]))
        path = paths.get(record.task, 0)
        if _explains_choice(record):  # counted separately, because early recordings lack these records
            path = _path_of_explanations(path)
        elif isinstance(record, Mutation | Fluent) and record.by_fork:  # records of the plan are numbered separately
            path = hash((path, "by the fork"))
        counts[path] = counts.get(path, 0) + 1
        yield (path, counts[path]), record
        if isinstance(record, Task) and record.phase == Task.FINISHED:
            paths.pop(record.task, None)
            counts.pop(path, None)
            counts.pop(_path_of_explanations(path), None)
            parts.pop(path, None)


def _path_of_explanations(path: int) -> int:
    return hash((path, "explaining"))


def _explains_choice(record: Record) -> bool:
    """Return whether a record explains a choice or requests the solution of a designator."""
    return isinstance(record, Query) and (is_choice(record) or record.name in _REQUESTS)


def is_worded_alike(log: RecordReader) -> bool:
    """Return whether the code of PyCRAM that made a recording runs now, so that its messages have the same words."""
    began = log[0]
    return isinstance(began, Run) and began.pycram.sha256 == pycram_revision().sha256


def signature(failure: str, *, worded: bool) -> str:
    """Return the compared part of "TYPE: MESSAGE": no numbers; only the type unless :func:`is_worded_alike`."""
    return _NUMBER.sub("#", failure) if worded else failure.partition(":")[0]


def differing(
    first: Record, second: Record, tolerance: float = 0.0, names: PairedNames | None = None, *, worded: bool = True
) -> dict[str, tuple[Plain, Plain]]:
    """Return the different values of two records by path of the field. Numbers within the tolerance are equal."""
    if type(first) is not type(second):
        return {"kind": (kind_of(first), kind_of(second))}
    a, b = _without_incidental_fields(first), _without_incidental_fields(second)
    for each in (a, b):
        if not worded and isinstance(each, Run | Task | Query | Refusal) and each.HasField("failure"):
            each.failure.CopyFrom(Failure(type=each.failure.type))  # the data contain parts of the message
    if isinstance(a, Task) and isinstance(b, Task) and a.HasField("decision") != b.HasField("decision"):
        a.ClearField("decision")  # early recordings lack the field ``decision``
        b.ClearField("decision")
    if isinstance(a, Query) and isinstance(b, Query) and a.HasField("chosen") != b.HasField("chosen"):
        for query in (a, b):  # early recordings lack the field ``candidates``
            query.ClearField("candidates")
            query.ClearField("chosen")
    if a == b and a.SerializeToString(deterministic=True) == b.SerializeToString(deterministic=True):
        return {}  # bytes distinguish -0.0 from 0.0
    after = record_data(b)
    if names is not None and names.any:
        after = {key: names.data(value, key) for key, value in after.items()}
    return dict(leaves(record_data(a), after, "", tolerance))


def _without_incidental_fields(record: Record) -> Record:
    bare = type(record)()
    bare.CopyFrom(record)  # type: ignore[arg-type]
    for name in _INCIDENTAL:
        if name in bare.DESCRIPTOR.fields_by_name:
            bare.ClearField(name)
    if isinstance(bare, Run | Task | Query | Refusal) and bare.HasField("failure"):
        bare.failure.ClearField("traceback")
        del bare.failure.frames[:]
    if isinstance(bare, Run):
        for name in _GIVEN:
            bare.ClearField(name)
    if isinstance(bare, Task) and '"recording"' in bare.result_json:
        with suppress(ValueError):
            bare.result_json = json.dumps(_without_recordings(json.loads(bare.result_json)))
    return bare


def _without_recordings(result: Plain) -> Plain:
    """Return the result of a task; file names of projections are removed, because they contain the name of the run."""
    if isinstance(result, list):
        return [_without_recordings(each) for each in result]
    if isinstance(result, dict):
        outcome = {"recording", "succeeded", "duration"} <= result.keys()
        return {
            key: _without_recordings(value) for key, value in result.items() if not (outcome and key == "recording")
        }
    return result


def leaves(a: Plain, b: Plain, name: str, tolerance: float) -> Iterator[tuple[str, tuple[Plain, Plain]]]:
    """Yield the parts of two values that differ, by path; numbers within the tolerance are equal."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in {**a, **b}:
            yield from leaves(a.get(key), b.get(key), f"{name}.{key}" if name else key, tolerance)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for at, pair in enumerate(zip(a, b, strict=True)):
            yield from leaves(*pair, f"{name}[{at}]", tolerance)
    elif isinstance(a, str) and isinstance(b, str):
        if a != b and without_addresses(a) != without_addresses(b):
            yield name, (a, b)
    elif a != b and not (isinstance(a, int | float) and isinstance(b, int | float) and abs(a - b) <= tolerance):
        yield name, (a, b)


_NUMBERED: Final = re.compile(r"\b(world|fluent)_([1-9]\d*)\b")
_WAITS: Final = frozenset({"wait", "whenever"})  # tasks of these kinds are named after fluents


class PairedNames:
    """A translator from names of the second run to names of the first run."""

    def __init__(self, first: RecordReader, second: RecordReader) -> None:
        opened = (list(dict.fromkeys(lifetime.world for lifetime in log.lifetimes)) for log in (first, second))
        self.worlds = dict(_paired_worlds(*opened))  # names in the first run, by name in the second run if both differ
        self._offsets: list[int | None] = [None, None]  # number of the first numbered fluent of each run

    def note(self, run: int, record: Record) -> None:
        """Read a record of run 0 or 1 before its comparison. The first numbered fluent determines the offset."""
        if self._offsets[run] is None and (
            isinstance(record, Fluent) or (isinstance(record, Task) and record.kind in _WAITS)
        ):
            numbers = [int(number) for word, number in _NUMBERED.findall(record.name) if word == "fluent"]
            self._offsets[run] = min(numbers, default=None)

    @property
    def any(self) -> bool:
        """Whether any name has differed so far."""
        return bool(self.worlds) or self._shift != 0

    @property
    def _shift(self) -> int:
        before, after = self._offsets
        return before - after if before is not None and after is not None else 0

    def text(self, text: str) -> str:
        """Return a text of the second run with the names of the first run."""
        return _NUMBERED.sub(self._renamed, text)

    def _renamed(self, match: re.Match[str]) -> str:
        if match[1] == "world":
            return self.worlds.get(match[0], match[0])
        return f"fluent_{int(match[2]) + self._shift}"

    def data(self, value: Plain, key: str = "") -> Plain:
        """Return data of the second run with the names that the first run uses."""
        if isinstance(value, dict):
            return {self.text(name): self.data(item, name) for name, item in value.items()}
        if isinstance(value, list):
            return [self.data(item) for item in value]
        if isinstance(value, str):
            return self.worlds[value] if key == "world" and value in self.worlds else self.text(value)
        return value


def _paired_worlds(first: list[str], second: list[str]) -> Iterable[tuple[str, str]]:
    """Yield pairs of different names of worlds: the name in the second run and the name in the first run."""
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


def comparison_lines(compared: Comparison, *, whole: bool) -> Iterator[str]:
    """Yield the text of a comparison. With ``whole``, the text includes settling objects and every joint."""
    first, second = compared.outcomes
    if compared.divergence is None:
        yield f"the runs are equal: {compared.equal} records"
    else:
        yield from _divergence_lines(compared.divergence, compared.equal)
    if compared.difference:
        yield ""
        yield "at the end, first -> second:"
        yield from (f"  {line}" for line in difference_lines(compared.difference, whole=whole))
    ends = _ended(first), _ended(second)
    yield ""
    yield f"both {ends[0]}" if ends[0] == ends[1] else f"the first {ends[0]}; the second {ends[1]}"


def _ended(run: Summary) -> str:
    verbs = {"cut off": "was cut off", "running": "hadn't ended", "lost": "lost its end"}
    return verbs.get(run.outcome) or _outcome(run)


def _outcome(run: Summary) -> str:
    return run.outcome + (f" ({run.failure})" if run.failure else "")


def _divergence_lines(divergence: Divergence, equal: int) -> Iterator[str]:
    where = f" in {divergence.task}" if divergence.task else ""
    yield f"the runs are equal for {equal} records, then they diverge{where}:"
    for name, record in (("first", divergence.first), ("second", divergence.second)):
        line = f"step {record.seq}: {phrases.short(phrases.record_line(record))}" if record is not None else ""
        yield f"  {name:6} {line or 'has no such record'}"
    for name, (before, after) in list(divergence.fields.items())[:_MAX_LISTED]:
        apart = f"  (by {abs(after - before):.3g})" if isinstance(before, float) and isinstance(after, float) else ""
        yield f"    {name}: {phrases.value(before)} -> {phrases.value(after)}{apart}"
    if len(divergence.fields) > _MAX_LISTED:
        yield f"    ... {len(divergence.fields) - _MAX_LISTED} more values"
