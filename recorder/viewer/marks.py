"""Marks in the scene: targets and failures of tasks, attachments, cameras, and paths of trajectories.

The mark of a failure and its line in the log are one entity, so selecting the line shows the position. The planned path
of a tool or base is a blue line. The part that was driven is a thicker green line. At the end of the path, both lines
disappear. After a stop, the lines stay until the next trajectory of the body; the planned part is grey.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import shorten
from typing import Any, Final, TypeAlias

import rerun as rr

from recorder import geometry
from recorder.geometry import Vector
from recorder.records import Attachment, Following, Keyframe, Mutation, Run, Task, argument_values
from recorder.records.motion import BASE_COORDINATES
from recorder.records.values import first_position, position, vector
from recorder.viewer.rerun_stream import BLUE, GREEN, GREY, RED, YELLOW, Color, Columns, TimePoint
from recorder.viewer.scene import SceneBody, ViewerScene, offset, table

FAILURES: Final = "failures"
_PAIRS: Final = "pairs"
_TARGETS: Final = "targets"
_POINT: Final = 0.02  # radius in m; the sizes below are also in m
_LINE: Final = 0.004
LINK: Final = 0.015
_ARROW: Final = 0.35
_ARROW_RADIUS: Final = 0.008
_FAILURE: Final = 0.03
_PIN: Final = 0.3  # height in m of a failure's label above the target, so that the target's label stays visible
_ABOVE_ROBOT: Final = 1.1  # height in m of the label of a failure without a position
_IN_VIEW: Final = 5.0  # maximum distance in m between a failure's label and the robot; a farther label is at the robot
_MAX_LETTERS: Final = 60  # maximum number of characters of a label
_MAX_PAIRS: Final = 5  # maximum number of pairs of colliding links that are shown


class Marks:
    """Marks that are cleared together."""

    def __init__(self, columns: Columns, scene: ViewerScene) -> None:
        self._columns = columns
        self.scene = scene
        self._paths: list[str] = []

    def add(self, world: str, parts: Sequence[str], now: TimePoint, *shapes: rr.AsComponents) -> None:
        """Show shapes from now on. ``parts`` is the path of the shapes' entity below the world's entity."""
        path = self._columns.path(world, *parts)
        self._columns.set_frame(path, self.scene.frame(world))
        self._columns.send(path, now, *shapes)
        self._paths.append(path)

    def clear(self, now: TimePoint) -> None:
        """Remove all marks."""
        for path in self._paths:
            self._columns.clear(path, now)
        self._paths = []


class TaskMarks:
    """The targets of running motions, and the positions of failures until the next task begins."""

    def __init__(self, columns: Columns, scene: ViewerScene) -> None:
        self._columns = columns
        self._scene = scene
        self._running: dict[int, tuple[str, Marks]] = {}  # name and marks of running motions
        self._targets: dict[int, Vector] = {}  # positions of the targets of running tasks, by id
        self._failures = Marks(columns, scene)
        self._failure = ("", "")  # type and message of the shown failure, which outer tasks have, too

    def show(self, record: Task, now: TimePoint) -> None:
        """Update the marks at a task's start or end."""
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
                self._show_failure(record, record.world, target, now)

    def show_end(self, record: Run, world: str, now: TimePoint) -> None:
        """Mark the failure of the plan in its world, unless the mark of its failed task is already shown."""
        if record.phase == Run.FINISHED and not record.succeeded:
            self._show_failure(record, world, None, now)

    def _show_target(self, record: Task, values: Values, target: Vector, now: TimePoint) -> None:
        shapes = [points_at([target], BLUE, [record.name])]
        orientation = vector(values.get("orientation"), 4)
        camera = camera_position(self._scene, record.world) if record.name == "looking" else None
        if camera is not None:
            x, y, z = (end - begin for begin, end in zip(camera, target, strict=True))
            shapes.append(_arrow(camera, (x, y, z), BLUE))
        elif orientation is not None:
            shapes.append(_arrow(target, geometry.rotate(orientation, (_ARROW, 0.0, 0.0)), BLUE))
        # names of running motions differ; later motions use the same names again, so that there are few entities
        taken = {name for name, _ in self._running.values()}
        names = (record.name, *(f"{record.name} {number}" for number in range(2, len(taken) + 2)))
        name = next(name for name in names if name not in taken)
        marks = Marks(self._columns, self._scene)
        self._running[record.task] = name, marks
        marks.add(record.world, (_TARGETS, name), now, *shapes)

    def _show_failure(self, record: Task | Run, world: str, target: Vector | None, now: TimePoint) -> None:
        failure = kind, message = record.failure.type, record.failure.message
        if failure == self._failure:
            return
        self._failure = failure
        shapes: list[rr.AsComponents] = [rr.TextLog(f"{record.name}: {kind}: {message}", level="ERROR", color=RED)]
        position_failed = (
            target_position(self._scene, world, argument_values(record.failure.data, strict=True)) or target
        )
        robot = self._scene.robot(world)
        if robot is not None and (position_failed is None or math.dist(position_failed, robot[1].pose[0]) > _IN_VIEW):
            position_failed = geometry.transform(robot[1].pose, (0.0, 0.0, _ABOVE_ROBOT))
        if position_failed is not None:
            x, y, z = position_failed
            top = (x, y, z + _PIN)
            label = shorten(f"{record.name}: {message or kind}", _MAX_LETTERS, placeholder=" \u2026")
            shapes += [points_at([top], RED, [label], _FAILURE), line_through([position_failed, top], RED)]
        self._failures.add(world, (FAILURES,), now, *shapes)
        # mark the links that would have collided, at their current positions
        found = argument_values(record.failure.data, strict=True).get("pairs")
        pairs = [pair for pair in found if isinstance(pair, dict)] if isinstance(found, list) else []
        for number, pair in enumerate(pairs[:_MAX_PAIRS], 1):
            ends = []
            for body, link in (("mover", "link"), ("body", "body_link")):
                names = str(pair.get(body, "")), str(pair.get(link, ""))
                pose = self._scene.pose(world, *names)
                if pose is not None:
                    ends.append((pose[0], names[1] or names[0]))
            if len(ends) == 2:
                points, labels = zip(*ends, strict=True)
                line = line_through(points, RED, LINK)
                ends_at = points_at(points, RED, labels, show_labels=False)  # the failure's label names the links
                self._failures.add(world, (_PAIRS, str(number)), now, ends_at, line)


