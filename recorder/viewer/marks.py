"""Marks in the scene, in the frame of the world's root: targets of motions, failures, and what the last query found.

A failure for a collision marks the links that would have met, where they are, joined by a line.

A failure's mark and its line in the log are one entity: selecting the line shows the position. A query's marks are
green where its answer is yes (or nothing blocks), red where it is no.

Attachments in the scene: lines from carriers to what they hold, which move with the carriers' links.

Cameras in the scene: where they are, and where those of robots look, as frustums that move with their links.

Positions that recorded values give: of targets, given themselves or by an object's name.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import rerun as rr

from recorder import geometry
from recorder.records import Keyframe, Task, argument_values
from recorder.records.text import by_name
from recorder.viewer.rerun_stream import BLUE, GREEN, RED, YELLOW
from recorder.viewer.scene import offset, table
from recorder.viewer.tables_and_plots import numbered

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from recorder.geometry import Vector
    from recorder.records import Attachment, Mutation, Query
    from recorder.viewer.rerun_stream import Color, Columns, TimePoint
    from recorder.viewer.scene import Scene, SceneBody


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
            values = argument_values(record.parameters, strict=True)
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
        position_failed = (
            target_position(self._scene, record.world, argument_values(record.failure.data, strict=True)) or target
        )
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
        found = argument_values(record.failure.data, strict=True).get("pairs")
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
        values, evidence = argument_values(record.arguments, strict=True), argument_values(record.evidence, strict=True)
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


_ATTACHMENT_LINE: Final = 0.003  # m


class Attachments:
    """The lines of all attachments; the scene has shown a record before they do."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._paths: dict[tuple[str, str, str], str] = {}  # by world, carrier and body

    def show(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        """Shows what a record changed."""
        world = record.world
        bodies = self._scene.bodies.get(world, {})
        pairs = [key[1:] for key in self._paths if key[0] == world]
        attached, detached = _attachment_changes(record, pairs)
        for pair in {*detached, *(pair for pair in pairs if not {*pair} <= bodies.keys())}:
            path = self._paths.pop((world, *pair), None)
            if path is not None:
                self._columns.clear(path, now)
        for attachment in attached:
            self._show_attachment(world, attachment, now)

    def _show_attachment(self, world: str, attachment: Attachment, now: TimePoint) -> None:
        path = self._columns.path(
            world, "attachments", attachment.carrier, attachment.carrier_link or "base", attachment.body
        )
        self._paths[world, attachment.carrier, attachment.body] = path
        self._columns.set_frame(path, self._scene.frame(world, attachment.carrier, attachment.carrier_link))
        line = [(0.0, 0.0, 0.0), tuple(attachment.position)]
        self._columns.send(
            path,
            now,
            rr.LineStrips3D([line], colors=[YELLOW], radii=[_ATTACHMENT_LINE], labels=[f"holds {attachment.body}"]),
        )


def _attachment_changes(
    record: Mutation | Keyframe, pairs: list[tuple[str, str]]
) -> tuple[Iterable[Attachment], list[tuple[str, str]]]:
    """Attachments that were made, and those of the pairs of carrier and body that ended."""
    if not isinstance(record, Keyframe):
        return record.effect.attached, [(ended.carrier, ended.body) for ended in record.effect.detached]
    carried = {(attachment.carrier, attachment.body) for attachment in record.attachments}
    return record.attachments, [pair for pair in pairs if pair not in carried]


_FRUSTUM: Final = 0.6  # m, length
_FRUSTUM_LINE: Final = 0.003  # m


class CameraFrustums:
    """The frustums of all robots' cameras."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._paths: dict[tuple[str, str], str] = {}  # by world and robot

    def show(self, world: str, now: TimePoint) -> None:
        """Shows those of the robots that a world has by now."""
        bodies = self._scene.bodies.get(world, {})
        for key in [key for key in self._paths if key[0] == world and key[1] not in bodies]:
            self._columns.clear(self._paths.pop(key), now)
        for name, body in bodies.items():
            if body.loaded.robot_description and (world, name) not in self._paths:
                self._show_frustum(world, name, body, now)

    def _show_frustum(self, world: str, name: str, body: SceneBody, now: TimePoint) -> None:
        path = self._paths[world, name] = self._columns.path(world, "camera", name)
        camera = table(body.loaded, "camera")
        try:
            right, down = (math.tan(camera[f"{axis}_fov"] / 2) * _FRUSTUM for axis in ("horizontal", "vertical"))
            frame = self._scene.frame(world, name, str(camera["frame"]))
        except (KeyError, TypeError):
            return  # a robot without one
        link_T_optical = offset(camera, "frame_offset")
        corners = [
            geometry.transform(link_T_optical, (right * x, down * y, _FRUSTUM))
            for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        strips = [[*corners, corners[0]], *([link_T_optical[0], corner] for corner in corners)]
        self._columns.set_frame(path, frame)
        self._columns.send(path, now, rr.LineStrips3D(strips, colors=[BLUE], radii=[_FRUSTUM_LINE]))


def camera_position(scene: Scene, world: str, camera: object = None, robot_name: str = "") -> Vector | None:
    """Where a camera is, given as position, pose or frame, by default the robot's own; None if that isn't known."""
    robot = scene.robot(world, robot_name)
    if isinstance(camera, list) or robot is None:
        return position(camera)
    name, body = robot
    frame = str(camera or table(body.loaded, "camera").get("frame", ""))
    pose = scene.pose(world, name, frame) if frame else None
    return pose[0] if pose is not None else None


Values: TypeAlias = "dict[str, Any]"


def name_of(value: object) -> str:
    """The name of the object that a recorded value is, or the value itself if it is a text; else ""."""
    name = value.get("object") if isinstance(value, dict) else value
    return name if isinstance(name, str) else ""


def vector(value: object, length: int) -> tuple[float, ...] | None:
    """A recorded value as that many finite numbers; None if it isn't that."""
    if not isinstance(value, list | tuple) or len(value) != length:
        return None
    finite = all(isinstance(number, int | float) and math.isfinite(number) for number in value)
    return tuple(map(float, value)) if finite else None


def position(value: object) -> Vector | None:
    """The position, or that of the pose, that a recorded value is; None if it is neither."""
    if isinstance(value, list) and len(value) == 2:
        value = value[0]
    numbers = vector(value, 3)
    return (numbers[0], numbers[1], numbers[2]) if numbers is not None else None


def target_position(scene: Scene, world: str, values: Values) -> Vector | None:
    """The target position among values: a position, else that of an object; None if there is neither."""
    for value in values.values():
        point = position(value)
        if point is not None:
            return point
    for value in values.values():
        body = scene.bodies.get(world, {}).get(name_of(value))
        if body is not None and not body.loaded.robot_description:
            return body.pose[0]
    return None
