"""Marks in the scene, in the frame of the world's root: targets of motions, failures, and what the last query found.

A failure for a collision marks the links that would have met, where they are, joined by a line.

A failure's mark and its line in the log are one entity: selecting the line shows the position. A query's marks are
green where its answer is yes (or nothing blocks), red where it is no.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder import geometry
from recorder.records import Task, argument_values
from recorder.records.text import by_name
from recorder.viewer.cameras import camera_position
from recorder.viewer.colors import BLUE, GREEN, RED
from recorder.viewer.log_lines import numbered
from recorder.viewer.positions import name_of, position, target_position, vector

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.geometry import Vector
    from recorder.records import Query
    from recorder.viewer.colors import Color
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.positions import Values
    from recorder.viewer.scene import Scene

FAILURES: Final = "failures"
_PAIRS: Final = "pairs"
_TARGETS: Final = "targets"
_ANSWERS: Final = "answers"
_POINT: Final = 0.02  # m, as all lengths below
_LINE: Final = 0.004
_LINK: Final = 0.015
_ARROW: Final = 0.35
_ARROW_RADIUS: Final = 0.008
_FAILURE: Final = 0.03
_PIN: Final = 0.3  # of a failure, above the words of its target
_ABOVE_ROBOT: Final = 1.8  # where a failure without a position is shown
_MAX_PAIRS: Final = 5  # of links that would meet
_MAX_LETTERS: Final = 60
_NO: Final = ("false", "null", "[]", "")
_BLOCKING: Final = {"obstacles": "is in the way", "hidden_by": "hides it"}  # by the evidence that names the bodies


class Marks:
    """Marks that are cleared together."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._paths: list[str] = []

    def add(self, world: str, parts: Sequence[str], now: TimePoint, *shapes: rr.AsComponents) -> None:
        """Shows shapes from now on, as the entity of these names below the world's."""
        path = self._columns.path(world, *parts)
        self._columns.set_frame(path, self._scene.frame(world))
        self._columns.send(path, now, *shapes)
        self._paths.append(path)

    def clear(self, now: TimePoint) -> None:
        """Removes all marks."""
        for path in self._paths:
            self._columns.clear(path, now)
        self._paths = []


class TaskMarks:
    """Targets of motions while they run; where a task failed, until the next one begins."""

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
        shapes = [_points([target], BLUE, [record.name])]
        orientation = vector(values.get("orientation"), 4)
        camera = camera_position(self._scene, record.world) if record.name == "looking" else None
        if camera is not None:
            x, y, z = (end - begin for begin, end in zip(camera, target, strict=True))
            shapes.append(_arrow(camera, (x, y, z), BLUE))
        elif orientation is not None:
            shapes.append(_arrow(target, geometry.rotate(orientation, (_ARROW, 0.0, 0.0)), BLUE))
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
                _points([top], RED, [f"{record.name} failed: {kind}"], _FAILURE),
                _line([position_failed, top], RED),
            ]
        self._failures.add(record.world, (FAILURES,), now, *shapes)
        self._show_pairs(record, now)

    def _show_pairs(self, record: Task, now: TimePoint) -> None:
        """Shows which links would have met, where they are now."""
        found = argument_values(record.failure.data).get("pairs")
        pairs = [pair for pair in found if isinstance(pair, dict)] if isinstance(found, list) else []
        for number, pair in enumerate(pairs[:_MAX_PAIRS], 1):
            ends = []
            for body, link in (("mover", "link"), ("body", "body_link")):
                names = str(pair.get(body, "")), str(pair.get(link, ""))
                pose = self._scene.pose(record.world, *names)
                if pose is not None:
                    ends.append((pose[0], names[1] or names[0]))
            if len(ends) == 2:
                points, labels = zip(*ends, strict=True)
                line = _line(points, RED, _LINK)
                self._failures.add(record.world, (_PAIRS, str(number)), now, _points(points, RED, labels), line)


class QueryMarks:
    """Target and posture of the last query, and what touches, hides or blocks; until the next task begins."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._scene = scene
        self._marks = Marks(columns, scene)

    def clear(self, now: TimePoint) -> None:
        """Removes the last query's marks."""
        self._marks.clear(now)

    def show(self, record: Query, now: TimePoint) -> None:
        """Shows a query."""
        self._marks.clear(now)
        if not record.world:
            return
        values, evidence = argument_values(record.arguments), argument_values(record.evidence)
        if not values and not evidence:
            return
        good = not evidence["obstacles"] if "obstacles" in evidence else record.answer_json not in _NO
        for name, shape in self._shapes(record, values, evidence, GREEN if good else RED):
            self._marks.add(record.world, (_ANSWERS, record.name, name), now, shape)

    def _shapes(
        self, record: Query, values: Values, evidence: Values, color: Color
    ) -> Iterator[tuple[str, rr.AsComponents]]:
        scene, world = self._scene, record.world
        body = target_position(scene, world, {name: value for name, value in values.items() if name != "camera"})
        target = position(evidence.get("position")) or body
        if target is not None:
            yield "target", _points([target], color, [f"{record.name}: {by_name(record.answer_json)}"[:_MAX_LETTERS]])
        for fact, verb in _BLOCKING.items():
            names = evidence.get(fact)
            poses = {name: scene.pose(world, name) for name in names} if isinstance(names, dict) else {}
            positions = {name: pose[0] for name, pose in poses.items() if pose is not None}
            if positions:
                yield fact, _points(list(positions.values()), RED, [f"{name} {verb}" for name in positions])
        robot_name = name_of(values.get("robot"))
        camera = camera_position(scene, world, values["camera"], robot_name) if "camera" in values else None
        if camera is not None and body is not None:
            yield "sight", _line([camera, body], color)
        contacts = [point for value in evidence.get("points") or () if (point := position(value)) is not None]
        if contacts:
            yield "contacts", _points(contacts, color)
        joints, link = evidence.get("joints"), values.get("gripper")
        if isinstance(joints, dict) and isinstance(link, str):
            posture = scene.posture(world, robot_name, link, joints)
            if posture:
                yield "posture", _line(posture, color, _LINK)


def _points(
    positions: Sequence[Vector], color: Color, labels: Sequence[str] = (), radius: float = _POINT
) -> rr.AsComponents:
    return rr.Points3D(positions, colors=[color], radii=[radius], labels=labels or None)


def _line(positions: Sequence[Vector], color: Color, radius: float = _LINE) -> rr.AsComponents:
    return rr.LineStrips3D([positions], colors=[color], radii=[radius])


def _arrow(start: Vector, vector: Vector, color: Color) -> rr.AsComponents:
    return rr.Arrows3D(origins=[start], vectors=[vector], colors=[color], radii=[_ARROW_RADIUS])
