"""Where an object can be put down on surfaces: with room for its outline and for fingers around it (CRAM's ``on``)."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, PlaceFailed, UnknownName
from pycram.models.surfaces import Surface
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.driving import drives
from pycram.reasoning.grasping import placing
from pycram.reasoning.grasping.grasps import candidates
from pycram.reasoning.grasping.sides import yaw_of
from pycram.reasoning.kinematics.solver import Solver
from pycram.reasoning.places import reaching
from pycram.reasoning.places.batch import Batch, Spot
from pycram.reasoning.places.constraints import ConstraintCounts
from pycram.reasoning.places.grid import Grid, generator, spread
from pycram.reasoning.places.place import Place, PutDown
from pycram.reasoning.places.surface_maps import EDGE, FINGERS, SearchedSurface, SurfaceMaps
from pycram.reasoning.queries.query import world_of
from pycram.reasoning.rejections import NoRoom, OutOfReach, Touching
from pycram.scheduling.future import unwrap
from recorder import geometry
from recorder.geometry import polygon

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pycram.models.robots.description import Arm
    from pycram.reasoning.rejections import Rejection
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion, Vector
    from recorder.geometry.polygon import Polygon

    Array = NDArray[np.float64]

SIDES: Final = ("front", "back", "left", "right")
"""Of a surface or an object, as its robot sees it: "front" is the side that faces the robot."""

_SPOTS: Final = 40  # that are drawn at once
_BATCHES: Final = 3  # without a place, after which a surface is given up
_LATER: Final = 0.6  # of its score that a surface keeps with each place that it has given
_RESTS: Final = 0.01  # m by which an object may rest higher or lower than on the surface
_YAWS: Final = 12  # orientations about the vertical, as they are tried where something is placed


def free_places(
    body: Object,
    *,
    on: Sequence[tuple[Object, Surface | str]],
    near: Sequence[float] | None = None,
    side: str | tuple[str, Object] | None = None,
    orientation: Sequence[float] | None = None,
    reachable_for: Object | None = None,
    arms: Sequence[str] | None = None,
    away: Sequence[float] | None = None,
    seed: int | None = None,
) -> Iterator[Place]:
    """Return places where an object can be put down on surfaces, best first, each checked when its turn comes.

    A place is where `place` would set it down: it stands on the surface with all of its outline, and nothing that
    stands there is nearer than a finger is thick. Each place that is asked for is one query on record. The world may
    have changed before the next one is asked for.

    Args:
        body: the object, upright; wherever it is now.
        on: surfaces, or their names, each with the furniture that it belongs to: (kitchen, "island").
        near: xyz or xy of a point that it shall be near, m: at most 1 m away.
        side: of each surface, or of an object (side, object), as the robot sees it: "front", "back", "left", "right".
        orientation: xyzw of the object there; any about the vertical by default.
        reachable_for: a robot that shall reach there: from where it stands if it is bolted down, else from somewhere.
        arms: names of its arms that may reach; all by default.
        away: xyz or xy of a point that it shall be at least 0.4 m away from.
        seed: of the places; the run's by default.

    Raises:
        BadArgument: an impossible value.
        UnknownName: an unknown side, arm or surface.
        NoPlace: when the first is asked for: there is none.
    """
    body, robot = unwrap(body), unwrap(reachable_for)
    surfaces = [_surface(unwrap(furniture), surface) for furniture, surface in on]
    if not surfaces:
        raise BadArgument("on", on, "at least one surface with its furniture")
    name, reference = (side, None) if side is None or isinstance(side, str) else (side[0], unwrap(side[1]))
    if name is not None and name not in SIDES:
        raise UnknownName("side", name, "a surface or an object", SIDES)
    bodies = [furniture for furniture, _ in surfaces] + [each for each in (robot, reference) if each is not None]
    world_of(body, *bodies)
    chosen: list[Arm] = []
    if robot is not None:
        description = reaching.description_of("reachable_for", robot)
        chosen = [description.arm(each) for each in (description.arms if arms is None else arms)]
    point = None if near is None else checks.vector("near", (*near, 0.0) if len(near) == 2 else near)
    off = None if away is None else checks.vector("away", (*away, 0.0) if len(away) == 2 else away)
    turn = None if orientation is None else checks.quaternion("orientation", orientation)
    return _Search(body, surfaces, point, (name, reference), turn, robot, chosen, off, seed).places()


def _surface(furniture: Object, surface: Surface | str) -> tuple[Object, Surface]:
    """Return a surface that is given, or named, with its furniture."""
    world_of(furniture)
    return furniture, surface if isinstance(surface, Surface) else furniture.surface(surface)


class _Search:
    """Places for an object, one after the other."""

    def __init__(
        self,
        body: Object,
        surfaces: Sequence[tuple[Object, Surface]],
        near: Vector | None,
        side: tuple[str | None, Object | None],
        orientation: Quaternion | None,
        robot: Object | None,
        arms: Sequence[Arm],
        away: Vector | None,
        seed: int | None,
    ) -> None:
        self._body, self._orientation = body, orientation
        self._robot, self._arms, self._seed = robot, arms, seed
        self._surfaces = [SearchedSurface(furniture, surface) for furniture, surface in surfaces]
        self._done: list[Vector] = []
        self._counts = ConstraintCounts(f"{body.name} on {' or '.join(surface.name for _, surface in surfaces)}")
        self._arguments: Mapping[str, object] = {
            "object": body,
            **({"near": near} if near is not None else {}),
            **({"side": [side[0], *([side[1]] if side[1] else [])]} if side[0] else {}),
            **({"away": away} if away is not None else {}),
            **({"orientation": orientation} if orientation is not None else {}),
            **({"reachable_for": robot, "arms": [arm.name for arm in arms]} if robot is not None else {}),
        }
        self._maps = SurfaceMaps(body, near, away, *side, orientation, robot, arms)

    def places(self) -> Iterator[Place]:
        """Yield places, each from a query of its own."""
        found = False
        for number in itertools.count():
            batch = Batch("free_places", self._arguments)
            with batch.asked(self._body.world, trace=False):
                clone_of(self._body.world, "reach").sync()
                searched, spots = self._drawn(batch, number)
                place = self._first(batch, spots, searched)
                if place is None:
                    searched.failed = searched.failed + 1 if spots else _BATCHES
                over = all(each.failed >= _BATCHES for each in self._surfaces)
                if over and not found:
                    raise self._counts.failure()
            if place is not None:
                found, searched.failed, searched.share = True, 0, searched.share * _LATER
                yield place
            elif over:
                return

    # --- all places at once ------------------------------------------------------------------------------------------

    def _scored(self, searched: SearchedSurface) -> tuple[Grid, Array, float]:
        """Return the cells of a surface, the product (cells,) of its maps, and how good the best cell is."""
        grid, factors = self._maps.of(searched, self._done)
        return grid, *self._counts.product(factors)

    def _drawn(self, batch: Batch, number: int) -> tuple[SearchedSurface, Sequence[Spot]]:
        """Return the surface that promises most, and places drawn from its maps, for the n-th batch from 0."""
        left = [searched for searched in self._surfaces if searched.failed < _BATCHES]
        found = [self._scored(searched) for searched in left]
        best = max(range(len(left)), key=lambda each: left[each].share * found[each][2])
        searched, (grid, scores, _) = left[best], found[best]
        batch.arguments = {**self._arguments, "on": [searched.furniture, searched.surface.name]}
        random = generator(self._seed, "free_places", number, repr(batch.arguments))
        start = self._maps.heading(searched)
        (_, _, height), _ = searched.pose()
        spots = []
        for cell, (x, y) in spread(grid, scores, _SPOTS, random):
            step = int(random.integers(_YAWS))
            if self._stays() and step % 2:  # an arm that has taken it puts it down most easily as it stood
                step = 0
            yaw = start + 2 * math.pi * step / _YAWS
            turn = self._orientation or geometry.from_rpy(0.0, 0.0, yaw)
            pose = (x, y, height - float(self._maps.corners(turn)[:, 2].min())), turn
            spots.append(Spot(f"[{x:.3f}, {y:.3f}]", pose, yaw_of(turn), float(scores[cell])))
        return searched, batch.draw(grid, scores, spots)

    # --- one place after the other -----------------------------------------------------------------------------------

    def _first(self, batch: Batch, spots: Sequence[Spot], searched: SearchedSurface) -> Place | None:
        """Return the first place that will do."""
        outline = searched.outline()
        obstacles = [polygon.convex_hull(each) for each in self._maps.obstacles(searched).corners().reshape(-1, 4, 2)]
        for spot in spots:
            self._done.append(spot.pose[0])
            excluded = self._excluded(spot, searched, outline, obstacles)
            if isinstance(excluded, Place):
                batch.take(
                    spot.name,
                    {"position": excluded.position, "orientation": excluded.orientation, "arms": excluded.arms},
                )
                return excluded
            self._counts.exclude(batch, spot, *excluded)
        return None

    def _excluded(
        self, spot: Spot, searched: SearchedSurface, outline: Polygon, obstacles: Sequence[Polygon]
    ) -> Place | tuple[str, Rejection]:
        """Return a place that will do, or which constraint excludes it, and why."""
        (x, y, z), turn = spot.pose
        own = polygon.convex_hull(self._maps.corners(turn)[:, :2] + (x, y))
        taken = self._no_room(own, searched, outline, obstacles)
        if taken is not None:
            return taken
        try:
            rest = placing.set_down(self._body, (x, y, z), turn)
        except PlaceFailed as failure:
            return "room", NoRoom(failure.reason)
        if abs(rest[2] - z) > _RESTS:
            return "room", NoRoom(f"it would not rest on {searched.surface.name}")
        reasons = {arm.name: self._unreached(arm, (rest, turn)) for arm in self._arms if self._stays()}
        missed = [reason for reason in reasons.values() if reason is not None]
        if reasons and len(missed) == len(reasons):
            return "reach", min(missed, key=lambda each: each.miss())
        reached = tuple(name for name, reason in reasons.items() if reason is None)
        return Place(rest, turn, reached, spot.score, searched.surface.name)

    def _no_room(
        self, own: Polygon, searched: SearchedSurface, outline: Polygon, obstacles: Sequence[Polygon]
    ) -> tuple[str, Rejection] | None:
        """Return why there is no room on a surface for the object's outline."""
        if any(polygon.margin(outline, corner) < EDGE for corner in own):
            return "edge", NoRoom(f"it would stick out over the edge of {searched.surface.name}")
        wide = _widened(own, FINGERS)
        if any(len(polygon.intersection(wide, other)) > 2 for other in obstacles if len(other) > 2):
            return "room", NoRoom("something is there already, or no finger fits between")
        return None

    def _stays(self) -> bool:
        """Return whether the robot that shall reach can't drive there."""
        return self._robot is not None and not drives(self._robot)

    def _unreached(self, arm: Arm, pose: Pose) -> Rejection | None:
        """Return why an arm of the robot can't put the object to a pose from where the robot stands; None if it can."""
        robot = self._robot
        assert robot is not None  # noqa: S101  as was asked before
        position, turn = robot.get_position_and_orientation()
        base: Pose = (position[0], position[1], position[2]), (turn[0], turn[1], turn[2], turn[3])
        if self._body in reaching.held(robot, arm):
            found = reaching.Putting(robot, PutDown(pose[0], pose[1], self._body)).reached(arm, base)
            return None if isinstance(found, str) else found
        moved = geometry.multiply(pose, geometry.invert(self._body.get_position_and_orientation()))
        tools = [
            geometry.multiply(moved, (grasp.position, grasp.orientation))
            for grasp in candidates(self._body, robot, arm)
        ]
        nearest: list[Rejection] = [OutOfReach(None)]
        for postures in Solver(robot, arm.tool_frame).search([(*tool, None) for tool in tools], quick=True):
            for posture in postures:
                if not posture.reaches():
                    nearest.append(OutOfReach(posture.position_error, posture.turn_error))
                    continue
                pairs = [pair for pair in checker.in_the_way(robot, posture.positions) if pair.body != self._body.name]
                if not pairs:
                    return None
                nearest.append(Touching(pairs))
        return min(nearest, key=lambda each: each.miss())


def _widened(outline: Polygon, margin: float) -> Polygon:
    """Return a convex polygon around another one, wider by a margin in m: the hull of circles about its corners."""
    around = [(margin * math.cos(angle), margin * math.sin(angle)) for angle in np.arange(8) * (math.pi / 4)]
    corners = [(x + dx, y + dy) for x, y in outline for dx, dy in around]
    return polygon.convex_hull(np.array(corners))
