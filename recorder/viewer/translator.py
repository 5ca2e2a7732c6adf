"""Translate records into rows for the viewer, live and afterwards, and lay out its views."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun.blueprint as rrb
from rerun import new_entity_path

from recorder.records import Keyframe, Mutation, Output, Query, Run, Task
from recorder.records.motion import ROOT
from recorder.records.text import text_of
from recorder.viewer.marks import FAILURES, Attachments, CameraFrustums, TaskMarks, TrajectoryPaths
from recorder.viewer.queries import PAGE, PICTURE, QUERIES, QueryMarks, QueryPage, QueryPicture, QueryPlaces
from recorder.viewer.rerun_stream import Columns, TimePoint, sim_ns
from recorder.viewer.scene import COLLISION, ViewerScene
from recorder.viewer.tables_and_plots import HEIGHTS, JOINTS, KINDS, LOG, RECORDS, LogLines, Plots, RecordTables
from recorder.viewer.tasks import GRAPH, LANES, TaskGraph, TaskTimeline

if TYPE_CHECKING:
    from collections.abc import Mapping

    import rerun as rr

    from recorder.geometry import Vector
    from recorder.records import Record
    from recorder.records.values import AssetFile


_BATCH: Final = 20_000  # number of records in a batch; smaller batches take more time, larger batches more memory
_MOTIONS: Final = ("move_body", "move_joints", "simulate")  # commands that neither add nor remove bodies


class Translator:
    """A translator that shows records in a viewer; not thread-safe.

    ``root`` is the root entity and the prefix of frames.
    """

    def __init__(self, stream: rr.RecordingStream, root: str = "") -> None:
        columns = self._columns = Columns(stream, root)
        self._lines, self._tables = LogLines(columns), RecordTables(columns)
        self._timeline, self._graph = TaskTimeline(columns), TaskGraph(columns)
        self._page, self._picture = QueryPage(columns), QueryPicture(columns)
        scene = self.scene = ViewerScene(columns, f"{root}/" if root else "")
        self._plots, self.worlds = Plots(columns), ActiveWorlds(scene)
        self._attachments, self._cameras = Attachments(columns, scene), CameraFrustums(columns, scene)
        self._paths = TrajectoryPaths(columns, scene)
        self._task_marks, self._query_marks = TaskMarks(columns, scene), QueryMarks(columns, scene)
        self._places = QueryPlaces(columns, scene)
        self._sim_ns = 0  # simulated time of the latest record with a world
        self._previous_ns = 0  # wall time of the previous record
        self._waiting = 0  # number of records in the buffers

    def attach(self, asset: AssetFile) -> None:
        """Take an attached file; models and meshes must come before the records that use them."""
        self.scene.attach(asset)

    def show(self, record: Record) -> None:
        """Translate the next record. Rows are sent in batches, at the latest by :meth:`flush`."""
        if record.world:
            self._sim_ns = sim_ns(record.sim_step)
        now = TimePoint(record.seq, self._sim_ns, record.wall_time_ns)
        text, level = text_of(record)
        self._lines.show(record, text, level, now)
        self._tables.show(record, text, now)
        if type(record) is Task:  # isinstance takes five times as long for other types
            self._show_task(record, now)
        elif type(record) is Mutation or type(record) is Keyframe:
            self._show_change(record, now)
        elif type(record) is Query:
            self._page.show(record, now)
            self._picture.show(record, now)
            self._query_marks.show(record, now)
            self._places.show(record, now)
        elif type(record) is Run and record.phase == Run.STARTED:
            self._graph.plan = record.name
        if record.world and type(record) is not Output:  # a plan may print before it acts
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
        """Add the worlds in which no plan acted, and send all buffered rows."""
        self.worlds.add_others()
        self.flush()

    def _show_task(self, record: Task, now: TimePoint) -> None:
        self._timeline.show(record, now)
        self._graph.show(record, now)
        self._task_marks.show(record, now)
        if record.phase == Task.STARTED:
            self._query_marks.clear(now)
            if record.kind == "motion":  # the motion uses the taken place
                self._places.clear(now)

    def _show_change(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        world, end = record.world, record.sim_step
        effect = record.effect if isinstance(record, Mutation) else None  # access to the field is slow
        only_moves = isinstance(record, Mutation) and record.WhichOneof("command") in _MOTIONS
        motions = self.scene.motions(record)
        if not only_moves or world not in self.scene.bodies:
            self.scene.begin(record, now)
        step, time = end, now
        for motion in motions:
            if motion.sim_step != step:
                step = motion.sim_step
                steps = max(record.simulate.steps, 1) if isinstance(record, Mutation) else 1
                # fraction of the wall time since the previous record
                share = min(max((step - end + steps) / steps, 0.0), 1.0)
                wall = self._previous_ns + round((now.wall - self._previous_ns) * share)
                time = now if step == end else TimePoint(now.step, sim_ns(step), wall)
            body = self.scene.move(world, motion, time)
            if body is not None:
                self._plots.show(world, body, motion, time)
                self._paths.move(world, motion.body, time)
        self._paths.show(record, now)
        if not only_moves or effect is None or effect.attached or effect.detached:
            self._attachments.show(record, now)
            self._cameras.show(world, now)


_SETUP: Final = ("open_world", "load_body", "set_gravity", "set_realtime", "set_robot", "set_color")
_CLOSE: Final = "close_world"
_KEYFRAME: Final = "keyframe"


class ActiveWorlds:
    """The worlds in which plans have acted so far."""

    def __init__(self, scene: ViewerScene) -> None:
        self._scene = scene
        self._open: dict[str, None] = {}  # open worlds in which a plan acted
        self.centres: dict[str, Vector] = {}  # centres of worlds in m when plans began to act in them
        self.front = ""  # the first open world; "" before a plan acts

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
        """Add the worlds in which no plan acted."""
        for world in self._scene.bodies:
            self.centres.setdefault(world, self._scene.centre(world))


def acts(record: Record) -> bool:
    """Return whether a plan acts in the record's world. Opening, filling and closing a world don't count."""
    return bool(record.world) and _is_act(_action(record))


def _is_act(action: str) -> bool:
    return action not in (*_SETUP, _CLOSE, _KEYFRAME)


def _action(record: Record) -> str:
    """Return the change of a record: a mutation's command or "keyframe"; "" for other records."""
    if type(record) is Mutation:  # isinstance takes five times as long for other types
        return record.WhichOneof("command") or "change"  # "change" is a command of another release
    return _KEYFRAME if type(record) is Keyframe else ""


