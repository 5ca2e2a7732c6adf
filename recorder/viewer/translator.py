"""Translates records into rows for the viewer, live and afterwards: gives each to the parts that show it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation, Output, Query, Run, Task
from recorder.records.text import text_of
from recorder.viewer.active_worlds import ActiveWorlds
from recorder.viewer.attachments import Attachments
from recorder.viewer.cameras import CameraFrustums
from recorder.viewer.columns import Columns, TimePoint, sim_ns
from recorder.viewer.log_lines import LogLines
from recorder.viewer.marks import QueryMarks, TaskMarks
from recorder.viewer.paths import TrajectoryPaths
from recorder.viewer.plots import Plots
from recorder.viewer.query_page import QueryPage
from recorder.viewer.query_picture import QueryPicture
from recorder.viewer.query_places import QueryPlaces
from recorder.viewer.record_tables import RecordTables
from recorder.viewer.scene import Scene
from recorder.viewer.task_graph import TaskGraph
from recorder.viewer.task_timeline import TaskTimeline

if TYPE_CHECKING:
    import rerun as rr

    from recorder.records import Record
    from recorder.records.asset import AssetFile

_BATCH: Final = 20_000  # records; sending fewer takes more time, and more take more memory
_MOTIONS: Final = ("move_body", "move_joints", "simulate")  # commands that add and remove no bodies


class Translator:
    """Shows records in a viewer, below a root entity and with frames of that prefix if one is named. For one thread.

    Attributes:
        scene: the bodies of all worlds.
        worlds: those that plans act in.
    """

    def __init__(self, stream: rr.RecordingStream, root: str = "") -> None:
        columns = self._columns = Columns(stream, root)
        self._lines, self._tables = LogLines(columns), RecordTables(columns)
        self._timeline, self._graph = TaskTimeline(columns), TaskGraph(columns)
        self._page, self._picture = QueryPage(columns), QueryPicture(columns)
        scene = self.scene = Scene(columns, f"{root}/" if root else "")
        self._plots, self.worlds = Plots(columns), ActiveWorlds(scene)
        self._attachments, self._cameras = Attachments(columns, scene), CameraFrustums(columns, scene)
        self._paths = TrajectoryPaths(columns, scene)
        self._task_marks, self._query_marks = TaskMarks(columns, scene), QueryMarks(columns, scene)
        self._places = QueryPlaces(columns, scene)
        self._sim_ns = 0  # of the world of the latest record that has one
        self._previous_ns = 0  # wall time of the record before
        self._waiting = 0  # records

    def attach(self, asset: AssetFile) -> None:
        """Takes a model or mesh, before the records that use it, or anything else."""
        self.scene.attach(asset)

    def show(self, record: Record) -> None:
        """Takes the next record; its rows are sent in batches, at the latest by :meth:`flush`."""
        if record.world:
            self._sim_ns = sim_ns(record.sim_step)
        now = TimePoint(record.seq, self._sim_ns, record.wall_time_ns)
        text, level = text_of(record)
        self._lines.show(record, text, level, now)
        self._tables.show(record, text, now)
        if type(record) is Task:  # isinstance takes five times as long where it is none
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
        if record.world and type(record) is not Output:  # a plan may talk before it acts
            self.worlds.follow(record)
        self._previous_ns = now.wall
        self._waiting += 1
        if self._waiting >= _BATCH:
            self.flush()

    def flush(self) -> None:
        """Sends all buffered rows."""
        self._columns.flush()
        self._waiting = 0

    def finish(self) -> None:
        """Ends: adds the worlds that no plan acted in, and sends all buffered rows."""
        self.worlds.add_others()
        self.flush()

    def _show_task(self, record: Task, now: TimePoint) -> None:
        self._timeline.show(record, now)
        self._graph.show(record, now)
        self._task_marks.show(record, now)
        if record.phase == Task.STARTED:
            self._query_marks.clear(now)
            if record.kind == "motion":  # what follows in an action is of no other place
                self._places.clear(now)

    def _show_change(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        world, end = record.world, record.sim_step
        effect = record.effect if isinstance(record, Mutation) else None  # held: it takes time to get it again
        only_moves = isinstance(record, Mutation) and record.WhichOneof("command") in _MOTIONS
        motions = self.scene.motions(record)
        if not only_moves or world not in self.scene.bodies:
            self.scene.begin(record, now)
        step, time = end, now
        for motion in motions:
            if motion.sim_step != step:
                step = motion.sim_step
                time = now if step == end else _within(record, step, now, self._previous_ns)
            body = self.scene.move(world, motion, time)
            if body is not None:
                self._plots.show(world, body, motion, time)
                self._paths.move(world, motion.body, time)
        self._paths.show(record, now)
        if not only_moves or effect is None or effect.attached or effect.detached:
            self._attachments.show(record, now)
            self._cameras.show(world, now)


def _within(record: Mutation | Keyframe, sim_step: int, now: TimePoint, previous_ns: int) -> TimePoint:
    """Time of a simulated step within a record; its wall time is interpolated from the record before."""
    steps = max(record.simulate.steps, 1) if isinstance(record, Mutation) else 1
    share = min(max((sim_step - record.sim_step + steps) / steps, 0.0), 1.0)
    return TimePoint(now.step, sim_ns(sim_step), previous_ns + round((now.wall - previous_ns) * share))
