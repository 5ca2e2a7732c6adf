"""What is seen of a recording: the scene with its marks, the curves, and which world is in front."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation, Query, Task
from recorder.records.frames import FrameTree
from recorder.viewer.attachments import AttachmentMarks
from recorder.viewer.columns import Moment, simulated
from recorder.viewer.plots import Plots
from recorder.viewer.query_marks import Answers
from recorder.viewer.scene import Scene
from recorder.viewer.targets import Targets

if TYPE_CHECKING:
    from collections.abc import Iterable

    from recorder.geometry import Vector
    from recorder.records import Record
    from recorder.records.asset import AssetFile
    from recorder.viewer.columns import Columns

_BUILDING: Final = ("open_world", "load_body", "set_gravity", "set_realtime", "set_robot", "set_color")
_MOVING: Final = ("move_body", "move_joints", "simulate")
_CLOSING: Final = "close_world"
_KEEPING: Final = "keyframe"
_UNKNOWN: Final = "change"  # of another version


class SceneView:
    """All that is seen.

    Args:
        columns: where it goes.
        prefix: before the names of all frames.

    Attributes:
        worlds: middles of the worlds that plans did something in, when they began to.
        front: the one where a plan goes on: of those that are still open the first; "" before there is one.
    """

    def __init__(self, columns: Columns, prefix: str = "") -> None:
        self._frames = FrameTree()
        self._scene = Scene(columns, self._frames, prefix)
        self._plots = Plots(columns)
        self._holds, self._targets = AttachmentMarks(columns, self._scene), Targets(columns, self._scene)
        self._answers = Answers(columns, self._scene)
        self.worlds: dict[str, Vector] = {}
        self.front = ""
        self._open: dict[str, None] = {}  # worlds that a plan did something in
        self._before = 0  # the clock at the record before

    @property
    def absent(self) -> Iterable[str]:
        """Files that bodies are made of and that were not attached, as ``<sha256>/<file name>``; one a body."""
        return self._scene.absent

    def attach(self, asset: AssetFile) -> None:
        """Takes a file.

        Args:
            asset: a model or mesh, before the records that use it, or anything else.
        """
        if asset.name.endswith(".urdf"):
            self._frames.learn(asset.sha256, asset.content)
        self._scene.attach(asset)

    def show(self, record: Record, now: Moment) -> None:
        """Shows a record.

        Args:
            record: the next one.
            now: when.
        """
        deed = _deed(record)
        if isinstance(record, Mutation):
            self._change(record, now, moves=deed in _MOVING)
        elif type(record) is Query:  # isinstance takes five times as long where it is none
            self._answers.show(record, now)
        elif type(record) is Task:
            self._targets.show(record, now)
            self._answers.begin(record, now)
        elif type(record) is Keyframe:
            self._change(record, now)
        if record.world:
            self._note(record.world, deed)
        self._before = now.wall

    def finish(self) -> None:
        """Ends: names worlds too that nothing was done in."""
        for world in self._scene.bodies:
            self.worlds.setdefault(world, self._scene.middle(world))

    def _change(self, record: Mutation | Keyframe, now: Moment, *, moves: bool = False) -> None:
        """Shows a change; one that only moves things, which most do, brings and takes nothing."""
        world, end = record.world, record.sim_step
        effect = record.effect if isinstance(record, Mutation) else None  # held: it takes time to get it again
        moved = self._frames.moved(record)  # which learns the models of what comes
        if not moves or world not in self._scene.bodies:
            self._scene.begin(record, now)
        step, moment = end, now
        for one in moved:
            if one.step != step:
                step = one.step
                moment = now if step == end else _within(record, step, now, self._before)
            body = self._scene.move(world, one, moment)
            if body is not None:
                self._plots.show(world, body, one, moment)
        if not moves or effect is None or effect.attached or effect.detached:
            self._holds.show(record, now)

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
    return _KEEPING if type(record) is Keyframe else ""


def _within(record: Mutation | Keyframe, step: int, now: Moment, before: int) -> Moment:
    """The moment of a simulated step within a record: by the clock between the record before and this one."""
    steps = max(record.simulate.steps, 1) if isinstance(record, Mutation) else 1
    share = min(max((step - record.sim_step + steps) / steps, 0.0), 1.0)
    return Moment(now.step, simulated(step), before + round((now.wall - before) * share))
