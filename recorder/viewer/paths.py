"""Paths of trajectories in the scene: where the tool frames of arms, and bases, are to go, and where they went.

What is planned is a blue line, and what of it was driven a thicker green one that covers it. Both go when the body is
at its end. Of a trajectory that was stopped on its way they stay, in grey what was planned, until the body begins the
next one: what went wrong is looked at afterwards. The planned path of a tool moves with the robot's base.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder import geometry
from recorder.records import Following, Keyframe
from recorder.records.motion import BASE_COORDINATES
from recorder.viewer.rerun_stream import BLUE, GREEN, GREY
from recorder.viewer.scene import offset, table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from recorder.geometry import Vector
    from recorder.records import Mutation
    from recorder.viewer.rerun_stream import Color, Columns, TimePoint
    from recorder.viewer.scene import Scene

PATHS: Final = "paths"
_PLANNED: Final = 0.004  # m, radius
_DRIVEN: Final = 0.01  # m
_ABOVE_FLOOR: Final = 0.01  # m, of a base's path, which would lie in the floor
_MIN_LENGTH: Final = 0.001  # m; a tool that only turns has no path
_SAMPLES: Final = 6  # after which the driven line grows, a fifth of a simulated second; each time all of it is sent
_ENDING: Final = ("reset", "restore", "close_world")  # commands after which nothing is followed


@dataclass(slots=True)
class _Path:
    """Of a tool frame or base.

    Attributes:
        now: gives where it is, in the world.
        entity: path of the planned line's entity.
        driven_entity: path of the driven line's.
        label: of the planned line.
        planned: points in the frame of the planned line's entity.
        driven: points in the world.
    """

    now: Callable[[], Vector]
    entity: str
    driven_entity: str
    label: str
    planned: Sequence[Vector]
    driven: list[Vector] = field(default_factory=list)


@dataclass(slots=True)
class _Followed:
    """A trajectory, and its paths."""

    following: Following
    paths: list[_Path]


class TrajectoryPaths:
    """The paths of all trajectories; the scene has shown a record before they do."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._followed: dict[str, dict[int, _Followed]] = {}  # by world and number
        self._stopped: dict[tuple[str, str], list[_Path]] = {}  # by world and body

    def move(self, world: str, body: str, time: TimePoint) -> None:
        """Lengthens the driven lines of a body that has moved."""
        for followed in self._followed.get(world, {}).values():
            if followed.following.begin.body == body:
                for path in followed.paths:
                    path.driven.append(path.now())
                    if len(path.driven) % _SAMPLES == 0:
                        self._draw_driven(path, time)

    def show(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        """Shows which trajectories a record begins, stops or ends."""
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
            if stopped is not None and stopped.following.began == record.sim_step:  # it hasn't moved yet
                self._end(world, record.stop_trajectory.number, now, 0.0)
        elif command in _ENDING:
            self._remove(world, None, now)
        elif command == "remove_body":
            self._remove(world, record.remove_body.body, now)

    def _keep(self, world: str, following: Mapping[int, Following], now: TimePoint) -> None:
        """Shows the trajectories of a keyframe, by number, and no others."""
        followed = self._followed[world]
        for number in followed.keys() - following.keys():
            self._clear(followed.pop(number).paths, now)
        for number in following.keys() - followed.keys():
            self._begin(world, following[number], now)

    def _begin(self, world: str, following: Following, now: TimePoint) -> None:
        begin = following.begin
        self._clear(self._stopped.pop((world, begin.body), ()), now)
        paths = list(self._paths_of(world, following))
        self._followed[world][begin.number] = _Followed(following, paths)
        for path in paths:
            path.driven.append(path.now())
            self._draw(path.entity, path.planned, BLUE, now, _PLANNED, path.label)

    def _paths_of(self, world: str, following: Following) -> Iterator[_Path]:
        """The paths that a trajectory has: of its body's base, or of the tools that its joints move."""
        begin, scene = following.begin, self._scene
        trajectory, body = begin.trajectory, scene.bodies.get(world, {}).get(begin.body)
        if body is None:
            return
        width = len(trajectory.joints or BASE_COORDINATES)
        rows = [trajectory.positions[at : at + width] for at in range(0, len(trajectory.positions), width)]
        seconds = f"{trajectory.times[-1]:.1f} s"
        if not trajectory.joints:

            def on_floor() -> Vector:
                x, y, z = body.pose[0]
                return x, y, z + _ABOVE_FLOOR

            height = on_floor()[2]
            points = [(x, y, height) for x, y, _ in rows]
            yield self._path(world, begin.body, "base", scene.frame(world), on_floor, points, seconds)
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

                frame = scene.frame(world, begin.body)
                yield self._path(world, begin.body, arm, frame, at_tool, points, seconds)

    def _path(
        self,
        world: str,
        body: str,
        name: str,
        frame: str,
        now: Callable[[], Vector],
        points: Sequence[Vector],
        seconds: str,
    ) -> _Path:
        planned, driven = (self._columns.path(world, PATHS, body, name, what) for what in ("planned", "driven"))
        self._columns.set_frame(planned, frame)
        self._columns.set_frame(driven, self._scene.frame(world))
        return _Path(now, planned, driven, f"{name} {seconds}", points)

    def _end(self, world: str, number: int, now: TimePoint, driven: float) -> None:
        """Ends a trajectory of which so many seconds were driven."""
        followed = self._followed[world].pop(number, None)
        if followed is None:
            return  # its beginning isn't on record
        begin = followed.following.begin
        if driven >= begin.trajectory.times[-1]:
            self._clear(followed.paths, now)
            return
        self._stopped.setdefault((world, begin.body), []).extend(followed.paths)
        for path in followed.paths:
            self._draw(path.entity, path.planned, GREY, now, _PLANNED, path.label)
            self._draw_driven(path, now)

    def _remove(self, world: str, body: str | None, now: TimePoint) -> None:
        """Removes the paths of a body, or of all."""
        for number, followed in list(self._followed[world].items()):
            if body in (None, followed.following.begin.body):
                self._clear(self._followed[world].pop(number).paths, now)
        for key in [key for key in self._stopped if key[0] == world and body in (None, key[1])]:
            self._clear(self._stopped.pop(key), now)

    def _draw_driven(self, path: _Path, now: TimePoint) -> None:
        if len(path.driven) > 1:
            self._draw(path.driven_entity, path.driven, GREEN, now, _DRIVEN)

    def _draw(
        self, entity: str, points: Sequence[Vector], color: Color, now: TimePoint, radius: float, label: str = ""
    ) -> None:
        labels = [label] if label else None
        self._columns.send(entity, now, rr.LineStrips3D([points], colors=[color], radii=[radius], labels=labels))

    def _clear(self, paths: Sequence[_Path], now: TimePoint) -> None:
        for path in paths:
            self._columns.clear(path.entity, now)
            self._columns.clear(path.driven_entity, now)
