"""Marks of tasks: targets of motions while they run, and where a task failed, until the next one begins.

A failure's mark and its line in the log are one entity: selecting the line shows the position.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder import geometry
from recorder.records import Task, argument_values
from recorder.viewer.cameras import camera_position
from recorder.viewer.log_lines import numbered
from recorder.viewer.marks import BLUE, RED, Marks, arrow, line, points
from recorder.viewer.positions import target_position, vector

if TYPE_CHECKING:
    from recorder.geometry import Vector
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.positions import Values
    from recorder.viewer.scene import Scene

FAILURES: Final = "failures"
_TARGETS: Final = "targets"
_ARROW: Final = 0.35  # m, as all lengths below
_FAILURE: Final = 0.03
_PIN: Final = 0.3  # of a failure, above the words of its target
_ABOVE_ROBOT: Final = 1.8  # where a failure without a position is shown


class TaskMarks:
    """Targets of running motions, and the last failure."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._running: dict[int, tuple[str, Marks]] = {}  # name and marks of running motions
        self._targets: dict[int, Vector] = {}  # of running tasks
        self._failures = Marks(columns, scene)
        self._failure = ("", "")  # that is shown: parents fail with the same one

    def show(self, record: Task, now: TimePoint) -> None:
        """Shows what a task's start or end changes."""
        if record.phase == Task.STARTED:
            self._failures.clear(now)
            self._failure = ("", "")
            values = argument_values(record.parameters)
            target = target_position(self._scene, record.world, values)
            if target is not None:
                self._targets[record.task] = target
                if record.kind == "motion":
                    self._show_target(record, values, target, now)
        elif record.phase == Task.FINISHED:
            if record.task in self._running:
                self._running.pop(record.task)[1].clear(now)
            target = self._targets.pop(record.task, None)
            if record.status == Task.FAILED:
                self._show_failure(record, target, now)

    def _show_target(self, record: Task, values: Values, target: Vector, now: TimePoint) -> None:
        shapes = [points([target], BLUE, [record.name])]
        orientation = vector(values.get("orientation"), 4)
        camera = camera_position(self._scene, record.world) if record.name == "looking" else None
        if camera is not None:
            x, y, z = (end - begin for begin, end in zip(camera, target, strict=True))
            shapes.append(arrow(camera, (x, y, z), BLUE))
        elif orientation is not None:
            shapes.append(arrow(target, geometry.rotate(orientation, (_ARROW, 0.0, 0.0)), BLUE))
        # a name that no other running motion has; short ones come again, so that entities stay few
        taken = {name for name, _ in self._running.values()}
        names = (record.name, *(f"{record.name} {number}" for number in range(2, len(taken) + 2)))
        name = next(name for name in names if name not in taken)
        marks = Marks(self._columns, self._scene)
        self._running[record.task] = name, marks
        marks.add(record.world, (_TARGETS, name), now, *shapes)

    def _show_failure(self, record: Task, target: Vector | None, now: TimePoint) -> None:
        failure = kind, message = record.failure.type, record.failure.message
        if failure == self._failure:
            return
        self._failure = failure
        shapes: list[rr.AsComponents] = [
            rr.TextLog(numbered(f"{record.name}: {kind}: {message}", now), level="ERROR", color=RED)
        ]
        position_failed = target_position(self._scene, record.world, argument_values(record.failure.data)) or target
        if position_failed is None and (robot := self._scene.robot(record.world)) is not None:
            position_failed = geometry.transform(robot[1].pose, (0.0, 0.0, _ABOVE_ROBOT))
        if position_failed is not None:
            x, y, z = position_failed
            top = (x, y, z + _PIN)
            shapes += [
                points([top], RED, [f"{record.name} failed: {kind}"], _FAILURE),
                line([position_failed, top], RED),
            ]
        self._failures.add(record.world, (FAILURES,), now, *shapes)
