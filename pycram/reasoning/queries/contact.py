"""Contact and support, as they are now: geometry alone, nothing is stepped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pycram.physics.contacts import ClosestPoint
    from pycram.world.object import Object

MARGIN: Final = 1e-3
"""m; bodies at rest keep up to half a millimetre of air in the engine, which a person would call touching."""


def touches(a: Object, b: Object, margin: float = MARGIN) -> list[ClosestPoint]:
    """Where two objects touch.

    Args:
        a: one.
        b: the other.
        margin: m up to which a gap counts as touching.

    Returns:
        The touches; none of an object with itself.
    """
    if a is b:
        return []  # the engine would tell how a body overlaps itself
    engine = a.world.engine
    return [touch for touch in engine.closest_points(a.handle, b.handle, margin) if touch.distance <= margin]


def evidence(found: list[ClosestPoint]) -> dict[str, object]:
    """Links, points and depths of touches, for the record."""
    return {
        "links": sorted({(touch.link_a, touch.link_b) for touch in found}),
        "points": [touch.position_b for touch in found],
        "distance": min((touch.distance for touch in found), default=None),
    }


def supports(lower: Object, upper: Object) -> tuple[bool, Mapping[str, object]]:
    """Whether one object carries another from below.

    The normals of their contacts have to point up: to compare origins would call a wall the support of what leans
    against it, and would miss the hook that a cup hangs on.

    Args:
        lower: the one that would carry.
        upper: the one that would be carried.

    Returns:
        The answer, and the links and normals that it rests on.
    """
    found = touches(lower, upper)
    carrying = [touch for touch in found if touch.carries]
    return bool(carrying), {
        "links": sorted({touch.link_a for touch in carrying}),
        "normals": [[-x for x in touch.normal] for touch in carrying],
        "touches": len(found),
    }
