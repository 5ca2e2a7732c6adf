"""Stability: whether an object stays in place in a simulation (thesis 4.4.1).

The simulation ends early if all bodies that could reach the object in time are at rest and stand firmly: the center of
mass of a body and of all bodies on it is well within the support polygon. A clone is simulated, because PyBullet can't
restore a world exactly; in disorderly piles, one answer in 25 depends on contacts that only the world has kept.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.models.shapes import shapes_of
from pycram.physics.body import Contact, LoadedBody
from pycram.physics.engine import Engine
from pycram.reasoning.collision.simulation_clone import PlacedPart, clone_of
from pycram.reasoning.queries.query import Verdict, query
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.simulation import INTERVALS, SLOW, SLOW_TURN, at_rest
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import Vector
from recorder.records import STEPS_PER_SECOND

if TYPE_CHECKING:
    Box = tuple[list[float], list[float]]
    Points = NDArray[np.float64]

HORIZON: Final = 2 * STEPS_PER_SECOND  # number of steps in 2 s
MOVED: Final = 0.01  # largest motion in m of a stable object
TURNED: Final = math.radians(5)  # largest rotation of a stable object
_PERIOD: Final = 6  # number of steps between samples of the speeds
_DECISIONS: Final = (4, 6, 8, 16, 32, 64)  # number of samples after which the slow check of firm standing is made
_EARLY: Final = 1  # number of samples after which bodies may sleep; the engine simulates awake bodies slowly
_FALLING: Final = 0.1  # minimum speed in m/s of a falling body after the first sample
_LEANING: Final = 0.005  # largest distance in m of a body that leans on a robot: a gap of 0.5 mm, and some settling
_CARRYING: Final = 0.3  # minimum vertical component of the normal of a contact that carries a body
_FLAT: Final = 0.002  # largest difference in m between the heights of a body's corners that count as one level
_FRICTION: Final = 0.8  # largest slope of a contact that counts as level, as a share of the friction angle
_TILT: Final = math.radians(3)  # angle in rad by which a firm body can be tilted before it falls
_MANY: Final = 24  # maximum number of bodies without attachments; if there are more, bodies at rest sleep


@query
def stable(object: Object, world: BulletWorld | None = None) -> Verdict:
    """Return whether an object stays in place in a simulation (thesis 4.4.1).

    Returns:
        False if the object would move more than 1 cm or turn more than 5 degrees within 2 s. The evidence has the
        motion in m and rad, the number of simulated steps, and the number of steps until the motion exceeded a limit.
    """
    if object.fixed:
        return Verdict(True, {"moved": 0.0, "turned": 0.0, "simulated_steps": 0})
    bodies = _participants(object)
    world = object.world
    clone = clone_of(world, "physics with robots" if any(body.is_robot for body in bodies) else "physics")
    copies, furniture = clone.sync(bodies)
    free = [body for body in bodies if not body.fixed]
    on_their_own = [body for body in free if not attachment.root_of(body).fixed]
    standing = [copies[body.name] for body in on_their_own]
    attached = any(body.attachments for body in on_their_own)  # attachments aren't contacts

    of = {body.id: world.get_object(name) for name, body in copies.items()}
    parts = {placed.body.id: (world.get_object(name), placed) for name, each in furniture.items() for placed in each}

    @cache
    def solid(number: int) -> Solid:
        if number in parts:
            return SolidPart(*parts[number])
        return Solid(clone.engine, copies[of[number].name], of[number].model.path)

    def steady(some: Sequence[LoadedBody]) -> Iterator[bool]:
        return stand_firmly(clone.engine, solid, some, world.gravity) if not attached else iter([False])

    sleepers = None
    if len(standing) > _MANY and not attached and not any(copies[body.name].joints for body in on_their_own):
        fixed = [placed.body for each in furniture.values() for placed in each]
        sleepers = _Sleepers(clone.engine, {body.id: body for body in standing}, fixed, steady)
    try:
        movable = [copies[body.name] for body in free]
        return _simulate(clone.engine, copies[object.name], movable, lambda some: all(steady(some)), standing, sleepers)
    finally:
        if sleepers is not None:
            sleepers.wake()
        clone.invalidate(*copies)


def _participants(body: Object) -> list[Object]:
    """Return the object and all bodies that may move the object in time.

    A robot is simulated only if a free body leans on the robot, or if the robot is attached to the object.
    """
    world = body.world
    robots = {other for other in world.objects if other.is_robot and other is not body}
    roots = {other: attachment.root_of(other) for other in world.objects}
    holders = {other: root for other, root in roots.items() if root.is_robot and root is not other}
    boxes = {  # furniture has many links but seldom moves, so its boxes are cached
        other: clone_of(world, "physics").cached(other, "bounds", other.get_AABB) if other.fixed else other.get_AABB()
        for other in world.objects
        if other not in robots
    }
    reach = _reach(body, {other: box for other, box in boxes.items() if not other.fixed and other not in holders})
    near = [other for other, box in boxes.items() if _gap(box, boxes[body]) <= reach]
    needed = {holders[body]} if body in holders else set()
    for robot in robots:
        free = (other for other in near if not other.fixed and (other not in holders or other is body))
        if any(world.engine.closest_points(robot.handle, other.handle, _LEANING) for other in free):
            needed.add(robot)
    if body not in holders:
        for other, holder in holders.items():
            if other in boxes and world.engine.closest_points(other.handle, body.handle, _LEANING):
                needed.add(holder)
    kept = [other for other in near if other not in holders or holders[other] in needed]
    held = [other for other, holder in holders.items() if holder in needed and other not in kept]
    joined = [other for kin in kept for other in kin.attachments if other not in kept and other not in holders]
    return list(dict.fromkeys([*kept, *held, *needed, *(other for other in joined if other not in robots)]))


def _reach(body: Object, free: Mapping[Object, Box]) -> float:
    """Return the greatest distance in m that a body can cover within the time, from the greatest speed and a fall."""
    world = body.world
    strength = math.hypot(*world.gravity)
    down = [part / strength for part in world.gravity] if strength else [0.0, 0.0, 0.0]

    def levels(box: Box) -> tuple[float, float]:
        ends = [sorted((d * a, d * b)) for d, a, b in zip(down, *box, strict=True)]
        return sum(end[0] for end in ends), sum(end[1] for end in ends)

    drop = levels(body.get_AABB())[1] - min((levels(box)[0] for box in free.values()), default=math.inf)
    speed = 0.0
    for other, (low, high) in free.items():
        linear, angular = _speeds(world.engine, other.handle)
        speed = max(speed, linear + angular * math.dist(low, high))
    return math.sqrt(speed**2 + 2 * strength * max(drop, 0.0)) * HORIZON / STEPS_PER_SECOND


def _gap(a: Box, b: Box) -> float:
    return math.hypot(*(max(0.0, low - end, start - high) for low, high, start, end in zip(*a, *b, strict=True)))


def _simulate(
    engine: Engine,
    body: LoadedBody,
    movable: Sequence[LoadedBody],
    firm: Callable[[Sequence[LoadedBody]], bool],
    standing: Sequence[LoadedBody],
    sleepers: _Sleepers | None = None,
) -> Verdict:
    """Simulate until the body moves too far, or ``movable`` bodies rest and ``standing`` bodies are ``firm``."""
    start = engine.pose(body)
    speeds: list[list[float]] = []  # speeds of all bodies in each sample, as multiples of the limit for rest
    decisions = _DECISIONS if sleepers is None else (_EARLY, *_DECISIONS)
    steps = 0
    moved = turned = 0.0
    while steps < HORIZON:
        engine.step(_PERIOD)
        steps += _PERIOD
        position, orientation = engine.pose(body)
        moved, turned = math.dist(start[0], position), geometry.angle(start[1], orientation)
        if moved > MOVED or turned > TURNED:
            evidence = {"moved": moved, "turned": turned, "moved_after_steps": steps, "simulated_steps": steps}
            return Verdict(False, evidence)
        speeds.append(
            [max(linear / SLOW, turn / SLOW_TURN) for linear, turn in (_speeds(engine, other) for other in movable)]
            if sleepers is None or any(0 <= decision - 1 - len(speeds) < INTERVALS for decision in decisions)
            else []
        )
        if len(speeds) not in decisions or (len(speeds) == _EARLY and _speeds(engine, body)[0] > _FALLING):
            continue
        resting = [at_rest(each) for each in zip(*speeds[-INTERVALS:], strict=True)]
        if sleepers is not None:
            sleepers.update([other for other, rests in zip(movable, resting, strict=True) if not rests])
            if all(resting) and len(sleepers.asleep) == len(standing):
                break
        elif all(resting) and firm(standing):
            break
    return Verdict(True, {"moved": moved, "turned": turned, "simulated_steps": steps})


@dataclass(slots=True)
class _Sleepers:
    """The sleeping bodies of a clone: bodies at rest that stand firmly, and have no joints and no attachments."""

    engine: Engine
    standing: Mapping[int, LoadedBody]  # bodies that may sleep, by id
    fixed: Sequence[LoadedBody]
    steady: Callable[[Sequence[LoadedBody]], Iterable[bool]]  # yields whether each body stands firmly
    asleep: set[int] = field(default_factory=set)  # ids of the sleeping bodies

    def update(self, moving: Iterable[LoadedBody]) -> None:
        """Put each group of touching bodies to sleep if no body of the group is moving or unsteady."""
        engine = self.engine
        self.asleep = {number for number in self.asleep if not any(engine.velocity(self.standing[number]))}
        awake = {number: body for number, body in self.standing.items() if number not in self.asleep}
        touching = {number: {contact.other for contact in engine.contacts(body)} for number, body in awake.items()}
        kept = _above((body.id for body in moving), touching)
        tried = [body for number, body in awake.items() if number not in kept]
        kept |= _above((body.id for body, firm in zip(tried, self.steady(tried), strict=True) if not firm), touching)
        rested = [body for body in tried if body.id not in kept]
        for body in [*rested, *(self.fixed if rested and not self.asleep else ())]:
            engine.sleep(body, asleep=True)
        self.asleep.update(body.id for body in rested)

    def wake(self) -> None:
        """Wake all bodies. Bodies wake in the engine's next step, so this step is made here, before later queries."""
        for body in (*self.standing.values(), *self.fixed):
            self.engine.sleep(body, asleep=False)
        self.engine.step(1)


