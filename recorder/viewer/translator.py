"""Translate records into rows for the viewer, live and afterwards, and lay out its views."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

import rerun as rr
import rerun.blueprint as rrb
from rerun import new_entity_path
from rerun.blueprint.components import PlayState

from recorder.geometry import Vector
from recorder.records import Check, Fluent, Keyframe, Mutation, Output, Query, Record, Run, Task
from recorder.records.beliefs import is_look
from recorder.records.motion import ROOT
from recorder.records.text import text_of
from recorder.records.values import AssetFile
from recorder.viewer.marks import FAILURES, Attachments, CameraFrustums, TaskMarks, TrajectoryPaths
from recorder.viewer.queries import PAGE, PICTURE, QUERIES, QueryMarks, QueryPage, QueryPicture, QueryPlaces
from recorder.viewer.rerun_stream import STEP, Columns, TimePoint, sim_ns, up_to
from recorder.viewer.scene import COLLISION, ViewerScene
from recorder.viewer.tables_and_plots import (
    FLUENTS,
    HEIGHTS,
    JOINTS,
    KINDS,
    LOG,
    PROPERTIES,
    RECORDS,
    FoldedWorlds,
    LogLines,
    Plots,
    RecordTables,
)
from recorder.viewer.tasks import GRAPH, LANES, TaskGraph, TaskTimeline

_BATCH: Final = 20_000  # number of records in a batch; smaller batches take more time, and larger batches more memory
_MOTIONS: Final = ("move_body", "move_joints", "simulate")  # commands that neither add nor remove bodies


class Translator:
    """Translates records, and shows them in a viewer; not thread-safe.

    ``root`` is the root entity, and the prefix of all frames. ``folds`` is whether beliefs and properties are shown,
    which takes time for each record. ``partings`` has the names of other runs, by the first step that differs there.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        root: str = "",
        *,
        folds: bool = True,
        until: int | None = None,
        partings: Mapping[int, Sequence[str]] = MappingProxyType({}),
    ) -> None:
        columns = self._columns = Columns(stream, root, until)
        self._partings = partings
        self._first: TimePoint | None = None
        self._lines, self._tables = LogLines(columns), RecordTables(columns)
        self._timeline, self._graph = TaskTimeline(columns), TaskGraph(columns)
        self._page = QueryPage(columns)
        scene = self.scene = ViewerScene(columns, f"{root}/" if root else "")
        self._plots, self.worlds = Plots(columns), ActiveWorlds(scene)
        self._folded = FoldedWorlds(columns, scene, self._plots) if folds else None
        self._attachments, self._cameras = Attachments(columns, scene), CameraFrustums(columns, scene)
        self._paths = TrajectoryPaths(columns, scene)
        self._task_marks, self._query_marks = TaskMarks(columns, scene), QueryMarks(columns, scene)
        self._picture, self._places = QueryPicture(columns, scene), QueryPlaces(columns, scene)
        self._sim_ns = 0  # simulated time of the latest record with a world
        self._previous_ns = 0  # wall time of the record before
        self._waiting = 0  # number of records in the buffers
        self._shown: dict[type[Record], Callable[[Any, TimePoint], None]] = {
            Task: self._show_task,
            Mutation: self._show_change,
            Keyframe: self._show_change,
            Query: self._show_query,
            Run: self._show_run,
            Fluent: self._plots.show_fluent,
            Check: self._show_check,
        }

    def layout(self, front: str, eye: tuple[Vector, Vector] | None = None) -> Layout:
        """Return the layout of the views, as it is known so far."""
        return Layout(self.worlds.centres, front, len(self._timeline.lanes), eye)

    def attach(self, asset: AssetFile) -> None:
        """Take an attached file; models and meshes must come before the records that use them."""
        self.scene.attach(asset)

    def show(self, record: Record) -> None:
        """Translate the next record. Rows are sent in batches; :meth:`flush` sends all."""
        if record.world:
            self._sim_ns = sim_ns(record.sim_step)
        now = TimePoint(record.seq, self._sim_ns, record.wall_time_ns)
        self._first = self._first or now
        for other in self._partings.get(record.seq, ()):
            self._timeline.show_parting(other, self._first, now)
            self._lines.show_parting(other, now)
        text, level = text_of(record)
        self._lines.show(record, text, level, now)
        self._tables.show(record, text, now)
        shown = self._shown.get(type(record))
        if shown is not None:
            shown(record, now)
        if record.world and type(record) is not Output:  # a plan may print before it acts in a world
            self.worlds.follow(record)
        self._previous_ns = now.wall
        self._waiting += 1
        if self._waiting >= _BATCH:
            self.flush()

    def flush(self) -> None:
        """Send all buffered rows."""
        self._columns.flush()
        self._waiting = 0

    def finish(self) -> None:
        """Add the worlds in which no plan has acted, and send all buffered rows."""
        self.worlds.add_others()
        self.flush()

    def _show_query(self, record: Query, now: TimePoint) -> None:
        self._page.show(record, now)
        self._picture.show(record, now)
        self._query_marks.show(record, now)
        self._places.show(record, now)
        if self._folded is not None and is_look(record):
            self._folded.show(record, now, lambda _: now)

    def _show_run(self, record: Run, now: TimePoint) -> None:
        if record.phase == Run.STARTED:
            self._graph.plan = record.name
        self._task_marks.show_end(record, self.worlds.front, now)

    def _show_check(self, record: Check, _: TimePoint) -> None:
        if self._folded is not None:
            self._folded.watch(record)

    def _show_task(self, record: Task, now: TimePoint) -> None:
        self._timeline.show(record, now)
        self._graph.show(record, now)
        self._task_marks.show(record, now)
        if record.status == Task.FAILED:
            self._query_marks.hide_label(now)
        if record.phase == Task.STARTED:
            self._query_marks.clear(now)
            if record.kind == "motion":  # the next motion uses the taken place
                self._places.clear(now)

    def _show_change(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        world, end = record.world, record.sim_step
        effect = record.effect if isinstance(record, Mutation) else None  # reading the field is slow
        only_moves = isinstance(record, Mutation) and record.WhichOneof("command") in _MOTIONS
        motions = self.scene.frames.motions(record)
        if not only_moves or world not in self.scene.bodies:
            self.scene.begin(record, now)
        steps = max(record.simulate.steps, 1) if isinstance(record, Mutation) else 1
        previous = self._previous_ns

        def time_of(step: int) -> TimePoint:
            share = min(max((step - end + steps) / steps, 0.0), 1.0)  # of the wall time since the previous record
            wall = previous + round((now.wall - previous) * share)
            return now if step == end else TimePoint(now.step, sim_ns(step), wall)

        step, time = end, now
        for motion in motions:
            if motion.sim_step != step:
                step = motion.sim_step
                time = time_of(step)
            body = self.scene.move(world, motion, time)
            if body is not None:
                self._plots.show(world, body, motion, time)
                self._paths.move(world, motion.body, time)
        self._paths.show(record, now)
        if not only_moves or effect is None or effect.attached or effect.detached:
            self._attachments.show(record, now)
            self._cameras.show(world, now)
        if self._folded is not None:
            self._folded.show(record, now, time_of)


_SETUP: Final = ("open_world", "load_body", "set_gravity", "set_realtime", "set_robot", "set_color")
_CLOSE: Final = "close_world"
_KEYFRAME: Final = "keyframe"


class ActiveWorlds:
    """The worlds in which plans have acted so far."""

    def __init__(self, scene: ViewerScene) -> None:
        self._scene = scene
        self._open: dict[str, None] = {}  # open worlds in which a plan has acted
        self.centres: dict[str, Vector] = {}  # centres of worlds in m when plans began to act in them
        self.front = ""  # the first of these worlds; "" before a plan acts

    def follow(self, record: Record) -> None:
        """Add a world when a plan begins to act there, or remove a closed world. The scene already shows the record."""
        world, action = record.world, _action(record)
        if world not in self.centres and action not in _SETUP:
            self.centres[world] = self._scene.centre(world)
        if world in self._open:
            if action != _CLOSE:
                return
            del self._open[world]
        elif _is_act(action):
            self._open[world] = None
        self.front = next(iter(self._open), self.front)

    def add_others(self) -> None:
        """Add the worlds in which no plan has acted."""
        for world in self._scene.bodies:
            self.centres.setdefault(world, self._scene.centre(world))


def acts(record: Record) -> bool:
    """Return whether a plan acts in the record's world. Opening, filling and closing a world don't count as acting."""
    return bool(record.world) and _is_act(_action(record))


def _is_act(action: str) -> bool:
    return action not in (*_SETUP, _CLOSE, _KEYFRAME)


def _action(record: Record) -> str:
    """Return the change of a record: a mutation's command or "keyframe"; "" if it has none."""
    if type(record) is Mutation:  # isinstance would take five times as long for other types
        return record.WhichOneof("command") or "change"  # "change" stands for a command that only another release knows
    return _KEYFRAME if type(record) is Keyframe else ""


ORIGIN: Final = (0.0, 0.0, 0.0)
_WORLD: Final = "world_1"  # default name of the first world
_EYE: Final = (-2.6, -2.6, 2.3)  # position in m, relative to a world's centre
#: Heights in the view of tasks, as shares of a window of 1080 pixels: title, lane, minimum and maximum height.
_TITLE, _LANE, _MIN_LANES, _MAX_LANES = 0.05, 0.04, 0.28, 0.5


@dataclass(frozen=True, slots=True)
class Layout:
    """The data that determine the views of a recording."""

    worlds: Mapping[str, Vector] = field(default_factory=dict)  # known centres of worlds in m, by world
    front: str = ""  # the world whose tab is open
    lanes: int = 0  # number of lanes of tasks
    eye: tuple[Vector, Vector] | None = None  # viewpoint in the world in front, and the middle of its picture, m


def blueprint(layout: Layout, until: int | None = None) -> rrb.Blueprint:
    """Return the views of a recording. The viewer opens at the step ``until`` of the stream, by default at the end."""
    left, right = _scenes("", layout), _details("", layout.worlds)
    return _whole(rrb.Horizontal(left, right, column_shares=[3, 2]), until)


def side_by_side(layouts: Mapping[str, Layout], until: int | None = None) -> rrb.Blueprint:
    """Return the views of compared recordings by root entity, as :func:`blueprint` does."""
    columns = [
        rrb.Vertical(_scenes(root, layout), _details(root, layout.worlds), row_shares=[3, 2], name=root)
        for root, layout in layouts.items()
    ]
    return _whole(rrb.Horizontal(*columns), until)


def _whole(views: rrb.Container, until: int | None) -> rrb.Blueprint:
    # no option sets the viewer's first step, but the viewer follows the end of a time line, so this line ends there
    timeline = STEP if until is None else up_to(until)
    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline=timeline, play_state=None if until is None else PlayState.Following, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scenes(root: str, layout: Layout) -> rrb.Container:
    """Return the views of the scenes and of the tasks over time."""
    named = sorted((layout.worlds or {_WORLD: ORIGIN}).items(), key=lambda world: world[0] != layout.front)
    scenes = [_scene(root, world, centre, layout.eye if world == layout.front else None) for world, centre in named]
    timeline = rrb.StateTimelineView(origin=f"{_path(root)}/{LANES}", name="Tasks over time")
    share = min(max(_TITLE + _LANE * layout.lanes, _MIN_LANES), _MAX_LANES)
    return rrb.Vertical(rrb.Tabs(*scenes, active_tab=0), timeline, row_shares=[1.0 - share, share])


def _details(root: str, worlds: Mapping[str, Vector]) -> rrb.Container:
    """Return the views of the task tree and queries, above the log, curves and tables."""
    top = _path(root)
    log = [f"{top}/{LOG}/**", *(f"{_path(root, world)}/{FAILURES}" for world in worlds)]
    return rrb.Vertical(
        rrb.Tabs(
            rrb.GraphView(origin=f"{top}/tasks/{GRAPH}", name="Task tree"),
            rrb.TextDocumentView(origin=f"{top}/{QUERIES}/{PAGE}", name="Query"),
            rrb.Spatial2DView(origin=f"{top}/{QUERIES}/{PICTURE}", name="What it saw"),
        ),
        rrb.Tabs(
            rrb.TextLogView(origin="/", contents=log, name="Log", columns=rrb.TextLogColumns(timeline_columns=[STEP])),
            rrb.TimeSeriesView(origin=f"{top}/plots/{HEIGHTS}", name="Heights"),
            rrb.TimeSeriesView(
                origin=f"{top}/plots/{JOINTS}", name="Joints", plot_legend=rrb.PlotLegend(visible=False)
            ),
            rrb.TimeSeriesView(origin=f"{top}/plots/{FLUENTS}", name="Fluents"),
            rrb.TimeSeriesView(origin=f"{top}/plots/{PROPERTIES}", name="Properties (violated below 0)"),
            rrb.Tabs(
                *(rrb.DataframeView(origin=f"{top}/{RECORDS}/{kind}", name=kind) for kind in KINDS), name="Records"
            ),
        ),
    )


def _scene(root: str, world: str, centre: Vector, eye: tuple[Vector, Vector] | None) -> rrb.Spatial3DView:
    path = _path(root, world)
    x, y, z = centre
    viewpoint, middle = eye or ((x + _EYE[0], y + _EYE[1], z + _EYE[2]), centre)
    return rrb.Spatial3DView(
        origin="/",
        contents=[f"{path}/**"],
        name=f"{root} {world}".strip(),
        eye_controls=rrb.EyeControls3D(position=viewpoint, look_target=middle),
        spatial_information=rrb.SpatialInformation(target_frame=f"{root}/{ROOT}" if root else ROOT),
        overrides={f"{path}/{COLLISION}": rrb.EntityBehavior(visible=False)},
    )


def _path(*parts: str) -> str:
    """Return the path of an entity. Names of worlds and recordings may contain any characters."""
    named = [part for part in parts if part]
    return new_entity_path(named) if named else ""
