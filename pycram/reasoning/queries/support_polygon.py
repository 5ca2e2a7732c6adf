"""Support polygons: whether bodies at rest stand firmly. A knife on its end is at rest too, until it falls.

A body stands firmly if the center of mass of it and of all that rests on it lies well within its support polygon: where
its underside and the tops of what carries it overlap, and between the points that carry it, as a spoon in a bowl, where
friction holds it: forces straight up are possible there, and balance it. A ball never stands firmly: only time shows
whether it rolls.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.visual import shapes_of
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.contacts import Contact
    from pycram.physics.engine import Engine
    from recorder.geometry import Vector

    Points = NDArray[np.float64]

_CARRYING: Final = 0.3  # of a normal's length pointing up
_FLAT: Final = 0.002  # m within which corners are of one level
_FRICTION: Final = 0.8  # of friction's angle that a contact may slope
_TILT: Final = math.radians(3)  # by which a firm body can be tilted before it tips


def stands_firmly(engine: Engine, models: Mapping[Body, Path], standing: Sequence[Body], gravity: Vector) -> bool:
    """Return whether bodies stand firmly.

    Args:
        engine: where they have just been simulated.
        models: canonical URDFs of all bodies that are there.
        standing: the bodies in question; all others carry without giving way.
        gravity: m/s^2.

    Returns:
        False also where this can't be decided.
    """
    strength = math.hypot(*gravity)
    if not strength:
        return True
    up = np.array(gravity) / -strength
    level = geometry.to_matrix(geometry.look_at((0.0, 0.0, 0.0), up))  # its z axis points up
    bodies = {body.id: body for body in models}
    below = {body.id: _carriers(engine, body, up) for body in standing}
    loads = {
        number: [other for other, carriers in below.items() if number in {carrier for carrier, _ in carriers}]
        for number in below
    }
    masses = {body.id: engine.center_of_mass(body) for body in standing}
    for body in standing:
        centers, weights = zip(*(masses[other] for other in _above(body.id, loads)), strict=True)
        center = np.average(np.array(centers), axis=0, weights=weights) @ level
        tops = [
            (_corners(engine, bodies[other], models[bodies[other]], contacts[0].other_link) @ level, contacts)
            for (other, _), contacts in below[body.id].items()
        ]
        support = _support(engine, body, _corners(engine, body, models[body]) @ level, tops, level)
        if not len(support):
            return False
        if _margin(support[:, :2], center[:2]) < math.tan(_TILT) * (center[2] - support[:, 2].min()):
            return False
    return True


def _carriers(engine: Engine, body: Body, up: Points) -> dict[tuple[int, int], list[Contact]]:
    """Return what carries a body: ids and links, and where."""
    found: dict[tuple[int, int], list[Contact]] = {}
    for contact in engine.contacts(body):
        if np.dot(contact.normal, up) > _CARRYING:
            found.setdefault((contact.other, contact.other_link), []).append(contact)
    return found


def _above(number: int, loads: Mapping[int, Iterable[int]]) -> set[int]:
    """Return a body and all that rest on it, directly or through others."""
    found, queue = {number}, [number]
    while queue:
        for other in loads[queue.pop()]:
            if other not in found:
                found.add(other)
                queue.append(other)
    return found


def _support(
    engine: Engine, body: Body, underside: Points, tops: Iterable[tuple[Points, Sequence[Contact]]], level: Points
) -> Points:
    """Return points (n, 3) on which a body stands, in the levelled frame; their hull is the support polygon.

    Args:
        engine: where it stands.
        body: the body.
        underside: (n, 3) its corners in the levelled frame, m.
        tops: (n, 3) corners of what carries it, and the contacts there.
        level: (3, 3) axes of the levelled frame in the world.
    """
    parts = []
    for top, contacts in tops:
        height = float(np.dot(contacts[0].position, level[:, 2]))
        lower = _convex_hull(underside[np.abs(underside[:, 2] - height) < _FLAT, :2])
        upper = _convex_hull(top[np.abs(top[:, 2] - height) < _FLAT, :2])
        if len(lower) > 2 and len(upper) > 2:
            area = _intersection(lower, upper)
            parts.append(np.column_stack([area, np.full(len(area), height)]))
        points = [contact.position for contact in contacts if _holds(engine, body, contact, level[:, 2])]
        parts.append(np.array(points).reshape(-1, 3) @ level)
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _holds(engine: Engine, body: Body, contact: Contact, up: Points) -> bool:
    """Return whether a contact carries, and is flat enough for friction to hold it."""
    friction = engine.friction(body.id, contact.link) * engine.friction(contact.other, contact.other_link)
    slope = math.acos(min(1.0, float(np.dot(contact.normal, up))))
    return contact.force > 0.0 and slope < _FRICTION * math.atan(friction)


def _corners(engine: Engine, body: Body, model: Path, link: int | None = None) -> Points:
    """Return corners (n, 3) in the world of the collision shapes of a body, or of one of its links."""
    shapes = shapes_of(model, "collision")
    chosen = [i for i, name in enumerate(shapes.links) if link is None or body.links[name] == link]
    if not chosen:
        return np.zeros((0, 3))
    positions, orientations = engine.link_frames(body, [shapes.links[i] for i in chosen])
    turns = geometry.to_matrices(orientations)
    moved = [shapes.triangles[i].reshape(-1, 3) @ turns[k].T + positions[k] for k, i in enumerate(chosen)]
    return np.concatenate(moved)


def _convex_hull(points: Points) -> Points:
    """Return the convex hull of points (n, 2) of the plane, counterclockwise (monotone chain)."""
    ordered = np.unique(points.round(6), axis=0)

    def half(sequence: Points) -> list[Points]:
        chain: list[Points] = []
        for point in sequence:
            while len(chain) > 1 and _side(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1])).reshape(-1, 2) if len(ordered) > 2 else ordered


def _intersection(polygon: Points, other: Points) -> Points:
    """Return the corners (n, 2) of the intersection of two convex polygons (Sutherland and Hodgman)."""
    kept = list(polygon)
    for a, b in itertools.pairwise([*other, other[0]]):
        corners, kept = kept, []
        for now, after in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            left, follows = _side(a, b, now), _side(a, b, after)
            if left >= 0:
                kept.append(now)
            if left * follows < 0:
                kept.append(now + (after - now) * (left / (left - follows)))
    return np.array(kept).reshape(-1, 2)


def _side(a: Points, b: Points, point: Points) -> float:
    """Return a number above 0 if a point lies left of the line from a to b."""
    return float((b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]))


def _margin(points: Points, center: Points) -> float:
    """Return how far a point lies within the convex hull of points, m; less than 0 outside."""
    corners = _convex_hull(points)
    if len(corners) < 3:
        return -math.inf
    sides = itertools.pairwise([*corners, corners[0]])
    return min(_side(a, b, center) / max(float(np.linalg.norm(b - a)), 1e-9) for a, b in sides)