def _speeds(engine: Engine, body: LoadedBody) -> tuple[float, float]:
    velocity = engine.velocity(body)
    return math.hypot(*velocity[:3]), math.hypot(*velocity[3:])


class Solid:
    """A body with its collision shapes; ``model`` is its checked URDF."""

    def __init__(self, engine: Engine, body: LoadedBody, model: Path) -> None:
        self._engine, self._body = engine, body
        self._shapes = shapes_of(model, "collision")
        self._names = {index: link for link, index in body.links.items()}

    def link(self, contact: Contact) -> str:
        """Return the link of this body that carries another body; ``contact`` is a contact of the other body."""
        return self._names[contact.other_link]

    def corners(self, link: str | None = None) -> Points:
        """Return the corners (n, 3) in the world of all collision shapes, or of the shapes of a link."""
        chosen = [i for i, name in enumerate(self._shapes.links) if link in {None, name}]
        if not chosen:
            return np.zeros((0, 3))
        frames = self._engine.link_frames(self._body, [self._shapes.links[i] for i in chosen])
        turns = geometry.to_matrices(frames[1])
        moved = [self._shapes.triangles(i).reshape(-1, 3) @ turns[k].T + frames[0][k] for k, i in enumerate(chosen)]
        return np.concatenate(moved)


