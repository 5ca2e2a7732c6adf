"""A search for places: the search draws places from a map, checks each place, and yields the good places."""

from __future__ import annotations

import itertools
import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from pycram.foundation.failures import NoPlace, NotDrivable
from pycram.reasoning.choosing import Choice
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping.grasps import GraspSide
from pycram.reasoning.rejections import TAKEN, NoRoom, OutOfReach, Rejection, Touching, Unseen
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry, records
from recorder.geometry import Array, Pose, Quaternion, Vector
from recorder.records.text import rejection_text
from recorder.tracing import journal

if TYPE_CHECKING:
    from pycram.reasoning.places.maps import Grid


_UNEVEN: Final = 0.05  # largest difference in m of heights on one ground
_TILT: Final = math.radians(2)  # largest lean of a driving base
#: Reasons and remedies, by the constraint that excludes a whole surface.
_SURFACE: Final = {
    "clearance": "the object is higher than the free height above the surface; name another surface",
    "edge": "the surface is too small for the object; name a larger surface",
    "room": "the surface is full; take objects off it, or name another surface",
}


@dataclass(frozen=True, slots=True)
class FoundPlace:
    """A place where a robot can stand or an object can be put down."""

    position: Vector  # position of the robot's base or of the object, in the world, m
    orientation: Quaternion  # orientation of the robot's base or of the object, xyzw
    arms: tuple[str, ...] = ()  # arms that reach the target from the robot's place, or that reach the object's place
    score: float = 1.0  # score of the maps, 0 to 1
    surface: str = ""  # name of the surface below; "" for the ground
    grasps: Mapping[str, GraspSide] = field(default_factory=dict)  # sides from which arms take the target, by arm


@dataclass(frozen=True, slots=True)
class Spot:
    """A place that a search considers."""

    name: str  # name of the place, unique in its batch
    pose: Pose  # pose of the base or of the object in the world
    yaw: float  # orientation about the vertical, rad
    score: float  # 0 to 1


class Batch(Choice):
    """A choice among the places that were drawn from a grid together."""

    __slots__ = ("_drawn",)

    def __init__(self, name: str, arguments: Mapping[str, object]) -> None:
        super().__init__(name, arguments, wanted=journal.recording())
        self._drawn: tuple[Grid, Array, Sequence[Spot]] | None = None

    def draw(self, grid: Grid, scores: Array, spots: Sequence[Spot]) -> Sequence[Spot]:
        """Store the scores (cells,) of a grid and the drawn places for the record, and return these places."""
        self._drawn = grid, scores, spots
        return spots

    def admitted(self, spots: Sequence[Spot]) -> Sequence[Spot]:
        """Return the places that may be chosen."""
        return [spot for spot in spots if self.admits(spot.name)]

    def add_candidates(self, record: records.Query) -> Mapping[str, int]:
        """Add the candidates and the grid to a record."""
        groups = super().add_candidates(record)
        if self._drawn is None:
            return groups
        grid, scores, spots = self._drawn
        height, width = grid.shape
        packed = zlib.compress(np.ceil(np.clip(scores, 0.0, 1.0) * 255).astype(np.uint8).tobytes())
        drawn = records.Grid(origin=grid.origin, resolution=grid.resolution, width=width, height=height, scores=packed)
        for spot in spots:
            drawn.spots.add(position=spot.pose[0], yaw=spot.yaw, score=spot.score, candidate=groups.get(spot.name, -1))
        record.grid.CopyFrom(drawn)
        return groups


class Search(ABC):
    """A search that yields places; each place is the answer of its own query.

    ``arguments`` are the queries' arguments; None values are omitted. ``robot`` is the robot that must stand at the
    place or reach it; None without such a robot.
    """

    query: ClassVar[str]  # name of the queries

    def __init__(self, world: BulletWorld, wanted: str, arguments: Mapping[str, object], robot: Object | None) -> None:
        self._world, self._wanted = world, wanted
        self._stays = robot is not None and not drives(robot)  # whether the robot can't drive
        self._arguments = {name: value for name, value in arguments.items() if value is not None}
        self._over = False  # whether the search has ended
        self._counts: dict[str, int] = {}  # number of excluded places by constraint
        self._last = ""  # the constraint that excluded the last place
        self._reasons = Reasons()

    def places(self) -> Iterator[FoundPlace]:
        """Yield places until the search ends; raise NoPlace if the search ended without a place."""
        found = False
        for number in itertools.count():
            batch = Batch(self.query, self._arguments)
            with batch.asked(self._world, trace=False):
                clone_of(self._world, "reach").sync()
                place = self._next(batch, number)
                if place is None and self._over and not found:
                    why = self._reasons.text(self._last, self._world.objects, drives=not self._stays)
                    raise NoPlace(self._wanted, self._counts, self._last, _why=why)
            if place is not None:
                found = True
                yield place
            if self._over:
                return

    @abstractmethod
    def _next(self, batch: Batch, number: int) -> FoundPlace | None:
        """Return a place from a new batch; None if all places are excluded. ``number`` counts batches from 0."""

    def _product(self, maps: Iterable[tuple[str, Array]]) -> tuple[Array, float]:
        """Return the product (cells,) of maps, scaled so that the best cell has 1, and the best cell's unscaled score.

        Each map has the name of its constraint. All cells are 0 if the constraints exclude each other.
        """
        scores, factors = np.ones(1), list(maps)
        for constraint, score in factors:
            left = scores.any()
            scores = scores * score
            if left and not scores.any() and not self._counts:
                self._counts[constraint], self._last = len(scores), constraint
                others = [factor for name, factor in factors if name != constraint]
                self._reasons.excluded_by_maps(constraint, alone=bool(np.prod(others, axis=0).any()))
        best = float(scores.max())
        return scores / (best or 1.0), best

    def _exclude(self, batch: Batch, spot: Spot, constraint: str, reason: Rejection) -> None:
        batch.reject(spot.name, reason)
        self._counts[constraint] = self._counts.get(constraint, 0) + 1
        self._last = constraint
        self._reasons.add(constraint, reason)


