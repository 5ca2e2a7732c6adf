"""Contact and support in the present state of the world, without a simulation."""

from __future__ import annotations

from typing import Final

from pycram.physics.body import ClosestPoint
from pycram.reasoning.queries.query import Verdict, query
from pycram.world.object import Object
from pycram.world.world import BulletWorld

MARGIN: Final = 1e-3  # maximum gap in m of touching objects; the engine leaves up to 0.5 mm between resting objects


@query
def contact(object1: Object, object2: Object, world: BulletWorld | None = None, *, margin: float = 0.0) -> Verdict:
    """Return whether two objects touch now, without a simulation (thesis 4.4.2).

    Args:
        margin: m, largest gap between touching objects, beyond the engine's millimetre.

    Returns:
        The answer. The evidence has the links and the contact points.
    """
    found = touches(object1, object2, MARGIN + margin)
    return Verdict(found, evidence(found))


@query
def supporting(object1: Object, object2: Object, world: BulletWorld | None = None) -> Verdict:
    """Return whether the first object carries the second from below (thesis 4.4.7).

    The normals of the contacts between both objects must point up. A wall doesn't support an object that leans against
    it, but a hook supports a cup that hangs on it.

    Returns:
        The answer. The evidence has the links and the normals of the support.
    """
    found = touches(object1, object2)
    carrying = [touch for touch in found if touch.carries]
    return Verdict(
        carrying,
        {
            "links": sorted({touch.link_a for touch in carrying}),
            "normals": [[-x for x in touch.normal] for touch in carrying],
            "touches": len(found),
        },
    )


def touches(a: Object, b: Object, margin: float = MARGIN) -> list[ClosestPoint]:
    """Return where two objects of one world touch, with gaps up to a margin in m; empty if both are the same object."""
    if a is b:
        return []  # the engine would report overlaps of a body with itself
    return [touch for touch in a.world.engine.closest_points(a.handle, b.handle, margin) if touch.distance <= margin]


def evidence(found: list[ClosestPoint]) -> dict[str, object]:
    """Return the links, points and distance of touches as evidence for a record."""
    return {
        "links": sorted({(touch.link_a, touch.link_b) for touch in found}),
        "points": [touch.position for touch in found],
        "distance": min((touch.distance for touch in found), default=None),
    }