class SolidPart(Solid):
    """A rigid part of furniture, in which the engine doesn't distinguish links; ``furniture`` is the whole object."""

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
        """Return the link whose box is nearest to a contact; if several boxes contain the contact, the smallest."""
        if len(self._links) == 1:
            return self._links[0]
        within = np.einsum("kji,kj->ki", self._turns, contact.position - self._positions)
        beyond = np.maximum(np.maximum(self._low - within, within - self._high), 0.0)
        return self._links[int(np.lexsort([self._volumes, np.maximum((beyond**2).sum(axis=1), _FLAT**2)])[0])]


def stand_firmly(
    engine: Engine, solid_of: Callable[[int], Solid], standing: Sequence[LoadedBody], gravity: Vector
) -> Iterator[bool]:
    """Yield for each body whether it certainly stands firmly. A simulation must have ended just before.

    Bodies that aren't in ``standing`` count as immovable. The support polygon contains the contacts that friction
    holds, and the points where the underside of a body and the top of its support overlap.
    """
    strength = math.hypot(*gravity)
    if not strength:
        yield from (True for _ in standing)
        return
    up = np.array(gravity) / -strength
    level = geometry.to_matrix(geometry.look_at((0.0, 0.0, 0.0), up))  # the z axis of this frame points up
    below = {body.id: _carriers(engine, body, solid_of, up) for body in standing}
    loads: dict[int, list[int]] = {number: [] for number in below}
    for other, carriers in below.items():
        for number in {carrier for carrier, _ in carriers} & loads.keys():
            loads[number].append(other)
    masses = {body.id: engine.center_of_mass(body) for body in standing}
    for body in standing:
        centers, weights = zip(*(masses[other] for other in _above([body.id], loads)), strict=True)
        center = np.average(np.array(centers), axis=0, weights=weights) @ level
        yield any(
            len(support) > 0
            and geometry.margin_in_polygon(geometry.convex_hull(support[:, :2]), center[:2].tolist())
            >= math.tan(_TILT) * (center[2] - support[:, 2].min())
            for support in _supports(engine, body, solid_of, below[body.id], level)
        )


