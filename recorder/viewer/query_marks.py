"""Marks of the last query: its target and posture, and what touches, hides or blocks; until the next task begins.

They are green where its answer is yes (or nothing blocks), red where it is no.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records import argument_values
from recorder.records.text import by_name
from recorder.viewer.cameras import camera_position
from recorder.viewer.marks import GREEN, RED, Marks, line, points
from recorder.viewer.positions import name_of, position, target_position

if TYPE_CHECKING:
    from collections.abc import Iterator

    import rerun as rr

    from recorder.records import Query
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.marks import Color
    from recorder.viewer.positions import Values
    from recorder.viewer.scene import Scene

_ANSWERS: Final = "answers"
_LINK: Final = 0.015  # m
_MAX_LETTERS: Final = 60
_NO: Final = ("false", "null", "[]", "")
_BLOCKING: Final = {"obstacles": "is in the way", "hidden_by": "hides it"}  # by the evidence that names the bodies


class QueryMarks:
    """The marks of one query at a time."""

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
            yield "target", points([target], color, [f"{record.name}: {by_name(record.answer_json)}"[:_MAX_LETTERS]])
        for fact, verb in _BLOCKING.items():
            names = evidence.get(fact)
            poses = {name: scene.pose(world, name) for name in names} if isinstance(names, dict) else {}
            positions = {name: pose[0] for name, pose in poses.items() if pose is not None}
            if positions:
                yield fact, points(list(positions.values()), RED, [f"{name} {verb}" for name in positions])
        robot_name = name_of(values.get("robot"))
        camera = camera_position(scene, world, values["camera"], robot_name) if "camera" in values else None
        if camera is not None and body is not None:
            yield "sight", line([camera, body], color)
        contacts = [point for value in evidence.get("points") or () if (point := position(value)) is not None]
        if contacts:
            yield "contacts", points(contacts, color)
        joints, link = evidence.get("joints"), values.get("gripper")
        if isinstance(joints, dict) and isinstance(link, str):
            posture = scene.posture(world, robot_name, link, joints)
            if posture:
                yield "posture", line(posture, color, _LINK)
