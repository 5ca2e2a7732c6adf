"""Where an object can be put down on surfaces: with room for its outline and for fingers around it (CRAM's ``on``)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, PlaceFailed, UnknownName
from pycram.models.surfaces import Surface
from pycram.models.visual import pieces_of
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.boxes import concatenate
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.driving import drives
from pycram.reasoning.grasping import placing
from pycram.reasoning.grasping.fingers import held
from pycram.reasoning.grasping.grasps import candidates, yaw_of
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.places import maps
from pycram.reasoning.places.goals import PutDown, Putting, description_of
from pycram.reasoning.places.maps import Grid, arm_reach, generator, room, spread
from pycram.reasoning.places.search import Batch, Place, Search, Spot
from pycram.reasoning.queries.query import world_of
from pycram.reasoning.rejections import NoRoom, OutOfReach, Touching
from pycram.scheduling.future import unwrap
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from pycram.models.robots.description import Arm
    from pycram.reasoning.collision.boxes import Boxes
    from pycram.reasoning.rejections import Rejection
    from pycram.world.object import Object
    from recorder.geometry import Polygon, Pose, Quaternion, Vector

    Array = NDArray[np.float64]


SIDES: Final = ("front", "back", "left", "right")
"""Of a surface or an object, as its robot sees it: "front" is the side that faces the robot."""

_SPOTS: Final = 40  # that are drawn at once
_BATCHES: Final = 3  # without a place, after which a surface is given up
_LATER: Final = 0.6  # of its score that a surface keeps with each place that it has given
_RESTS: Final = 0.01  # m by which an object may rest higher or lower than on the surface
_YAWS: Final = 12  # orientations about the vertical, as they are tried where something is placed
EDGE: Final = 0.01  # m from an object to the edge of what it stands on
FINGERS: Final = 0.025  # m from an object to others: a finger fits between
_RESOLUTION: Final = 0.025  # m
_FINEST: Final = 0.005  # m, where a surface is hardly wider than the object
_CELLS: Final = 3  # across the strip of a surface in which the object's middle may be
_ABOVE: Final = 0.003  # m above a surface from which on something stands in the way; the surface's own boxes are wider
_NEAR: Final = 0.15  # m at which a place near a point counts half
_FAR: Final = 1.0  # m from a point or an object at which a place isn't near it, or beside it, any more
_AWAY: Final = 0.4  # m from what a place is to be away from
_APART: Final = 0.04  # m between places that are offered, or were tried
_EASY: Final = 0.5  # m from the nearest place of the robot, at which a place counts half
_FLOOR: Final = 0.15  # m between places of the robot from which a surface may be reached
_COARSE: Final = 0.1  # m between places of a surface for which that is asked


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
        description = description_of("reachable_for", robot)
        chosen = [description.arm(each) for each in (description.arms if arms is None else arms)]
    point = None if near is None else checks.vector("near", (*near, 0.0) if len(near) == 2 else near)
    off = None if away is None else checks.vector("away", (*away, 0.0) if len(away) == 2 else away)
    turn = None if orientation is None else checks.quaternion("orientation", orientation)
    return SurfaceSearch(body, surfaces, point, (name, reference), turn, robot, chosen, off, seed).places()


def _surface(furniture: Object, surface: Surface | str) -> tuple[Object, Surface]:
    """Return a surface that is given, or named, with its furniture."""
    world_of(furniture)
    return furniture, surface if isinstance(surface, Surface) else furniture.surface(surface)


@dataclass(slots=True)
class SearchedSurface:
    """A surface that is looked at."""

    furniture: Object  # whose it is
    surface: Surface  # the surface
    share: float = 1.0  # of its score that it has kept
    failed: int = 0  # batches without a place, one after the other

    def pose(self) -> Pose:
        """Return the pose of its middle in the world."""
        return self.furniture.surface_pose(self.surface)

    def outline(self) -> Polygon:
        """Return its outline in the world, seen from above, counterclockwise."""
        pose = self.pose()
        corners = [geometry.transform(pose, (x, y, 0.0))[:2] for x, y in self.surface.outline]
        return geometry.convex_hull(np.array(corners))


class SurfaceSearch(Search):
    """A search for places of an object on surfaces."""

    query = "free_places"

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
        arguments = {
            "object": body,
            "near": near,
            "side": [each for each in side if each is not None] if side[0] else None,
            "away": away,
            "orientation": orientation,
            "reachable_for": robot,
            "arms": [arm.name for arm in arms] if robot is not None else None,
        }
        wanted = f"{body.name} on {' or '.join(surface.name for _, surface in surfaces)}"
        super().__init__(body.world, wanted, arguments)
        self._body, self._orientation, self._near, self._away = body, orientation, near, away
        self._side, self._reference = side  # the object beside which it shall be; None for a side of each surface
        self._robot, self._arms, self._seed = robot, arms, seed
        self._surfaces = [SearchedSurface(furniture, surface) for furniture, surface in surfaces]
        self._done: list[Vector] = []  # places that were offered or tried
        self._turn = orientation or geometry.IDENTITY[1]
        self._corners = np.concatenate([corners for _, corners in pieces_of(body.model.path)])
        self._own = {body, *held(body)}

    def _next(self, batch: Batch, number: int) -> Place | None:
        searched, spots = self._draw(batch, number)
        place = self._first(batch, spots, searched)
        if place is not None:
            searched.failed, searched.share = 0, searched.share * _LATER
        else:
            searched.failed = searched.failed + 1 if spots else _BATCHES
        self._over = all(each.failed >= _BATCHES for each in self._surfaces)
        return place

    def _draw(self, batch: Batch, number: int) -> tuple[SearchedSurface, Sequence[Spot]]:
        """Return the most promising surface, and places drawn from its maps, for the n-th batch from 0."""
        left = [searched for searched in self._surfaces if searched.failed < _BATCHES]
        found = []
        for searched in left:
            grid, factors = self._maps(searched)
            found.append((grid, *self._product(factors)))
        best = max(range(len(left)), key=lambda each: left[each].share * found[each][2])
        searched, (grid, scores, _) = left[best], found[best]
        batch.arguments = {**self._arguments, "on": [searched.furniture, searched.surface.name]}
        random = generator(self._seed, self.query, number, repr(batch.arguments))
        start = self._heading(searched)
        (_, _, height), _ = searched.pose()
        spots = []
        for cell, (x, y) in spread(grid, scores, _SPOTS, random):
            step = int(random.integers(_YAWS))
            if self._stays() and step % 2:  # an arm that has taken it puts it down most easily as it stood
                step = 0
            yaw = start + 2 * math.pi * step / _YAWS
            turn = self._orientation or geometry.from_rpy(0.0, 0.0, yaw)
            pose = (x, y, height - float(self._turned_corners(turn)[:, 2].min())), turn
            spots.append(Spot(f"[{x:.3f}, {y:.3f}]", pose, yaw_of(turn), float(scores[cell])))
        return searched, batch.draw(grid, scores, spots)

    # --- maps: all places together -----------------------------------------------------------------------------------

    def _maps(self, searched: SearchedSurface) -> tuple[Grid, list[tuple[str, Array]]]:
        """Return the cells of a surface, and a map (cells,) for each constraint, by its name."""
        outline = searched.outline()
        (_, _, height), _ = searched.pose()
        corners = np.array(outline)
        stands = self._turned_corners(self._turn)
        inner, outer = maps.radii(stands[:, :2])
        strip = geometry.narrowest(outline)[0] - 2 * (inner + EDGE)
        resolution = min(max(strip / _CELLS, _FINEST), _RESOLUTION)
        grid = Grid.over(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), height, resolution)
        centers = grid.centers()
        fits = float(np.ptp(stands[:, 2])) <= searched.surface.clearance
        factors = [
            ("clearance", np.full(len(centers), float(fits))),
            ("edge", self._within(centers, outline, inner, outer)),
            ("room", maps.clear(centers, self._obstacles(searched), inner, outer + FINGERS)),
        ]
        if self._near is not None:
            factors.append(("near", maps.near(centers, self._near, _NEAR, _FAR)))
        if self._away is not None:
            factors.append(("away-from", maps.away(centers, [self._away], _AWAY)))
        if self._side is not None:
            factors.append((f"side {self._side}", self._beside(centers, searched)))
        if self._robot is not None:
            factors.append(("reach", self._reach(grid)))
        factors.append(("tried", maps.away(centers, self._done, _APART)))
        return grid, factors

    def _heading(self, searched: SearchedSurface) -> float:
        """Return a natural yaw of the object on a surface, rad: as it is now, or along what is hardly wider than it."""
        width, along = geometry.narrowest(searched.outline())
        _, outer = maps.radii(self._turned_corners(self._turn)[:, :2])
        return along if width < 2 * (outer + EDGE) else yaw_of(self._body.get_orientation())

    def _turned_corners(self, turn: Quaternion) -> Array:
        """Return the object's corners (n, 3) from its origin when it is turned, m."""
        corners: Array = self._corners @ geometry.to_matrix(turn).T
        return corners

    @staticmethod
    @staticmethod
    def _within(centers: Array, outline: Polygon, inner: float, outer: float) -> Array:
        """Return 0 where an object would stick out over the edge however it is turned, 1 where it wouldn't."""
        margins = np.full(len(centers), np.inf)
        for (ax, ay), (bx, by) in itertools.pairwise([*outline, outline[0]]):
            length = max(math.hypot(bx - ax, by - ay), 1e-9)
            side = ((bx - ax) * (centers[:, 1] - ay) - (by - ay) * (centers[:, 0] - ax)) / length
            np.minimum(margins, side, out=margins)
        ramp: Array = np.clip((margins - inner - EDGE) / max(outer - inner, 1e-3), 0.0, 1.0)
        return np.where(margins < inner, 0.0, 0.3 + 0.7 * ramp)

    def _obstacles(self, searched: SearchedSurface) -> maps.Footprints:
        """Return what stands on a surface, or hangs above it as low as the object is high.

        So do robots that are bolted down; others drive away.
        """
        clone = clone_of(self._body.world, "reach")
        carried = held(self._robot) if self._robot else ()
        others = [each for each in self._body.world.objects if each not in self._own and each not in carried]
        (_, _, height), _ = searched.pose()
        size = float(np.ptp(self._turned_corners(self._turn)[:, 2]))
        boxes = concatenate([_parked(each) if each.is_robot else clone.boxes(each) for each in others])
        return maps.Footprints(boxes, height + _ABOVE, height + size)

    def _beside(self, centers: Array, searched: SearchedSurface) -> Array:
        """Return 0 on the other side of a surface or an object, 1 on the wanted one."""
        reference = self._reference
        middle = center(reference) if reference is not None else searched.pose()[0]
        robot = self._robot or self._body.world.robot
        eye = robot.get_position() if robot is not None else (0.0, 0.0, 0.0)
        facing = math.atan2(middle[1] - eye[1], middle[0] - eye[0])
        turn = {"back": 0.0, "left": math.pi / 2, "front": math.pi, "right": -math.pi / 2}[str(self._side)]
        x, y = math.cos(facing + turn), math.sin(facing + turn)
        offsets = centers - np.asarray(middle[:2])
        along: Array = offsets @ (x, y)
        if reference is None:
            return np.where(along > 0.0, 1.0, 0.0)
        across = np.abs(offsets @ (-y, x))
        near = maps.near(centers, middle, _NEAR, _FAR)
        beside: Array = np.where(along > across, near, 0.0)
        return beside

    def _reach(self, grid: Grid) -> Array:
        """Return how well a robot reaches cells, from where it stands, or from wherever it could."""
        robot = self._robot
        assert robot is not None  # noqa: S101  as was asked before
        (x, y, height), here = grid.origin, robot.get_position()
        low, high = (x, y), (x + grid.shape[1] * grid.resolution, y + grid.shape[0] * grid.resolution)
        shoulders = [
            (arm_reach(robot, arm), height + self._lift() - robot.get_link_position(arm.base_link)[2])
            for arm in self._arms
        ]
        if drives(robot):
            radius = max(reach.radius for reach, _ in shoulders)
            floor = [edge - radius for edge in low], [edge + radius for edge in high]
            places = Grid.over(*floor, here[2], _FLOOR).centers()
            free = room(robot, places)
            places, free = places[free > 0.0], free[free > 0.0]
        else:
            places, free = np.array([here[:2]]), np.ones(1)
        if not len(places):
            return np.zeros(len(grid.centers()))
        coarse = Grid.over(low, high, height, _COARSE)
        distances = np.hypot(*(coarse.centers()[:, None] - places[None]).transpose(2, 0, 1))
        best = np.max([(reach.best(above, distances) * free).max(axis=1) for reach, above in shoulders], axis=0)
        if drives(robot):  # an arm that stretches far over a surface meets what stands around there
            best /= 1.0 + (distances.min(axis=1) / _EASY) ** 4
        column, row = ((grid.centers() - low) / coarse.resolution).astype(np.intp).T
        spread_out: Array = best.reshape(coarse.shape)[row, column]
        return spread_out

    def _lift(self) -> float:
        """Return how far above what it stands on an object is taken, roughly: at half of its height, m."""
        return float(np.ptp(self._corners[:, 2])) / 2

    # --- checks: one place after the other ---------------------------------------------------------------------------

    def _first(self, batch: Batch, spots: Sequence[Spot], searched: SearchedSurface) -> Place | None:
        """Return the first place that will do."""
        outline = searched.outline()
        obstacles = [geometry.convex_hull(each) for each in self._obstacles(searched).corners().reshape(-1, 4, 2)]
        for spot in spots:
            self._done.append(spot.pose[0])
            excluded = self._excluded(spot, searched, outline, obstacles)
            if isinstance(excluded, Place):
                batch.take(
                    spot.name,
                    {"position": excluded.position, "orientation": excluded.orientation, "arms": excluded.arms},
                )
                return excluded
            self._exclude(batch, spot, *excluded)
        return None

    def _excluded(
        self, spot: Spot, searched: SearchedSurface, outline: Polygon, obstacles: Sequence[Polygon]
    ) -> Place | tuple[str, Rejection]:
        """Return a place that will do, or which constraint excludes it, and why."""
        (x, y, z), turn = spot.pose
        own = geometry.convex_hull(self._turned_corners(turn)[:, :2] + (x, y))
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
        if any(geometry.margin(outline, corner) < EDGE for corner in own):
            return "edge", NoRoom(f"it would stick out over the edge of {searched.surface.name}")
        wide = _widened(own, FINGERS)
        if any(len(geometry.intersection(wide, other)) > 2 for other in obstacles if len(other) > 2):
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
        if self._body in held(robot, arm):
            found = Putting(robot, PutDown(pose[0], pose[1], self._body)).reached(arm, base)
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
    return geometry.convex_hull(np.array(corners))


def _parked(robot: Object) -> Boxes:
    """Return boxes around a robot that is bolted down, arms parked: where it is when it has put something down.

    One that drives is somewhere else then, as far as is known here: it has none.
    """
    arms = robot.description.arms.values() if robot.description and not drives(robot) else ()
    park = {joint: value for arm in arms if "park" in arm.poses for joint, value in arm.posture("park").items()}
    if not park:
        return concatenate([])
    with CollisionChecker(robot, park, all_links=True) as checker:
        (candidate,) = checker.predict([park])
        return checker.boxes(candidate)
