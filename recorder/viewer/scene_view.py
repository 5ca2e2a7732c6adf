"""A recording as a picture: the scene with its marks, the curves, and the world that is in front."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation, Query, Task
from recorder.records.frames import FrameTree
from recorder.viewer.attachments import AttachmentMarks
from recorder.viewer.columns import TimePoint, sim_ns
from recorder.viewer.marks import QueryMarks, TaskMarks
from recorder.viewer.plots import Plots
from recorder.viewer.scene import Scene

if TYPE_CHECKING:
    from recorder.geometry import Vector
    from recorder.records import Record
    from recorder.records.asset import AssetFile
    from recorder.viewer.columns import Columns

_SETUP: Final = ("open_world", "load_body", "set_gravity", "set_realtime", "set_robot", "set_color")
_MOTIONS: Final = ("move_body", "move_joints", "simulate")
_CLOSE: Final = "close_world"
_KEYFRAME: Final = "keyframe"
_UNKNOWN: Final = "change"  # of another version


class SceneView:
    """Scene, marks and curves of a recording; the names of all frames begin with a prefix.

    Attributes:
        scene: the bodies.
        worlds: centres in m of the worlds that plans acted in, when they began to.
        front: the first of those that are still open; "" before there is one.
    """

    def __init__(self, columns: Columns, prefix: str = "") -> None:
        self._frames = FrameTree()
        self._plots = Plots(columns)
        self.scene = Scene(columns, self._frames, prefix)
        self._attachments = AttachmentMarks(columns, self.scene)
        self._tasks, self._queries = TaskMarks(columns, self.scene), QueryMarks(columns, self.scene)
        self.worlds: dict[str, Vector] = {}
        self.front = ""
        self._open: dict[str, None] = {}  # worlds that a plan acted in
        self._previous_ns = 0  # wall time of the record before

    def attach(self, asset: AssetFile) -> None:
        """Takes a model or mesh, before the records that use it, or anything else."""
        if asset.name.endswith(".urdf"):
            self._frames.add_urdf(asset.sha256, asset.content)
        self.scene.attach(asset)

    def show(self, record: Record, now: TimePoint) -> None:
        """Shows a record."""
        action = _action(record)
        if isinstance(record, Mutation):
            self._change(record, now, only_moves=action in _MOTIONS)
        elif type(record) is Query:  # isinstance takes five times as long where it is none
            self._queries.show(record, now)
        elif type(record) is Task:
            self._tasks.show(record, now)
            if record.phase == Task.STARTED:
                self._queries.clear(now)
        elif type(record) is Keyframe:
            self._change(record, now)
        if record.world:
            self._follow(record.world, action)
        self._previous_ns = now.wall

    def finish(self) -> None:
        """Adds the worlds that no plan acted in."""
        for world in self.scene.bodies:
            self.worlds.setdefault(world, self.scene.centre(world))

    def _change(self, record: Mutation | Keyframe, now: TimePoint, *, only_moves: bool = False) -> None:
        """Shows a change; most only move bodies, and add and remove none."""
        world, end = record.world, record.sim_step
        effect = record.effect if isinstance(record, Mutation) else None  # held: it takes time to get it again
        motions = self._frames.motions(record)  # also takes the models of what it adds
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
        if not only_moves or effect is None or effect.attached or effect.detached:
            self._attachments.show(record, now)

    def _follow(self, world: str, action: str) -> None:
        """Notes when a plan begins to act in a world, and when it closes it."""
        if world not in self.worlds and action not in _SETUP:
            self.worlds[world] = self.scene.centre(world)
        if world in self._open:
            if action != _CLOSE:
                return
            del self._open[world]
        elif _is_act(action):
            self._open[world] = None
        self.front = next(iter(self._open), self.front)


def acts(record: Record) -> bool:
    """Whether a plan acts in the record's world, beyond opening, filling and closing it."""
    return bool(record.world) and _is_act(_action(record))


def _is_act(action: str) -> bool:
    return action not in (*_SETUP, _CLOSE, _KEYFRAME)


def _action(record: Record) -> str:
    """What a record does to a world: a mutation's command; "" if it does nothing."""
    if isinstance(record, Mutation):
        return record.WhichOneof("command") or _UNKNOWN
    return _KEYFRAME if type(record) is Keyframe else ""


def _within(record: Mutation | Keyframe, sim_step: int, now: TimePoint, previous_ns: int) -> TimePoint:
    """Time of a simulated step within a record; its wall time is interpolated from the record before."""
    steps = max(record.simulate.steps, 1) if isinstance(record, Mutation) else 1
    share = min(max((sim_step - record.sim_step + steps) / steps, 0.0), 1.0)
    return TimePoint(now.step, sim_ns(sim_step), previous_ns + round((now.wall - previous_ns) * share))
