"""What moves along: things that an object carries, and things that lie on or in a drawer.

Attachments are followed through chains. A thing rides on a moving link if it rests on it or was put just above its
floor, or rests on something that rides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pycram.world.object import Object
    from pycram.world.transaction import Change
    from recorder.geometry import Pose
    from recorder.geometry.urdf import Urdf

_GAP: Final = 0.003  # m; a settled body keeps about half a millimetre to what it lies on
_DROP: Final = 0.03  # m that something put into a drawer may hang over its floor


def follow(carrier: Object, change: Change) -> None:
    """Puts everything that an object carries where its relative pose says.

    Args:
        carrier: an object that has moved, or whose joints have.
        change: notes what moved along.
    """
    engine = carrier.world.engine
    for attachment in carrier.carried:
        held = attachment.body
        pose = geometry.multiply(engine.link_pose(carrier.handle, attachment.carrier_link), attachment.pose)
        engine.set_pose(held.handle, pose)
        change.touch(held)
        follow(held, change)


def moved_links(urdf: Urdf, joints: Iterable[str]) -> list[str]:
    """The links that move with joints.

    Args:
        urdf: of the object.
        joints: names of its joints.

    Returns:
        Their child links and all links below, in the URDF's order.
    """
    moved = {urdf.joint(name).child for name in joints}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        if joint is not None and joint.parent in moved:
            moved.add(link)
    return [link for link in urdf.links if link in moved]


def riders(container: Object, links: Iterable[str]) -> dict[Object, str]:
    """What lies on or in moving links.

    Args:
        container: the object that the links belong to.
        links: links that are going to move together.

    Returns:
        For each free thing that rides, the link that carries it, directly or through other things.
    """
    world = container.world
    engine = world.engine
    free = [body for body in world.objects if not body.fixed and body.carrier is None]
    found: dict[Object, str] = {}
    for link in links:
        lower, upper = engine.box(container.handle, link)
        for body in free:
            if body in found:
                continue
            at = engine.pose(body.handle)[0]
            inside = all(low <= x <= high for low, x, high in zip(lower, at, upper, strict=True))
            gap = _DROP if inside else _GAP
            touches = engine.link_touches(container.handle, link, body.handle, gap)
            if any(touch.carries for touch in touches):
                found[body] = link
    queue = list(found)
    while queue:
        below = queue.pop()
        for body in free:
            if body in found:
                continue
            touches = engine.touches(below.handle, body.handle, _GAP)
            if any(touch.carries for touch in touches):
                found[body] = found[below]
                queue.append(body)
    return found


def ride(container: Object, before: Mapping[str, Pose], riding: Mapping[Object, str], change: Change) -> None:
    """Moves riders as their links have moved.

    Args:
        container: the object whose links have moved.
        before: poses of these links before.
        riding: what :func:`riders` found before.
        change: notes what moved along.
    """
    engine = container.world.engine
    for body, link in riding.items():
        moved = geometry.multiply(engine.link_pose(container.handle, link), geometry.invert(before[link]))
        engine.set_pose(body.handle, geometry.multiply(moved, engine.pose(body.handle)))
        change.touch(body)
        follow(body, change)