def points_at(
    positions: Sequence[Vector],
    color: Color,
    labels: Sequence[str] = (),
    radius: float = _POINT,
    *,
    show_labels: bool | None = None,
) -> rr.AsComponents:
    """Return points in a colour. The radius is in m. A hidden label appears when the mouse is over its point."""
    return rr.Points3D(positions, colors=[color], radii=[radius], labels=labels or None, show_labels=show_labels)


def line_through(positions: Sequence[Vector], color: Color, radius: float = _LINE, label: str = "") -> rr.AsComponents:
    """Return a line in a colour. The radius is in m."""
    return rr.LineStrips3D([positions], colors=[color], radii=[radius], labels=[label] if label else None)


def _arrow(start: Vector, vector: Vector, color: Color) -> rr.AsComponents:
    return rr.Arrows3D(origins=[start], vectors=[vector], colors=[color], radii=[_ARROW_RADIUS])


_ATTACHMENT_LINE: Final = 0.003  # radius in m


class Attachments:
    """The lines of all attachments. The scene must show each record before this class does."""

    def __init__(self, columns: Columns, scene: ViewerScene) -> None:
        self._columns = columns
        self._scene = scene
        self._paths: dict[tuple[str, str, str], str] = {}  # entities, by world, carrier and body

    def show(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        """Show the changed attachments of a record."""
        world = record.world
        bodies = self._scene.bodies.get(world, {})
        pairs = [key[1:] for key in self._paths if key[0] == world]
        attached, detached = _attachment_changes(record, pairs)
        for pair in {*detached, *(pair for pair in pairs if not {*pair} <= bodies.keys())}:
            path = self._paths.pop((world, *pair), None)
            if path is not None:
                self._columns.clear(path, now)
        for attachment in attached:
            path = self._columns.path(
                world, "attachments", attachment.carrier, attachment.carrier_link or "base", attachment.body
            )
            self._paths[world, attachment.carrier, attachment.body] = path
            self._columns.set_frame(path, self._scene.frame(world, attachment.carrier, attachment.carrier_link))
            x, y, z = attachment.position
            line = line_through([(0.0, 0.0, 0.0), (x, y, z)], YELLOW, _ATTACHMENT_LINE, f"holds {attachment.body}")
            self._columns.send(path, now, line)


def _attachment_changes(
    record: Mutation | Keyframe, pairs: list[tuple[str, str]]
) -> tuple[Iterable[Attachment], list[tuple[str, str]]]:
    """Return the new attachments of a record, and the pairs (carrier, body) whose attachment ended."""
    if not isinstance(record, Keyframe):
        return record.effect.attached, [(ended.carrier, ended.body) for ended in record.effect.detached]
    carried = {(attachment.carrier, attachment.body) for attachment in record.attachments}
    return record.attachments, [pair for pair in pairs if pair not in carried]


_FRUSTUM: Final = 0.6  # length in m
_FRUSTUM_LINE: Final = 0.003  # radius in m


class CameraFrustums:
    """The frustums of the cameras of all robots."""

    def __init__(self, columns: Columns, scene: ViewerScene) -> None:
        self._columns = columns
        self._scene = scene
        self._paths: dict[tuple[str, str], str] = {}  # entities, by world and robot

    def show(self, world: str, now: TimePoint) -> None:
        """Show the cameras of the robots that are in a world now."""
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
            return  # the robot has no camera
        link_T_optical = offset(camera, "frame_offset")
        corners = [
            geometry.transform(link_T_optical, (right * x, down * y, _FRUSTUM))
            for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        strips = [[*corners, corners[0]], *([link_T_optical[0], corner] for corner in corners)]
        self._columns.set_frame(path, frame)
        self._columns.send(path, now, rr.LineStrips3D(strips, colors=[BLUE], radii=[_FRUSTUM_LINE]))


def camera_position(scene: ViewerScene, world: str, camera: object = None, robot_name: str = "") -> Vector | None:
    """Return the position of a camera: a position, pose or frame, by default the robot's camera; or None."""
    robot = scene.robot(world, robot_name)
    if isinstance(camera, list) or robot is None:
        return position(camera)
    name, body = robot
    frame = str(camera or table(body.loaded, "camera").get("frame", ""))
    pose = scene.pose(world, name, frame) if frame else None
    return pose[0] if pose is not None else None


Values: TypeAlias = "dict[str, Any]"


def target_position(scene: ViewerScene, world: str, values: Values) -> Vector | None:
    """Return the first position among values, or else the position of the first object; None if there is neither."""
    bodies = scene.bodies.get(world, {}).items()
    return first_position(values, {name: body.pose[0] for name, body in bodies if not body.loaded.robot_description})


PATHS: Final = "paths"
_PLANNED: Final = 0.004  # radius in m
_DRIVEN: Final = 0.01  # radius in m
_ABOVE_FLOOR: Final = 0.01  # height in m of a base's path above the floor
_MIN_LENGTH: Final = 0.001  # minimum length in m of a tool's path that is shown
_SAMPLES: Final = 6  # the driven line is sent as a whole, after this many samples, about 0.2 s
_ENDING: Final = ("reset", "restore", "close_world")  # commands that end all trajectories


@dataclass(slots=True)
class _Path:
    """The path of one tool frame or base."""

    now: Callable[[], Vector]  # a function that returns the present position in the world
    entity: str  # name of the entity with the planned line
    driven_entity: str  # name of the entity with the line of the driven part
    label: str  # label of the planned line
    planned: Sequence[Vector]  # points in the frame of the planned line's entity
    driven: list[Vector] = field(default_factory=list)  # points in the world


@dataclass(slots=True)
class _Followed:
    following: Following
    paths: list[_Path]


class TrajectoryPaths:
    """The paths of all trajectories. The scene must show each record before this class does."""

    def __init__(self, columns: Columns, scene: ViewerScene) -> None:
        self._columns = columns
        self._scene = scene
        self._followed: dict[str, dict[int, _Followed]] = {}  # trajectories, by world and number
        self._stopped: dict[tuple[str, str], list[_Path]] = {}  # paths of stopped trajectories, by world and body

    def move(self, world: str, body: str, time: TimePoint) -> None:
        """Extend the driven lines of a moved body."""
        for followed in self._followed.get(world, {}).values():
            if followed.following.begin.body == body:
                for path in followed.paths:
                    path.driven.append(path.now())
                    if len(path.driven) % _SAMPLES == 0:
                        self._draw_driven(path, time)

    def show(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        """Show the trajectories that a record begins, stops or ends."""
        world = record.world
        followed = self._followed.setdefault(world, {})
        if isinstance(record, Keyframe):
            self._keep(world, {each.begin.number: each for each in record.following}, now)
            return
        command = record.WhichOneof("command")
        if command == "begin_trajectory":
            self._begin(world, Following(begin=record.begin_trajectory, began=record.sim_step), now)
        elif command == "simulate":
            for each in record.simulate.driven:
                if each.ended:
                    self._end(world, each.number, now, each.time)
        elif command == "stop_trajectory":
            stopped = followed.get(record.stop_trajectory.number)
            if stopped is not None and stopped.following.began == record.sim_step:  # the body hasn't moved yet
                self._end(world, record.stop_trajectory.number, now, 0.0)
        elif command in _ENDING:
            self._remove(world, None, now)
        elif command == "remove_body":
            self._remove(world, record.remove_body.body, now)

    def _keep(self, world: str, following: Mapping[int, Following], now: TimePoint) -> None:
        """Show only the trajectories of a keyframe. ``following`` contains the trajectories by number."""
        followed = self._followed[world]
        for number in followed.keys() - following.keys():
            self._clear(followed.pop(number).paths, now)
        for number in following.keys() - followed.keys():
            self._begin(world, following[number], now)

    def _begin(self, world: str, following: Following, now: TimePoint) -> None:
        begin = following.begin
        self._clear(self._stopped.pop((world, begin.body), ()), now)
        followed = self._followed[world][begin.number] = _Followed(following, [])
        for name, frame, position_now, points in self._lines_of(world, following):
            planned, driven = (
                self._columns.path(world, PATHS, begin.body, name, what) for what in ("planned", "driven")
            )
            self._columns.set_frame(planned, frame)
            self._columns.set_frame(driven, self._scene.frame(world))
            label = f"{name} {begin.trajectory.times[-1]:.1f} s"
            followed.paths.append(_Path(position_now, planned, driven, label, points, [position_now()]))
            self._columns.send(planned, now, line_through(points, BLUE, _PLANNED, label))

    def _lines_of(
        self, world: str, following: Following
    ) -> Iterator[tuple[str, str, Callable[[], Vector], Sequence[Vector]]]:
        """Yield a line for the base, or for each moved tool.

        A line has a name, a frame, a function that returns the current position in the world, and points in the frame.
        """
        begin, scene = following.begin, self._scene
        trajectory, body = begin.trajectory, scene.bodies.get(world, {}).get(begin.body)
        if body is None:
            return
        width = len(trajectory.joints or BASE_COORDINATES)
        rows = [trajectory.positions[at : at + width] for at in range(0, len(trajectory.positions), width)]
        if not trajectory.joints:

            def on_floor() -> Vector:
                x, y, z = body.pose[0]
                return x, y, z + _ABOVE_FLOOR

            height = on_floor()[2]
            yield "base", scene.frame(world), on_floor, [(x, y, height) for x, y, _ in rows]
            return
        for arm, described in table(body.loaded, "arms").items():
            link, tool = str(described.get("tool_frame", "")), offset(described, "tool_offset")
            tool_of = scene.link_position(world, begin.body, link, tool[0])
            if tool_of is None:
                continue
            points = [tool_of(dict(zip(trajectory.joints, row, strict=True))) for row in rows]
            if max(math.dist(points[0], point) for point in points) > _MIN_LENGTH:

                def at_tool(tool_of: Callable[..., Vector] = tool_of) -> Vector:
                    return geometry.transform(body.pose, tool_of({}))

                yield arm, scene.frame(world, begin.body), at_tool, points

    def _end(self, world: str, number: int, now: TimePoint, driven: float) -> None:
        """End a trajectory. ``driven`` is the executed time of the trajectory in s."""
        followed = self._followed[world].pop(number, None)
        if followed is None:
            return  # the trajectory began before the recording did
        begin = followed.following.begin
        if driven >= begin.trajectory.times[-1]:
            self._clear(followed.paths, now)
            return
        self._stopped.setdefault((world, begin.body), []).extend(followed.paths)
        for path in followed.paths:
            self._columns.send(path.entity, now, line_through(path.planned, GREY, _PLANNED, path.label))
            self._draw_driven(path, now)

    def _remove(self, world: str, body: str | None, now: TimePoint) -> None:
        for number, followed in list(self._followed[world].items()):
            if body in (None, followed.following.begin.body):
                self._clear(self._followed[world].pop(number).paths, now)
        for key in [key for key in self._stopped if key[0] == world and body in (None, key[1])]:
            self._clear(self._stopped.pop(key), now)

    def _draw_driven(self, path: _Path, now: TimePoint) -> None:
        if len(path.driven) > 1:
            self._columns.send(path.driven_entity, now, line_through(path.driven, GREEN, _DRIVEN))

    def _clear(self, paths: Sequence[_Path], now: TimePoint) -> None:
        for path in paths:
            self._columns.clear(path.entity, now)
            self._columns.clear(path.driven_entity, now)
