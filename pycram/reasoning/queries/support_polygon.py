"""Support polygons: whether bodies at rest stand firmly. A knife on its end is at rest too, until it falls.

A body stands firmly if the center of mass of it and of all that rests on it lies well within its support polygon: where
its underside and the tops of what carries it overlap, and between the points that carry it, as a spoon in a bowl, where
friction holds it: forces straight up are possible there, and balance it. A ball never stands firmly: only time shows
whether it rolls.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.visual import shapes_of
from recorder import geometry
from recorder.geometry import polygon

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.contacts import Contact
    from pycram.physics.engine import Engine
    from pycram.reasoning.collision.simulation_clone import PlacedPart
    from pycram.world.object import Object
    from recorder.geometry import Vector

    Points = NDArray[np.float64]

_CARRYING: Final = 0.3  # of a normal's length pointing up
_FLAT: Final = 0.002  # m within which corners are of one level
_FRICTION: Final = 0.8  # of friction's angle that a contact may slope
_TILT: Final = math.radians(3)  # by which a firm body can be tilted before it tips


class Solid:
    """A body with its collision shapes.

    Args:
        engine: where it is.
        body: the body.
        model: its canonical URDF.
    """

    def __init__(self, engine: Engine, body: Body, model: Path) -> None:
        self._engine, self._body = engine, body
        self._shapes = shapes_of(model, "collision")
        self._names = {index: link for link, index in body.links.items()}

    def link(self, contact: Contact) -> str:
        """Return the link of it that carries another body at a contact of that one."""
        return self._names[contact.other_link]

    def corners(self, link: str | None = None) -> Points:
        """Return corners (n, 3) in the world of its collision shapes, or of those of a link."""
        chosen = [i for i, name in enumerate(self._shapes.links) if link in {None, name}]
        if not chosen:
            return np.zeros((0, 3))
        frames = self._engine.link_frames(self._body, [self._shapes.links[i] for i in chosen])
        turns = geometry.to_matrices(frames[1])
        moved = [self._shapes.triangles[i].reshape(-1, 3) @ turns[k].T + frames[0][k] for k, i in enumerate(chosen)]
        return np.concatenate(moved)


class SolidPart(Solid):
    """A rigid part of furniture, whose links the engine doesn't tell from each other.

    Args:
        furniture: the object that it is of, in its world, where it is as in the clone.
        placed: the part.
    """

    def __init__(self, furniture: Object, placed: PlacedPart) -> None:
        super().__init__(furniture.world.engine, furniture.handle, furniture.model.path)
        wanted = set(placed.part.links)
        chosen = [i for i, name in enumerate(self._shapes.links) if name in wanted]
        self._links: list[str] = [self._shapes.links[i] for i in chosen]
        self._low, self._high = self._shapes.low[chosen], self._shapes.high[chosen]
        self._volumes = (self._high - self._low).prod(axis=1)
        self._positions, orientations = self._engine.link_frames(self._body, self._links)
        self._turns = geometry.to_matrices(orientations)

    def link(self, contact: Contact) -> str:
        """Return the link whose box is nearest to a contact, of several around it the smallest."""
        within = np.einsum("kji,kj->ki", self._turns, contact.position - self._positions)
        beyond = np.maximum(np.maximum(self._low - within, within - self._high), 0.0)
        distances = np.maximum((beyond**2).sum(axis=1), _FLAT**2)
        return self._links[int(np.lexsort([self._volumes, distances])[0])]


def stands_firmly(engine: Engine, solid_of: Callable[[int], Solid], standing: Sequence[Body], gravity: Vector) -> bool:
    """Return whether bodies stand firmly.

    Args:
        engine: where they have just been simulated.
        solid_of: returns any body that is there by its id.
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
    below = {body.id: _carriers(engine, body, solid_of, up) for body in standing}
    loads = {
        number: [other for other, carriers in below.items() if number in {carrier for carrier, _ in carriers}]
        for number in below
    }
    masses = {body.id: engine.center_of_mass(body) for body in standing}
    for body in standing:
        centers, weights = zip(*(masses[other] for other in _above(body.id, loads)), strict=True)
        center = np.average(np.array(centers), axis=0, weights=weights) @ level
        tops = [(solid_of(other).corners(link) @ level, contacts) for (other, link), contacts in below[body.id].items()]
        support = _support(engine, body, solid_of(body.id).corners() @ level, tops, level)
        if not len(support):
            return False
        if polygon.margin(polygon.convex_hull(support[:, :2]), center[:2].tolist()) < math.tan(_TILT) * (
            center[2] - support[:, 2].min()
        ):
            return False
    return True


def _carriers(
    engine: Engine, body: Body, solid_of: Callable[[int], Solid], up: Points
) -> dict[tuple[int, str], list[Contact]]:
    """Return what carries a body: ids and links, and where."""
    found: dict[tuple[int, str], list[Contact]] = {}
    for contact in engine.contacts(body):
        if np.dot(contact.normal, up) > _CARRYING:
            found.setdefault((contact.other, solid_of(contact.other).link(contact)), []).append(contact)
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
        lower, upper = (
            polygon.convex_hull(corners[np.abs(corners[:, 2] - height) < _FLAT, :2]) for corners in (underside, top)
        )
        if len(lower) > 2 and len(upper) > 2:
            area = [(x, y, height) for x, y in polygon.intersection(lower, upper)]
            parts.append(np.array(area).reshape(-1, 3))
        points = [contact.position for contact in contacts if _holds(engine, body, contact, level[:, 2])]
        parts.append(np.array(points).reshape(-1, 3) @ level)
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _holds(engine: Engine, body: Body, contact: Contact, up: Points) -> bool:
    """Return whether a contact carries, and is flat enough for friction to hold it."""
    friction = engine.friction(body.id, contact.link) * engine.friction(contact.other, contact.other_link)
    slope = math.acos(min(1.0, float(np.dot(contact.normal, up))))
    return contact.force > 0.0 and slope < _FRICTION * math.atan(friction)
