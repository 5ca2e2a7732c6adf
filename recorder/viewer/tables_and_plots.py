"""The log, the tables of records, and curves over time.

The log has an entity for each kind of record, so that users can hide kinds. A ghost is a translucent copy of an object.
A ghost is shown while the believed position is more than 1 cm from the actual position. The curve of a property is the
margin of its expression, which is negative while the expression doesn't hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, TypeAlias, get_args

import pyarrow as pa
import rerun as rr
from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder import notebook
from recorder.geometry import Pose
from recorder.properties.expressions import BadProperty, NoValue, PropertyExpression, Scene
from recorder.properties.language import parse
from recorder.records import (
    TOPICS,
    Belief,
    Check,
    Event,
    Fluent,
    Keyframe,
    Mutation,
    Output,
    Query,
    Record,
    Refusal,
    Run,
    Subscription,
    Task,
    format_failure,
    from_json,
)
from recorder.records.fold import FoldedWorld, apply, quaternion, vector
from recorder.records.text import by_name, has_line, values
from recorder.viewer.marks import Marks, points_at
from recorder.viewer.rerun_stream import RED, VIOLET, YELLOW, Columns, Series, TimePoint
from recorder.viewer.scene import ViewerScene

if TYPE_CHECKING:
    from google.protobuf.internal.enum_type_wrapper import EnumTypeWrapper

    from recorder.records.motion import BodyMotion
    from recorder.viewer.scene import SceneBody


LOG: Final = "log"
_COLORS: Final = {"ERROR": [RED], "WARN": [YELLOW]}  # the viewer's own colours are too dark
_LEVELS: Final = {Log.DEBUG: "DEBUG", Log.INFO: "INFO", Log.WARNING: "WARN", Log.ERROR: "ERROR"}


class LogLines:
    """The lines of all records."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._lines = {kind: columns.series(columns.path(LOG, topic[1:]), _lines) for kind, topic in TOPICS.items()}

    def show(self, record: Record, text: str, level: Log.Level.ValueType, now: TimePoint) -> None:
        """Add the line of a record, if it has one."""
        if has_line(record):
            self._lines[type(record)].add(now, (text, _LEVELS[level]))

    def show_parting(self, other: str, now: TimePoint) -> None:
        """Add a line where the run begins to differ from another run."""
        line = rr.TextLog(f"the first difference from {other}", level="WARN", color=YELLOW)
        self._columns.send(self._columns.path(LOG, "difference"), now, line)


def _lines(rows: Sequence[tuple[Any, ...]]) -> list[rr.ComponentColumn]:
    text, levels = zip(*rows, strict=True)
    colors = [_COLORS.get(level, []) for level in levels]
    colored = rr.TextLog.columns(color=[*chain.from_iterable(colors)]).partition([*map(len, colors)])
    return [*rr.TextLog.columns(text=pa.array(text), level=pa.array(levels)), *colored]


RECORDS: Final = "records"


def _word(enum: EnumTypeWrapper, number: int) -> str:
    return enum.Name(number).lower() if number in enum.values() else str(number)


def _line(file: str, line: int) -> str:
    """Return the place of a line; folders are left out, because columns are narrow."""
    return notebook.place(file.rpartition("/")[2], line)


_COLUMNS: Final[Mapping[type[Record], tuple[str, ...]]] = {
    Task: ("kind", "name", "status", "parent", "parameters", "failure", "duration_ms", "callers"),
    Mutation: ("command", "bodies", "callers"),
    Event: ("name", "sender", "arguments", "handlers", "callers"),
    Subscription: ("name", "sender", "handler", "removed", "callers"),
    Fluent: ("name", "before", "after", "callers"),
    Query: ("name", "arguments", "answer", "evidence", "failure", "duration_ms", "callers"),
    Refusal: ("name", "arguments", "failure", "callers"),
    Run: ("phase", "name", "succeeded", "failure"),
    Output: ("stream", "level", "logger"),
    Check: ("phase", "property", "step", "margin", "values", "callers"),
}
"""Columns of each table, after the columns that all tables have."""

