"""What carriers hold, and where robots' cameras look: lines that move with the links that they hang on."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder import geometry
from recorder.records import Keyframe
from recorder.viewer.marks import BLUE, YELLOW
from recorder.viewer.scene_lookup import camera_of, camera_offset

if TYPE_CHECKING:
    from collections.abc import Iterable

    from recorder.records import Attachment, Mutation
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.scene import Scene, SceneBody

_FRUSTUM: Final = 0.6  # m, length of a camera's
_LINE: Final = 0.003  # m


class AttachmentMarks:
    """All attachments and cameras; the scene has shown a record before they do."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._attached: dict[tuple[str, str, str], str] = {}  # paths by world, carrier and body
        self._cameras: dict[tuple[str, str], str] = {}  # paths by world and robot

    def show(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        """Shows what a record changed."""
        world = record.world
        bodies = self._scene.bodies.get(world, {})
        pairs = [key[1:] for key in self._attached if key[0] == world]
        attached, detached = _changes(record, pairs)
        for pair in {*detached, *(pair for pair in pairs if not {*pair} <= bodies.keys())}:
            path = self._attached.pop((world, *pair), None)
            if path is not None:
                self._columns.clear(path, now)
        for attachment in attached:
            self._show_attachment(world, attachment, now)
        for key in [key for key in self._cameras if key[0] == world and key[1] not in bodies]:
            self._columns.clear(self._cameras.pop(key), now)
        for name, body in bodies.items():
            if body.loaded.robot_description and (world, name) not in self._cameras:
                self._show_camera(world, name, body, now)

    def _show_attachment(self, world: str, attachment: Attachment, now: TimePoint) -> None:
        path = self._columns.path(
            world, "attachments", attachment.carrier, attachment.carrier_link or "base", attachment.body
        )
        self._attached[world, attachment.carrier, attachment.body] = path
        self._columns.set_frame(path, self._scene.frame(world, attachment.carrier, attachment.carrier_link))
        line = [(0.0, 0.0, 0.0), tuple(attachment.position)]
        self._columns.send(
            path, now, rr.LineStrips3D([line], colors=[YELLOW], radii=[_LINE], labels=[f"holds {attachment.body}"])
        )

    def _show_camera(self, world: str, name: str, body: SceneBody, now: TimePoint) -> None:
        path = self._cameras[world, name] = self._columns.path(world, "camera", name)
        camera = camera_of(body.loaded)
        try:
            right, down = (math.tan(camera[f"{axis}_fov"] / 2) * _FRUSTUM for axis in ("horizontal", "vertical"))
            frame = self._scene.frame(world, name, str(camera["frame"]))
        except (KeyError, TypeError):
            return  # a robot without one
        offset = camera_offset(camera)
        corners = [
            geometry.transform(offset, (right * x, down * y, _FRUSTUM)) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        strips = [[*corners, corners[0]], *([offset[0], corner] for corner in corners)]
        self._columns.set_frame(path, frame)
        self._columns.send(path, now, rr.LineStrips3D(strips, colors=[BLUE], radii=[_LINE]))


def _changes(
    record: Mutation | Keyframe, pairs: list[tuple[str, str]]
) -> tuple[Iterable[Attachment], list[tuple[str, str]]]:
    """Attachments that were made, and those of the pairs of carrier and body that ended."""
    if not isinstance(record, Keyframe):
        return record.effect.attached, [(ended.carrier, ended.body) for ended in record.effect.detached]
    carried = {(attachment.carrier, attachment.body) for attachment in record.attachments}
    return record.attachments, [pair for pair in pairs if pair not in carried]