def _carriers(
    engine: Engine, body: LoadedBody, solid_of: Callable[[int], Solid], up: Points
) -> dict[tuple[int, str], list[Contact]]:
    """Return the supports of a body: their ids and links, with the contacts."""
    found: dict[tuple[int, str], list[Contact]] = {}
    for contact in engine.contacts(body):
        if np.dot(contact.normal, up) > _CARRYING:
            found.setdefault((contact.other, solid_of(contact.other).link(contact)), []).append(contact)
    return found


def _above(numbers: Iterable[int], loads: Mapping[int, Iterable[int]]) -> set[int]:
    """Return bodies and all bodies on them, also indirectly."""
    queue = list(numbers)
    found = set(queue)
    while queue:
        for other in loads.get(queue.pop(), ()):
            if other not in found:
                found.add(other)
                queue.append(other)
    return found


def _supports(
    engine: Engine,
    body: LoadedBody,
    solid_of: Callable[[int], Solid],
    carriers: Mapping[tuple[int, str], Sequence[Contact]],
    level: Points,
) -> Iterator[Points]:
    """Yield points (n, 3) of a body's supports in the levelled frame: first the contacts, which mostly suffice."""
    contacts = itertools.chain.from_iterable(carriers.values())
    points = [contact.position for contact in contacts if _holds(engine, body, contact, level[:, 2])]
    held = np.array(points).reshape(-1, 3) @ level
    yield held
    parts = [held]
    underside = solid_of(body.id).corners() @ level
    for (other, link), touching in carriers.items():
        height = float(np.dot(touching[0].position, level[:, 2]))
        lower, upper = (
            geometry.convex_hull(corners[np.abs(corners[:, 2] - height) < _FLAT, :2])
            for corners in (underside, solid_of(other).corners(link) @ level)
        )
        if len(lower) > 2 and len(upper) > 2:
            area = [(x, y, height) for x, y in geometry.polygon_intersection(lower, upper)]
            parts.append(np.array(area).reshape(-1, 3))
    yield np.concatenate(parts)


def _holds(engine: Engine, body: LoadedBody, contact: Contact, up: Points) -> bool:
    """Return whether a contact carries the body, and is level enough for friction to hold the body."""
    friction = engine.friction(body.id, contact.link) * engine.friction(contact.other, contact.other_link)
    slope = math.acos(min(1.0, float(np.dot(contact.normal, up))))
    return contact.force > 0.0 and slope < _FRICTION * math.atan(friction)