_CELLS: Final[Mapping[str, Callable[[Any], object]]] = {
    "after": lambda record: by_name(record.after_json),
    "answer": lambda record: by_name(record.answer_json),
    "arguments": lambda record: values(record.arguments),
    "before": lambda record: by_name(record.before_json),
    "bodies": lambda record: ", ".join([state.body for state in record.effect.bodies[:]]),
    "callers": lambda record: ", ".join(
        [_line(caller.file or record.source_file, caller.line) for caller in record.callers[:]]
    ),
    "command": lambda record: record.WhichOneof("command") or "change",
    "duration_ms": lambda record: record.duration_ns / 1e6,
    "evidence": lambda record: values(record.evidence),
    "failure": lambda record: format_failure(record.failure) if record.HasField("failure") else "",
    "handlers": lambda record: len(record.handlers),
    "parameters": lambda record: values(record.parameters),
    "margin": lambda record: record.margin if record.HasField("margin") else 0.0,
    "phase": lambda record: _word((Check if isinstance(record, Check) else Run).Phase, record.phase),
    "values": lambda record: values(record.values),
    "status": lambda record: _word(Task.Status, record.status) if record.status else "running",
}
"""Values of those columns that aren't fields of records."""

_COMMON: Final = ("world", "task", "thread", "cause", "text")
_Sourced: TypeAlias = Task | Mutation | Event | Subscription | Fluent | Query | Refusal | Check
_SOURCED: Final = (*get_args(_Sourced), Output)
"""Types of records with a line of the plan. A record has no line if its task has the same line."""

KINDS: Final = tuple(TOPICS[kind].removeprefix("/") for kind in _COLUMNS)  # names of the tables


class RecordTables:
    """A table for each type of record; keyframes have none, because they contain no new facts."""

    def __init__(self, columns: Columns) -> None:
        self._tables = {
            kind: (
                columns.series(columns.path(RECORDS, TOPICS[kind].removeprefix("/")), partial(_rows, kind)),
                [_CELLS.get(name, attrgetter(name)) for name in names],
            )
            for kind, names in _COLUMNS.items()
        }
        self._sources: dict[int, str] = {}  # call sites of the running tasks, by id

    def show(self, record: Record, text: str, now: TimePoint) -> None:
        """Add a record with its line of text."""
        table = self._tables.get(type(record))
        if table is None:
            return
        series, cells = table
        row = (record.world, record.task, record.thread, record.cause, text, *[cell(record) for cell in cells])
        series.add(now, (*row, self._source(record)) if isinstance(record, _SOURCED) else row)

    def _source(self, record: _Sourced | Output) -> str:
        """Return the call site of a record or of its task."""
        source = _line(record.source_file, record.source_line) if record.source_file else ""
        source = source or self._sources.get(record.task, "")
        if type(record) is Task:
            if record.phase == Task.FINISHED:
                self._sources.pop(record.task, None)
            else:
                self._sources[record.task] = source
        return source