def drives(robot: Object) -> bool:
    """Return whether a robot's base drives; robots without a description drive."""
    return robot.description is None or robot.description.drives


def check_drives(robot: Object, target: Sequence[float], orientation: Quaternion) -> None:
    """Raise NotDrivable if a robot's base is fixed."""
    if not drives(robot):
        raise NotDrivable(target, orientation, "the robot's base is fixed")


def check_ground(robot: Object, target: Sequence[float], orientation: Quaternion) -> None:
    """Raise NotDrivable if, at a pose, a robot's wheels would leave the ground or the robot would lean over."""
    position, heading = robot.get_position_and_orientation()
    height = target[2] - position[2]
    if abs(height) > _UNEVEN:
        side = "above" if height > 0 else "below"
        raise NotDrivable(target, orientation, f"the wheels would be {abs(height):.2f} m {side} the ground")
    lean = geometry.lean(orientation, heading)
    if lean > _TILT:
        raise NotDrivable(target, orientation, f"the robot would lean over by {math.degrees(lean):.0f} degrees")


class Reasons:
    """The reasons against the places of a search, by constraint; a remedy is suggested only if it can help."""

    def __init__(self) -> None:
        self._found: dict[str, dict[Hashable, tuple[int, Rejection]]] = {}
        self._maps = ""  # why the maps left no place, with the remedy

    def add(self, constraint: str, reason: Rejection) -> None:
        """Count a reason; of similar reasons, only the reason with the smallest miss is kept."""
        group = self._found.setdefault(constraint, {})
        count, nearest = group.get(reason.group(), (0, reason))
        group[reason.group()] = count + 1, min(nearest, reason, key=lambda each: each.miss())

    def excluded_by_maps(self, constraint: str, *, alone: bool) -> None:
        """Store the constraint that excluded all places; ``alone`` is whether the other constraints admit places."""
        self._maps = _SURFACE.get(constraint, "")
        if not self._maps and alone and constraint.startswith(("near", "away-from", "side")):
            self._maps = f"there are places without {constraint}: change or omit this constraint"

    def text(self, constraint: str, objects: Sequence[Object], *, drives: bool) -> str:
        """Return the most frequent reason of a constraint and a remedy; "" if neither is known.

        ``drives`` is whether the robot can drive; if not, a remedy moves the target.
        """
        group = self._found.get(constraint)
        if group is None:
            return self._maps
        _, reason = max(group.values(), key=lambda each: (each[1].miss() < math.inf, each[0]))  # inf: a hasty check
        words = rejection_text(type(reason).__name__, reason.data())
        if isinstance(reason, OutOfReach):
            by = "" if reason.distance is None else f" by {_centimetres(reason)} cm or more"
            words = f"the target is out of reach{by}"
        remedy = _remedy(reason, [each for each in objects if constraint != f"reach {each.name}"], drives=drives)
        return f"most often: {words}{remedy and '; ' + remedy}" if words else ""


def _remedy(reason: Rejection, objects: Sequence[Object], *, drives: bool) -> str:
    if isinstance(reason, Touching):
        return aside((pair.body for pair in reason.pairs if pair.body != pair.mover), objects)
    if isinstance(reason, Unseen):
        return aside(reason.hidden_by, objects)
    if isinstance(reason, OutOfReach) and reason.distance and not drives:
        return f"the base is fixed: bring the target at least {_centimetres(reason)} cm closer"
    if isinstance(reason, NoRoom) and reason.reason == TAKEN:
        return "take objects off the surface, or name another surface"
    return ""


def aside(names: Iterable[str], objects: Iterable[Object]) -> str:
    """Return the advice to move objects aside; "" without objects, or if an object can't be moved."""
    wanted = list(dict.fromkeys(names))
    movable = {each.name for each in objects if not each.fixed and not each.is_robot}
    return f"move {' and '.join(wanted)} aside" if wanted and movable.issuperset(wanted) else ""


def _centimetres(reason: OutOfReach) -> int:
    return math.ceil((reason.distance or 0.0) * 100)
