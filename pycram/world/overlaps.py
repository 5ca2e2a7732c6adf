"""Overlaps: objects that are partly or completely inside of each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder import geometry, records

if TYPE_CHECKING:
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld

DEEP: Final = 5e-3  # maximum allowed depth in m; the solver lets resting objects overlap a little

_SUNK: Final = 0.015  # depth in m below a surface; the engine doesn't push deeper objects straight up


class Overlapping(UserWarning):
    """An object was loaded inside of other objects; a simulation would throw them apart or jam them."""


def overlaps(body: Object) -> list[records.Overlap]:
    """Return the deepest overlap of an object with each other object, except between two fixed objects."""
    found = []
    for other in body.world.objects:
        if other is body or (body.fixed and other.fixed):
            continue
        deepest = body.world.engine.deepest(body.handle, other.handle)
        if deepest is not None and deepest.distance < -DEEP:
            links = {"link": deepest.link_a, "body": other.name, "body_link": deepest.link_b}
            found.append(records.Overlap(**links, depth=-deepest.distance))
    return found


def sunk(world: BulletWorld) -> list[tuple[Object, records.Overlap, float]]:
    """Return the free objects that stick in a surface of furniture: their underside is far below the surface.

    The results have the overlap of each object, and the distance in m from its underside up to the surface. The engine
    throws such an object away, sometimes through the furniture. Objects inside of a hull of furniture don't count if no
    surface passes through them.
    """
    found = []
    furniture = [body for body in world.objects if body.fixed and not body.is_robot]
    for body in [each for each in world.objects if not (each.fixed or each.attachments)]:
        (_, _, low), (_, _, high) = body.get_AABB()
        for other in furniture:
            deepest = world.engine.deepest(body.handle, other.handle)
            if deepest is None or deepest.distance >= -DEEP:
                continue
            for surface in other.surfaces.values():
                pose = other.surface_pose(surface)
                x, y, _ = geometry.transform(geometry.invert(pose), body.get_position())
                rise = pose[0][2] - low
                if _SUNK < rise < high - low and geometry.margin_in_polygon(surface.outline, (x, y)) > 0.0:
                    links = {"link": deepest.link_a, "body": other.name, "body_link": deepest.link_b}
                    found.append((body, records.Overlap(**links, depth=-deepest.distance), rise))
                    break
    return found