def _rows(kind: type[Record], rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    names = (*_COMMON, *_COLUMNS[kind], *(("source",) if kind in _SOURCED else ()))
    components = {name: pa.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
    return rr.DynamicArchetype.columns(archetype=f"pycram.{kind.__name__}", components=components)


HEIGHTS: Final = "heights"
JOINTS: Final = "joints"
FLUENTS: Final = "fluents"
PROPERTIES: Final = "properties"
_STEPS: Final = rr.components.InterpolationMode.StepAfter  # each value is valid until the next record


class Plots:
    """A curve for each changing height of a body in m, moving joint in rad or m, fluent and property."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._last: dict[tuple[str, ...], tuple[TimePoint, float]] = {}
        self._series: dict[tuple[str, ...], Series] = {}

    def show(self, world: str, body: SceneBody, motion: BodyMotion, now: TimePoint) -> None:
        """Add the changed values of a motion. The body must have moved before in the scene."""
        for joint, value in motion.joints.items():
            self.add((JOINTS, world, motion.body, joint), value, now)
        if not body.loaded.fixed_base:
            self.add((HEIGHTS, world, motion.body), body.pose[0][2], now)

    def show_fluent(self, record: Fluent, now: TimePoint) -> None:
        """Add an assignment. Values other than numbers and truth values have no curve."""
        before = now._replace(step=max(now.step - 1, 0))
        for value, time in ((record.before_json, before), (record.after_json, now)):
            number = from_json(value) if value else None
            if isinstance(number, int | float):
                self.add((FLUENTS, record.name), float(number), time)

    def add(self, key: tuple[str, ...], value: float, now: TimePoint) -> None:
        """Add a value to a curve unless it equals the last value. ``key`` has the curve's kind, and then its names."""
        last = self._last.get(key)
        if last is not None and last[1] == value:
            return
        self._last[key] = (now, value)
        if last is None:  # the curve begins with the first change
            return
        series = self._series.get(key)
        if series is None:
            path = self._columns.path("plots", *key)
            names = key[-1] if key[0] == PROPERTIES else None  # the viewer would escape the characters of a path
            self._columns.send_static(path, rr.SeriesLines(interpolation_mode=_STEPS, names=names))
            series = self._series[key] = self._columns.series(
                path, lambda rows: rr.Scalars.columns(scalars=[each for (each,) in rows])
            )
            series.add(last[0], (last[1],))
        series.add(now, (value,))


GHOSTS: Final = "beliefs"
_SOLID: Final = 0.45  # opacity of a ghost
_NEAR: Final = 0.01  # minimum error in m of a belief that has a ghost


class FoldedWorlds:
    """Ghosts and curves of properties, from the folded states of all worlds."""

    def __init__(self, columns: Columns, scene: ViewerScene, plots: Plots) -> None:
        self._columns, self._scene, self._plots = columns, scene, plots
        self._worlds: dict[str, FoldedWorld] = {}
        self._properties: dict[str, PropertyExpression] = {}  # watched properties, by text
        self._quantities = Scene(self._worlds)
        self._ghosts: dict[tuple[str, str, str], tuple[Pose, Marks]] = {}  # ghosts by world, robot and object

    def watch(self, record: Check) -> None:
        """Begin the curve of a watched property. Contacts need the executor, so their properties have no curve."""
        with suppress(BadProperty):  # a newer release may have recorded the property
            statement = parse(record.property)
            if not statement.needs_geometry:
                self._properties.setdefault(record.property, statement.body)

    def show(self, record: Mutation | Keyframe | Query, now: TimePoint, time_of: Callable[[int], TimePoint]) -> None:
        """Fold a record. ``time_of`` returns the time of a simulated step within the record."""
        if isinstance(record, Mutation) and self._properties and record.world in self._worlds:
            for sample in record.effect.samples:
                self._worlds[record.world].apply_sample(sample)
                self._plot(time_of(sample.sim_step))
        apply(self._worlds, record)
        self._plot(now)
        if (world := self._worlds.get(record.world)) is not None and world.open:
            wrong: dict[tuple[str, str, str], Pose] = {
                (world.name, robot, name): (vector(belief.position), quaternion(belief.orientation))
                for (robot, name), belief in world.beliefs.items()
                if belief.source != Belief.HELD
                and name in world.bodies
                and math.dist(belief.position, world.bodies[name].position) > _NEAR
            }
            for key, (pose, marks) in list(self._ghosts.items()):
                if key[0] == world.name and wrong.get(key) != pose:
                    marks.clear(now)
                    del self._ghosts[key]
            for key in wrong.keys() - self._ghosts.keys():
                _, robot, name = key
                pose, marks = self._ghosts[key] = wrong[key], Marks(self._columns, self._scene)
                red, green, blue = (channel / 255 for channel in VIOLET)
                for shape, archetypes in self._scene.ghost(world.name, name, pose, (red, green, blue, _SOLID)):
                    marks.add(world.name, (GHOSTS, robot, name, shape), now, *archetypes)
                label = points_at([pose[0]], VIOLET, [f"{robot} believes {name} here"])
                marks.add(world.name, (GHOSTS, robot, name), now, label)

    def _plot(self, now: TimePoint) -> None:
        for text, expression in self._properties.items():
            with suppress(NoValue):
                truth = expression.truth(self._quantities)
                margin = truth.margin if math.isfinite(truth.margin) else 1.0 if truth.holds else -1.0
                self._plots.add((PROPERTIES, text), margin, now)
