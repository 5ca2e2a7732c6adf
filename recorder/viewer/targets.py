"""Where motions want to go while they run, and where a task failed, until the next one begins.

A failure's mark and its line in the log are one entity: whoever selects the line sees the place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder import geometry
from recorder.records import Task
from recorder.viewer.log_lines import numbered
from recorder.viewer.marks import BLUE, RED, Marks, arrow, line, points
from recorder.viewer.scene_lookup import eye, numbers, robot, target, values_of

if TYPE_CHECKING:
    from recorder.geometry import Vector
    from recorder.viewer.columns import Columns, Moment
    from recorder.viewer.scene import Scene
    from recorder.viewer.scene_lookup import Values

TARGETS: Final = "targets"
FAILURES: Final = "failures"
_ARROW: Final = 0.35  # m
_ABOVE: Final = 1.8  # m above its base that a robot's failure is told
_LARGE: Final = 0.03  # m
_PIN: Final = 0.3  # m
_NOTHING: Final = ("", "")


class Targets:
    """All motions' targets, and failures.

    Args:
        columns: where they go.
        scene: whose bodies they speak of.
    """

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._running: dict[int, Marks] = {}
        self._names: dict[int, str] = {}  # of running motions' marks
        self._places: dict[int, Vector] = {}  # targets of running tasks
        self._failures = Marks(columns, scene)
        self._told = _NOTHING  # the failure that stands: those of what it was part of are the same

    def show(self, record: Task, now: Moment) -> None:
        """Shows what a task's start or end changes."""
        if record.phase == Task.STARTED:
            self._failures.clear(now)
            self._told = _NOTHING
            values = values_of(record.parameters)
            place = target(self._scene, record.world, values)
            if place is not None:
                self._places[record.task] = place
                if record.kind == "motion":
                    self._aim(record, values, place, now)
        elif record.phase == Task.FINISHED:
            marks = self._running.pop(record.task, None)
            self._names.pop(record.task, None)
            if marks is not None:
                marks.clear(now)
            place = self._places.pop(record.task, None)
            if record.status == Task.FAILED:
                self._fail(record, place, now)

    def _aim(self, record: Task, values: Values, place: Vector, now: Moment) -> None:
        shapes = [points([place], BLUE, [record.name])]
        turn = numbers(values.get("orientation"), 4)
        start = eye(self._scene, record.world) if record.name == "looking" else None
        if start is not None:
            x, y, z = (end - begin for begin, end in zip(start, place, strict=True))
            shapes.append(arrow(start, (x, y, z), BLUE))
        elif turn is not None:
            shapes.append(arrow(place, geometry.rotate(turn, (_ARROW, 0.0, 0.0)), BLUE))
        marks = self._running[record.task] = Marks(self._columns, self._scene)
        marks.put(record.world, (TARGETS, self._name(record)), now, *shapes)

    def _name(self, record: Task) -> str:
        """A name that no other running motion's mark has; short ones come again, so that entities stay few."""
        taken = self._names.values()
        names = (record.name, *(f"{record.name} {number}" for number in range(2, len(taken) + 2)))
        name = self._names[record.task] = next(name for name in names if name not in taken)
        return name

    def _fail(self, record: Task, goal: Vector | None, now: Moment) -> None:
        told = (record.failure.type, record.failure.message)
        if told == self._told:
            return
        self._told = told
        line_of_log = numbered(f"{record.name}: {told[0]}: {told[1]}", now)
        shapes: list[rr.AsComponents] = [rr.TextLog(line_of_log, level="ERROR", color=RED)]
        told_of = target(self._scene, record.world, values_of(record.failure.data))
        place = told_of or goal or self._above_robot(record.world)
        if place is not None:
            x, y, z = place
            top = (x, y, z + _PIN)  # above the words of what wanted to go there
            shapes += [points([top], RED, [f"{record.name} failed: {told[0]}"], _LARGE), line([place, top], RED)]
        self._failures.put(record.world, (FAILURES,), now, *shapes)

    def _above_robot(self, world: str) -> Vector | None:
        found = robot(self._scene, world)
        return geometry.transform(found[1].pose, (0.0, 0.0, _ABOVE)) if found is not None else None
