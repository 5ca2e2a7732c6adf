"""Whether one of some postures will do: near enough to the target, and free where that is asked for (thesis 4.4.5)."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from pycram.foundation.failures import BadArgument
from pycram.reasoning.queries.query import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.reasoning.collision.checker import CollisionChecker
    from pycram.reasoning.kinematics.reach import Reach
    from recorder.geometry import Pose

T = TypeVar("T")


def judge(
    options: Sequence[Reach],
    threshold: float,
    rehearsal: CollisionChecker | None,
    *,
    oriented: bool,
    base: Pose | None = None,
) -> Verdict:
    """Judges what inverse kinematics found for one target.

    Args:
        options: at least one; if the first doesn't reach, none does.
        threshold: m that the link may stay away.
        rehearsal: where the robot may touch nothing, itself neither; None if it may.
        oriented: all of them bring the link to one orientation.
        base: where the robot's base is taken to be.

    Returns:
        The answer; the evidence has the posture that will do, or the first that won't and what it touches.
    """
    ways = [option for option in options if option.reached(threshold)]
    evidence = (ways or options)[0].evidence()
    if rehearsal is None or not ways:
        return Verdict(ways, evidence)
    settled = rehearsal.settled(ways[0].link if oriented else None)
    for way, posture in zip(ways, rehearsal.predict([way.posture.positions for way in ways], base), strict=True):
        rehearsal.take(posture)
        touched = rehearsal.touched()
        own = rehearsal.touches_itself()
        if not touched and not own:
            return Verdict(True, way.evidence() | {"obstacles": {}})
        hits: dict[str, object] = {other.name: info for other, info in touched.items()}
        if own:
            hits[rehearsal.robot.name] = {"links": [one for one, _ in own], "by": [other for _, other in own]}
        evidence.setdefault("obstacles", hits)
        if any(link in settled for info in touched.values() for link in _links(info)):
            break  # no other posture will be better
    return Verdict(False, evidence)


def _links(info: Mapping[str, object]) -> list[str]:
    links = info["links"]
    return links if isinstance(links, list) else []


def as_many(name: str, given: Sequence[T], count: int) -> list[T]:
    """One for each.

    Args:
        name: what they are.
        given: as many as needed, or one that goes with all.
        count: how many are needed.

    Raises:
        BadArgument: there are neither one nor that many.
    """
    if len(given) not in {1, count}:
        raise BadArgument(name, len(given), f"1 or {count} of them")
    return [given[0]] * count if len(given) == 1 else list(given)
