"""What was out of reach, or would not do in any other way that was considered, and what had put it there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from replay.explain.causes.cause import NoCandidate, OutOfReach
from replay.explain.causes.robot_description import joints_of
from replay.history.tasks import choices

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.explain.causes.case import Case


def no_candidate(case: Case) -> Iterator[NoCandidate]:
    """Yield the last choice of the failed motion, if none of what was considered would do."""
    if case.task is None or case.motion is None:
        return
    last = next(reversed(list(choices(case.log, case.task, case.step + 1))), None)
    if last is not None and last.chosen < 0:
        count = sum(each.count or len(each.names) for each in last.candidates)
        if count:
            yield NoCandidate((last.seq, case.step), last, count)


def out_of_reach(case: Case) -> Iterator[OutOfReach]:
    """Yield how far away it was, and what put the robot, its torso and the object there."""
    if case.failure.type not in ("Unreachable", "HandleUnreachable") or case.robot is None or case.motion is None:
        return
    body = next((name for name in case.subjects if case.free_body(name) is not None), "")
    taken = body if case.motion.name == "pick-up" else ""
    target = case.data.get("target")
    if not isinstance(target, list) or len(target) != 3:
        return
    distance = math.dist([float(str(part)) for part in target[:2]], case.robot.position[:2])
    miss, turned = case.data.get("distance"), case.given.get("orientation")
    torso = (f"{case.robot.name}.{joint}" for joint in joints_of(case.robot, "torso"))
    changed = (case.changed(name) for name in (case.robot.name, taken, *torso) if name)
    changes = tuple(sorted((each for each in changed if each is not None), key=lambda change: change.step))
    yield OutOfReach(
        (*(change.step for change in changes), case.step),
        str(case.data.get("arm") or case.given.get("arm") or ""),
        taken,
        distance,
        float(miss) if isinstance(miss, int | float) else None,
        tuple(float(str(part)) for part in turned) if isinstance(turned, list) else (),
        changes,
    )
