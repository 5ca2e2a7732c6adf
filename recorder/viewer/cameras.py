"""Cameras in the scene: where they are, and where those of robots look, as frustums that move with their links."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder import geometry
from recorder.viewer.colors import BLUE
from recorder.viewer.descriptions import offset, table
from recorder.viewer.positions import position

if TYPE_CHECKING:
    from recorder.geometry import Vector
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.scene import Scene, SceneBody

_FRUSTUM: Final = 0.6  # m, length
_LINE: Final = 0.003  # m


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
        self._columns.send(path, now, rr.LineStrips3D(strips, colors=[BLUE], radii=[_LINE]))


def camera_position(scene: Scene, world: str, camera: object = None, robot_name: str = "") -> Vector | None:
    """Where a camera is, given as position, pose or frame, by default the robot's own; None if that isn't known."""
    robot = scene.robot(world, robot_name)
    if isinstance(camera, list) or robot is None:
        return position(camera)
    name, body = robot
    frame = str(camera or table(body.loaded, "camera").get("frame", ""))
    pose = scene.pose(world, name, frame) if frame else None
    return pose[0] if pose is not None else None
