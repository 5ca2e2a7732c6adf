"""Attachments in the scene: lines from carriers to what they hold, which move with the carriers' links."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder.records import Keyframe
from recorder.viewer.colors import YELLOW

if TYPE_CHECKING:
    from collections.abc import Iterable

    from recorder.records import Attachment, Mutation
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.scene import Scene

_LINE: Final = 0.003  # m


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
        attached, detached = _changes(record, pairs)
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
            path, now, rr.LineStrips3D([line], colors=[YELLOW], radii=[_LINE], labels=[f"holds {attachment.body}"])
        )


def _changes(
    record: Mutation | Keyframe, pairs: list[tuple[str, str]]
) -> tuple[Iterable[Attachment], list[tuple[str, str]]]:
    """Attachments that were made, and those of the pairs of carrier and body that ended."""
    if not isinstance(record, Keyframe):
        return record.effect.attached, [(ended.carrier, ended.body) for ended in record.effect.detached]
    carried = {(attachment.carrier, attachment.body) for attachment in record.attachments}
    return record.attachments, [pair for pair in pairs if pair not in carried]
