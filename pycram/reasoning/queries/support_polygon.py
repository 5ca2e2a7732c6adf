"""Whether things that are at rest stand firmly: a knife on its end is at rest too, until it falls.

A thing stands firmly if the middle of mass of it and of all that rests on it lies well within the area on which it
stands: where its underside and the tops of what carries it overlap, and between the points that carry it, as a spoon
in a bowl, where friction holds it: forces straight up are possible there, and balance it. A ball never stands firmly:
only time shows whether it rolls.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
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
_GRIPPED: Final = 0.8  # of friction's angle that a contact may slope
_TILT: Final = math.radians(3)  # that a firm thing can be tilted by before it tips


@dataclass(frozen=True, slots=True)
class Thing:
    """A body that may stand or carry.

    Attributes:
        body: the engine's side of it.
        model: its canonical URDF.
    """

    body: Body
    model: Path


def firm(engine: Engine, things: Sequence[Thing], standing: Sequence[Thing], gravity: Vector) -> bool:
    """Whether things stand firmly.

    Args:
        engine: where they have just been simulated.
        things: all that is there.
        standing: those that are asked about; all others carry without giving way.
        gravity: m/s^2.

    Returns:
        False also where this can't be told.
    """
    strength = math.hypot(*gravity)
    if not strength:
        return True
    up = np.array(gravity) / -strength
    level = geometry.to_matrix(geometry.look_at((0.0, 0.0, 0.0), up))  # its z axis points up
    known = {thing.body.id: thing for thing in things}
    below = {thing.body.id: _carriers(engine, thing.body, up) for thing in standing}
    loads = {
        number: [other for other, carriers in below.items() if number in {body for body, _ in carriers}]
        for number in below
    }
    masses = {thing.body.id: engine.center_of_mass(thing.body) for thing in standing}
    for thing in standing:
        number = thing.body.id
        places, weights = zip(*(masses[other] for other in _above(number, loads)), strict=True)
        middle = np.average(np.array(places), axis=0, weights=weights) @ level
        feet = _feet(engine, thing, [(known[other], where) for (other, _), where in below[number].items()], level)
        if not len(feet) or _margin(feet[:, :2], middle[:2]) < math.tan(_TILT) * (middle[2] - feet[:, 2].min()):
            return False
    return True


def _carriers(engine: Engine, body: Body, up: Points) -> dict[tuple[int, int], list[Contact]]:
    """What carries a body: ids and links, and where."""
    found: dict[tuple[int, int], list[Contact]] = {}
    for contact in engine.contacts(body):
        if np.dot(contact.normal, up) > _CARRYING:
            found.setdefault((contact.other, contact.other_link), []).append(contact)
    return found


def _above(number: int, loads: Mapping[int, Iterable[int]]) -> set[int]:
    """A body and all that rest on it, directly or through others."""
    found, queue = {number}, [number]
    while queue:
        for other in loads[queue.pop()]:
            if other not in found:
                found.add(other)
                queue.append(other)
    return found


def _feet(engine: Engine, thing: Thing, carriers: Iterable[tuple[Thing, Sequence[Contact]]], level: Points) -> Points:
    """Corners (n, 3) of where a thing stands, in the levelled frame."""
    underside = _corners(engine, thing, None) @ level
    parts = []
    for carrier, contacts in carriers:
        height = float(np.dot(contacts[0].position, level[:, 2]))
        top = _corners(engine, carrier, contacts[0].other_link) @ level
        lower = _outline(underside[np.abs(underside[:, 2] - height) < _FLAT, :2])
        upper = _outline(top[np.abs(top[:, 2] - height) < _FLAT, :2])
        if len(lower) > 2 and len(upper) > 2:
            area = _overlap(lower, upper)
            parts.append(np.column_stack([area, np.full(len(area), height)]))
        points = [contact.position for contact in contacts if _grips(engine, thing, contact, level[:, 2])]
        parts.append(np.array(points).reshape(-1, 3) @ level)
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _grips(engine: Engine, thing: Thing, contact: Contact, up: Points) -> bool:
    """Whether a contact carries, and is flat enough for friction to hold on to it."""
    grip = engine.friction(thing.body.id, contact.link) * engine.friction(contact.other, contact.other_link)
    slope = math.acos(min(1.0, float(np.dot(contact.normal, up))))
    return contact.force > 0.0 and slope < _GRIPPED * math.atan(grip)


def _corners(engine: Engine, thing: Thing, link: int | None) -> Points:
    """Corners (n, 3) in the world of what touches of a body, or of one of its links."""
    shapes = shapes_of(thing.model, "collision")
    chosen = [i for i, name in enumerate(shapes.links) if link is None or thing.body.links[name] == link]
    if not chosen:
        return np.zeros((0, 3))
    positions, orientations = engine.link_frames(thing.body, [shapes.links[i] for i in chosen])
    turns = geometry.to_matrices(orientations)
    moved = [shapes.triangles[i].reshape(-1, 3) @ turns[k].T + positions[k] for k, i in enumerate(chosen)]
    return np.concatenate(moved)


def _outline(points: Points) -> Points:
    """The convex hull of points (n, 2) of the plane, counterclockwise."""
    ordered = np.unique(points.round(6), axis=0)

    def half(sequence: Points) -> list[Points]:
        chain: list[Points] = []
        for point in sequence:
            while len(chain) > 1 and _side(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1])).reshape(-1, 2) if len(ordered) > 2 else ordered


def _overlap(area: Points, other: Points) -> Points:
    """What two convex areas have in common: corners (n, 2)."""
    kept = list(area)
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
    """Above 0 if a point lies left of the way from a to b."""
    return float((b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]))


def _margin(points: Points, middle: Points) -> float:
    """How far a point lies within the convex hull of points, m; less than 0 outside."""
    corners = _outline(points)
    if len(corners) < 3:
        return -math.inf
    sides = itertools.pairwise([*corners, corners[0]])
    return min(_side(a, b, middle) / max(float(np.linalg.norm(b - a)), 1e-9) for a, b in sides)