ORIGIN: Final = (0.0, 0.0, 0.0)
_WORLD: Final = "world_1"  # default name of the first world
_EYE: Final = (-2.6, -2.6, 2.3)  # position relative to a world's centre in m


def blueprint(worlds: Mapping[str, Vector], front: str = "") -> rrb.Blueprint:
    """Return the layout for a recording. ``worlds`` has the known centres in m. The tab of ``front`` is open."""
    left, right = _scenes("", worlds, front), _details("", worlds)
    return _whole(rrb.Horizontal(left, right, column_shares=[3, 2]))


def side_by_side(recordings: Mapping[str, Mapping[str, Vector]], fronts: Mapping[str, str]) -> rrb.Blueprint:
    """Return the layout for compared recordings. ``recordings`` has the known centres of worlds in m by root entity."""
    columns = [
        rrb.Vertical(_scenes(root, worlds, fronts[root]), _details(root, worlds), row_shares=[3, 2], name=root)
        for root, worlds in recordings.items()
    ]
    return _whole(rrb.Horizontal(*columns))


def _whole(views: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline="step", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scenes(root: str, worlds: Mapping[str, Vector], front: str) -> rrb.Container:
    """Return the views of the scenes and of the tasks over time."""
    named = sorted((worlds or {_WORLD: ORIGIN}).items(), key=lambda world: world[0] != front)
    scenes = [_scene(root, world, centre) for world, centre in named]
    timeline = rrb.StateTimelineView(origin=f"{_path(root)}/{LANES}", name="Tasks over time")
    return rrb.Vertical(rrb.Tabs(*scenes, active_tab=0), timeline, row_shares=[5, 2])


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
            rrb.TextLogView(origin="/", contents=log, name="Log"),
            rrb.TimeSeriesView(origin=f"{top}/plots/{HEIGHTS}", name="Heights"),
            rrb.TimeSeriesView(
                origin=f"{top}/plots/{JOINTS}", name="Joints", plot_legend=rrb.PlotLegend(visible=False)
            ),
            rrb.Tabs(
                *(rrb.DataframeView(origin=f"{top}/{RECORDS}/{kind}", name=kind) for kind in KINDS), name="Records"
            ),
        ),
    )


def _scene(root: str, world: str, centre: Vector) -> rrb.Spatial3DView:
    path = _path(root, world)
    x, y, z = (middle + offset for middle, offset in zip(centre, _EYE, strict=True))
    return rrb.Spatial3DView(
        origin="/",
        contents=[f"{path}/**"],
        name=f"{root} {world}".strip(),
        eye_controls=rrb.EyeControls3D(position=(x, y, z), look_target=centre),
        spatial_information=rrb.SpatialInformation(target_frame=f"{root}/{ROOT}" if root else ROOT),
        overrides={f"{path}/{COLLISION}": rrb.EntityBehavior(visible=False)},
    )


def _path(*parts: str) -> str:
    """Return the path of an entity. Names of worlds and recordings may have any characters."""
    named = [part for part in parts if part]
    return new_entity_path(named) if named else ""
