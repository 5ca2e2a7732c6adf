"""Turns records into what the viewer shows, live and afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from recorder.frames import FrameTree
from recorder.log_lines import text_of
from recorder.records import STEPS_PER_SECOND, Keyframe, Mutation, Query, Run, Task
from recorder.viewer.answers import Answers
from recorder.viewer.columns import Columns, Moment
from recorder.viewer.graph import Graph
from recorder.viewer.holds import Holds
from recorder.viewer.lanes import Lanes
from recorder.viewer.lines import Lines
from recorder.viewer.plots import Plots
from recorder.viewer.questions import Questions
from recorder.viewer.scene import Scene
from recorder.viewer.tables import Tables
from recorder.viewer.targets import Targets

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import rerun as rr

    from recorder.asset import AssetFile
    from recorder.geometry import Vector
    from recorder.records import Record

_STEP_NS: Final = 1_000_000_000 / STEPS_PER_SECOND  # of a simulated step
_BUILDING: Final = ("open_world", "load_body", "set_gravity", "set_realtime", "set_robot", "set_color")
_MOVING: Final = ("move_body", "move_joints", "simulate")
_CLOSING: Final = "close_world"
_KEEPING: Final = "keyframe"
_UNKNOWN: Final = "change"  # of another version
_BATCH: Final = 10_000  # records


class Translator:
    """Shows records in a viewer. For one thread.

    Args:
        stream: where it goes.
        root: the entity that all others are below, and the prefix of all frames; "" for none.

    Attributes:
        worlds: middles of the worlds that plans did something in, when they began to.
        front: the one where a plan goes on: of those that are still open the first; "" before there is one.
    """

    def __init__(self, stream: rr.RecordingStream, root: str = "") -> None:
        self._columns = Columns(stream, root)
        self._frames = FrameTree()
        self._scene = Scene(self._columns, self._frames, f"{root}/" if root else "")
        self._lanes, self._graph = Lanes(self._columns), Graph(self._columns)
        self._lines, self._tables = Lines(self._columns), Tables(self._columns)
        self._plots = Plots(self._columns)
        self._holds, self._targets = Holds(self._columns, self._scene), Targets(self._columns, self._scene)
        self._answers, self._questions = Answers(self._columns, self._scene), Questions(self._columns)
        self._shows: Mapping[type[Record], Callable[[Any, Moment], None]] = {
            Task: self._show_task,
            Query: self._show_query,
            Run: self._show_run,
        }
        self.worlds: dict[str, Vector] = {}
        self.front = ""
        self._open: dict[str, None] = {}  # worlds that a plan did something in
        self._sim = 0  # ns, of the world that something happened in last
        self._waiting = 0  # records
        self._before = 0  # the clock at the record before

    def attach(self, asset: AssetFile) -> None:
        """Takes a file.

        Args:
            asset: a model or mesh, before the records that use it, or anything else.
        """
        if asset.name.endswith(".urdf"):
            self._frames.learn(asset.sha256, asset.content)
        self._scene.attach(asset)

    def show(self, record: Record) -> None:
        """Takes a record; what it changes is sent in batches, at the latest by :meth:`flush`.

        Args:
            record: the next one.
        """
        world, wall = record.world, record.wall_time_ns
        if world:
            self._sim = round(record.sim_step * _STEP_NS)
        now = Moment(record.seq, self._sim, wall)
        text, level = text_of(record)
        self._lines.show(record, text, level, now)
        self._tables.show(record, text, now)
        deed = _deed(record)
        show = self._shows.get(type(record))
        if show is not None:
            show(record, now)
        elif isinstance(record, Mutation):
            self._show_change(record, now, moves=deed in _MOVING)
        elif isinstance(record, Keyframe):
            self._show_change(record, now)
        if world:
            self._note(world, deed)
        self._before = wall
        self._waiting += 1
        if self._waiting >= _BATCH:
            self.flush()

    def _note(self, world: str, deed: str) -> None:
        """Notes when a plan begins to do something in a world, and when that ends."""
        if world not in self.worlds and deed not in _BUILDING:
            self.worlds[world] = self._scene.middle(world)
        if world in self._open:
            if deed != _CLOSING:
                return
            del self._open[world]
        elif _acts(deed):
            self._open[world] = None
        self.front = next(iter(self._open), self.front)

    def _show_task(self, record: Task, now: Moment) -> None:
        self._lanes.show(record, now)
        self._graph.show(record, now)
        self._targets.show(record, now)
        self._answers.begin(record, now)

    def _show_change(self, record: Mutation | Keyframe, now: Moment, *, moves: bool = False) -> None:
        """Shows a change; one that only moves things, which most do, brings and takes nothing."""
        world = record.world
        moved = self._frames.moved(record)  # which learns the models of what comes
        if not moves or world not in self._scene.bodies:
            self._scene.begin(record, now)
        between = _between(record, now, self._before)
        for one in moved:
            moment = between.get(one.step, now)
            body = self._scene.move(world, one, moment)
            if body is not None:
                self._plots.show(world, body, one, moment)
        if moves and isinstance(record, Mutation) and not record.effect.attached and not record.effect.detached:
            return
        self._holds.show(record, now)

    def _show_query(self, record: Query, now: Moment) -> None:
        self._questions.show(record, now)
        self._answers.show(record, now)

    def _show_run(self, record: Run, now: Moment) -> None:  # noqa: ARG002  as the others
        if record.phase == Run.STARTED:
            self._graph.begin(record)

    def flush(self) -> None:
        """Sends what was gathered; costs nothing if that is nothing."""
        self._columns.flush()
        self._waiting = 0

    def finish(self) -> None:
        """Ends: names worlds too that nothing was done in, and sends what was gathered."""
        for world in self._scene.bodies:
            self.worlds.setdefault(world, self._scene.middle(world))
        self.flush()


def acts(record: Record) -> bool:
    """Whether a plan does something in a record's world, beyond making and closing it.

    Args:
        record: any.
    """
    return bool(record.world) and _acts(_deed(record))


def _acts(deed: str) -> bool:
    return deed not in (*_BUILDING, _CLOSING, _KEEPING)


def _deed(record: Record) -> str:
    """What a record does to a world: a mutation's command; "" if it does nothing."""
    if isinstance(record, Mutation):
        return record.WhichOneof("command") or _UNKNOWN
    return _KEEPING if isinstance(record, Keyframe) else ""


def _between(record: Mutation | Keyframe, now: Moment, before: int) -> dict[int, Moment]:
    """The moments of the simulated steps within a record: by the clock between the record before and this one."""
    moments: dict[int, Moment] = {}
    if isinstance(record, Mutation):
        end = record.sim_step
        for sample in record.effect.samples[:]:
            begin = end - max(record.simulate.steps, 1)
            share = min(max((sample.sim_step - begin) / (end - begin), 0.0), 1.0)
            wall = before + round((now.wall - before) * share)
            moments.setdefault(sample.sim_step, Moment(now.step, round(sample.sim_step * _STEP_NS), wall))
    return moments
