"""What the last query found, in the scene: what it was about, which posture it tried, what touches, hides or blocks.

Green where the answer is yes (or nothing blocks), red where it is no. The marks stand until the next query is asked or
the next task begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder.records.text import by_name
from recorder.viewer.marks import GREEN, RED, Marks, line, points
from recorder.viewer.scene_lookup import eye, name_of, position, target, values_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    import rerun as rr

    from recorder.geometry import Vector
    from recorder.records import Query, Task
    from recorder.viewer.columns import Columns, Moment
    from recorder.viewer.marks import Color
    from recorder.viewer.scene import Scene
    from recorder.viewer.scene_lookup import Values

ANSWERS: Final = "answers"
_NO: Final = ("false", "null", "[]", "")
_IN_THE_WAY: Final = {"obstacles": "is in the way", "hidden_by": "hides it"}  # by the evidence that names them
_LIMB: Final = 0.015  # m
_LETTERS: Final = 60


class Answers:
    """The last query's marks.

    Args:
        columns: where they go.
        scene: whose bodies they speak of.
    """

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._scene = scene
        self._marks = Marks(columns, scene)

    def begin(self, record: Task, now: Moment) -> None:
        """Takes a task's start or end."""
        if record.phase == record.STARTED:
            self._marks.clear(now)

    def show(self, record: Query, now: Moment) -> None:
        """Shows a query."""
        self._marks.clear(now)
        if not record.world:
            return
        values, found = values_of(record.arguments), values_of(record.evidence)
        if not values and not found:
            return  # nothing that has a place
        good = not found["obstacles"] if "obstacles" in found else record.answer_json not in _NO
        for name, shape in self._shapes(record, values, found, GREEN if good else RED):
            self._marks.put(record.world, (ANSWERS, record.name, name), now, shape)

    def _shapes(
        self, record: Query, values: Values, found: Values, color: Color
    ) -> Iterator[tuple[str, rr.AsComponents]]:
        world = record.world
        thing = target(self._scene, world, {name: value for name, value in values.items() if name != "camera"})
        goal = position(found.get("position")) or thing
        if goal is not None:
            yield "target", points([goal], color, [f"{record.name}: {by_name(record.answer_json)}"[:_LETTERS]])
        for evidence, verb in _IN_THE_WAY.items():
            places = dict(self._places(world, found.get(evidence)))
            if places:
                yield evidence, points(list(places.values()), RED, [f"{name} {verb}" for name in places])
        whose = name_of(values.get("robot"))
        start = eye(self._scene, world, values["camera"], whose) if "camera" in values else None
        if start is not None and thing is not None:
            yield "sight", line([start, thing], color)
        touches = [place for one in found.get("points") or () if (place := position(one)) is not None]
        if touches:
            yield "contacts", points(touches, color)
        joints, link = found.get("joints"), values.get("gripper")
        if isinstance(joints, dict) and isinstance(link, str):
            posture = self._scene.posture(world, whose, link, joints)
            if posture:
                yield "posture", line(posture, color, _LIMB)

    def _places(self, world: str, names: object) -> Iterator[tuple[str, Vector]]:
        for name in names if isinstance(names, dict) else ():
            pose = self._scene.pose(world, name)
            if pose is not None:
                yield name, pose[0]
