"""What carriers hold, and where robots' cameras look: lines that move with the links that they hang on."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder.records import Keyframe
from recorder.viewer.marks import BLUE, YELLOW
from recorder.viewer.scene_lookup import camera_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from recorder.records import Attachment, Mutation
    from recorder.viewer.columns import Columns, Moment
    from recorder.viewer.scene import Body, Scene

HELD: Final = "attachments"
CAMERA: Final = "camera"
_SIGHT: Final = 0.6  # m that a camera's frustum is drawn long
_LINE: Final = 0.003  # m


class AttachmentMarks:
    """All attachments and cameras.

    Args:
        columns: where they go.
        scene: whose bodies they are on; it has shown a record before they do.
    """

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._columns = columns
        self._scene = scene
        self._held: dict[tuple[str, str, str], str] = {}  # paths by world, carrier and body
        self._cameras: dict[tuple[str, str], str] = {}  # by world and robot

    def show(self, record: Mutation | Keyframe, now: Moment) -> None:
        """Shows what a record changed."""
        world = record.world
        there = self._scene.bodies.get(world, {})
        made, ended = _changes(record, [key[1:] for key in self._held if key[0] == world])
        lost = [key[1:] for key in self._held if key[0] == world and not {*key[1:]} <= there.keys()]
        for pair in {*ended, *lost}:
            path = self._held.pop((world, *pair), None)
            if path is not None:
                self._columns.clear(path, now)
        for one in made:
            self._hold(world, one, now)
        for key in [key for key in self._cameras if key[0] == world and key[1] not in there]:
            self._columns.clear(self._cameras.pop(key), now)
        for name, body in there.items():
            if body.loaded.robot_description and (world, name) not in self._cameras:
                self._look(world, name, body, now)

    def _hold(self, world: str, made: Attachment, now: Moment) -> None:
        path = self._columns.path(world, HELD, made.carrier, made.carrier_link or "base", made.body)
        self._held[world, made.carrier, made.body] = path
        self._columns.stand(path, self._scene.frame(world, made.carrier, made.carrier_link))
        way = [(0.0, 0.0, 0.0), tuple(made.position)]
        self._columns.put(
            path, now, rr.LineStrips3D([way], colors=[YELLOW], radii=[_LINE], labels=[f"holds {made.body}"])
        )

    def _look(self, world: str, name: str, body: Body, now: Moment) -> None:
        path = self._cameras[world, name] = self._columns.path(world, CAMERA, name)
        camera = camera_of(body.loaded)
        try:
            right, down = (math.tan(camera[f"{way}_fov"] / 2) * _SIGHT for way in ("horizontal", "vertical"))
            frame = self._scene.frame(world, name, str(camera["frame"]))
        except (KeyError, TypeError):
            return  # a robot without one
        corners = [(-right, -down, _SIGHT), (right, -down, _SIGHT), (right, down, _SIGHT), (-right, down, _SIGHT)]
        strips = [[*corners, corners[0]], *([(0.0, 0.0, 0.0), corner] for corner in corners)]
        self._columns.stand(path, frame)
        self._columns.put(path, now, rr.LineStrips3D(strips, colors=[BLUE], radii=[_LINE]))


def _changes(
    record: Mutation | Keyframe, held: list[tuple[str, str]]
) -> tuple[Iterable[Attachment], list[tuple[str, str]]]:
    """Attachments that were made, and pairs of carrier and body that ended."""
    if not isinstance(record, Keyframe):
        return record.effect.attached, [(one.carrier, one.body) for one in record.effect.detached]
    made = {(one.carrier, one.body) for one in record.attachments}
    return record.attachments, [pair for pair in held if pair not in made]
