"""What the robot believed of an object that it acted on, where that was wrong: somebody had moved it since."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from replay.explain.causes.cause import Misbelief

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.explain.causes.case import Case

_ABOUT: Final = frozenset(
    ("Blocked", "GraspFailed", "LookingFailed", "ObjectNotFound", "PerceptionError", "PlaceFailed", "Unreachable")
)
_AWAY: Final = 0.02  # m; less is settling


def find(case: Case) -> Iterator[Misbelief]:
    """Yield the beliefs about what a failure is about that were wrong when what failed began."""
    world = case.before
    if case.failure.type not in _ABOUT or world is None:
        return
    sought = case.data.get("object_type")
    names = {*case.mentioned, *(body.name for body in world.bodies.values() if body.type == sought)}
    for belief in world.believed(robot=world.robot):
        body = world.bodies[belief.object]
        away = math.dist(belief.position, body.position)
        if belief.object not in names or away < _AWAY:
            continue
        moved = case.changed(belief.object)
        change = moved if moved is not None and moved.step > belief.step else None
        steps = sorted({step for step in (belief.step, change.step if change else -1, case.step) if step >= 0})
        yield Misbelief(tuple(steps), belief.object, belief.source, belief.step, belief.position, away, change)
