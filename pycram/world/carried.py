"""Attached and supported bodies: what moves together with an object or with its drawers.

Attached bodies keep their relative pose, through chains. A body is supported by a link if it rests on it, hangs just
above its floor after being put in, or rests on a supported body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pycram.world.object import Object
    from pycram.world.transaction import Transaction
    from recorder.geometry import Pose
    from recorder.urdf import Urdf

_CONTACT_GAP: Final = 0.003  # m; a settled body keeps about half a millimetre to what it lies on
_DROP_HEIGHT: Final = 0.03  # m that something put into a drawer may hang over its floor


def move_attached(carrier: Object, transaction: Transaction) -> None:
    """Put everything that an object carries to its relative pose, after the object or its joints have moved."""
    engine = carrier.world.engine
    for attachment in carrier.carried:
        body = attachment.body
        pose = geometry.multiply(engine.link_pose(carrier.handle, attachment.carrier_link), attachment.pose)
        engine.set_pose(body.handle, pose)
        transaction.mark_modified(body)
        move_attached(body, transaction)


def attached_to(carrier: Object, link: str) -> Object | None:
    """Return what is attached to a link of an object; None if nothing is."""
    return next((attachment.body for attachment in carrier.carried if attachment.carrier_link == link), None)


def root_of(body: Object) -> Object:
    """Return what carries an object in the end, directly or through other things; itself if nothing does."""
    while body.carrier is not None:
        body = body.carrier
    return body


def moved_links(urdf: Urdf, joints: Iterable[str]) -> list[str]:
    """Return the links that move with joints: their child links and all below, in the URDF's order."""
    moved = {urdf.joint(name).child for name in joints}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        if joint is not None and joint.parent in moved:
            moved.add(link)
    return [link for link in urdf.links if link in moved]


def supported_bodies(container: Object, links: Iterable[str]) -> dict[Object, str]:
    """Return the free bodies on or in links of an object, each with the link that supports it, also indirectly."""
    world = container.world
    engine = world.engine
    free = [body for body in world.objects if not body.fixed and body.carrier is None]
    found: dict[Object, str] = {}
    for link in links:
        lower, upper = engine.box(container.handle, link)
        for body in free:
            if body in found:
                continue
            position = engine.pose(body.handle)[0]
            inside = all(low <= x <= high for low, x, high in zip(lower, position, upper, strict=True))
            gap = _DROP_HEIGHT if inside else _CONTACT_GAP
            if any(p.carries for p in engine.link_closest_points(container.handle, link, body.handle, gap)):
                found[body] = link
    queue = list(found)
    while queue:
        below = queue.pop()
        for body in free:
            if body not in found and any(
                point.carries for point in engine.closest_points(below.handle, body.handle, _CONTACT_GAP)
            ):
                found[body] = found[below]
                queue.append(body)
    return found


def move_supported(
    container: Object, before: Mapping[str, Pose], supported: Mapping[Object, str], transaction: Transaction
) -> None:
    """Move supported bodies as their links have moved.

    Args:
        container: The object whose links have moved.
        before: Poses of these links before.
        supported: What :func:`supported_bodies` returned before.
        transaction: Marks what moved along.
    """
    engine = container.world.engine
    for body, link in supported.items():
        moved = geometry.multiply(engine.link_pose(container.handle, link), geometry.invert(before[link]))
        engine.set_pose(body.handle, geometry.multiply(moved, engine.pose(body.handle)))
        transaction.mark_modified(body)
        move_attached(body, transaction)
