"""Contact and support in the present state of the world; no time is simulated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.reasoning.queries.query import Verdict, query

if TYPE_CHECKING:
    from pycram.physics.body import ClosestPoint
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

MARGIN: Final = 1e-3
"""m; resting objects keep up to half a millimetre of air in the engine, but count as touching."""


@query
def contact(object1: Object, object2: Object, world: BulletWorld | None = None, *, margin: float = 0.0) -> Verdict:
    """Return whether two objects touch now (thesis 4.4.2); no time is simulated.

    Args:
        world: their world.
        margin: m of distance that counts as touching, beyond the millimetre of the engine.

    Returns:
        The answer. The evidence has the links and the contact points.
    """
    found = touches(object1, object2, MARGIN + margin)
    return Verdict(found, evidence(found))


@query
def supporting(object1: Object, object2: Object, world: BulletWorld | None = None) -> Verdict:
    """Return whether the first object carries the second from below (thesis 4.4.7).

    The normals of their contacts must point up. A comparison of origins would call a wall the support of an object
    that leans against it, and would miss the hook on which a cup hangs.

    Args:
        object1: the support.
        object2: the object on it.

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
    """Return where two objects of one world touch; the result is empty if they are the same object.

    Args:
        b: an object of the same world.
        margin: m up to which a gap counts as touching.
    """
    if a is b:
        return []  # the engine would report overlaps of a body with itself
    engine = a.world.engine
    return [touch for touch in engine.closest_points(a.handle, b.handle, margin) if touch.distance <= margin]


def evidence(found: list[ClosestPoint]) -> dict[str, object]:
    """Return links, points and depth of touches as evidence for a record."""
    return {
        "links": sorted({(touch.link_a, touch.link_b) for touch in found}),
        "points": [touch.position for touch in found],
        "distance": min((touch.distance for touch in found), default=None),
    }
