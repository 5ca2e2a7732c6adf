"""Free places on surfaces, with room for an object and for fingers around the object (CRAM's ``on``)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, PlaceFailed, UnknownName
from pycram.models.robots.description import Arm
from pycram.models.shapes import pieces_of
from pycram.models.surfaces import Surface
from pycram.reasoning.collision import checker
from pycram.reasoning.collision.boxes import Boxes, concatenate
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping import placing
from pycram.reasoning.grasping.grasps import candidates
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.places import maps
from pycram.reasoning.places.goals import PutDown, PutDownGoal, description_of
from pycram.reasoning.places.maps import Grid, arm_reach, draw_cells, random_generator, room
from pycram.reasoning.places.search import Batch, FoundPlace, Search, Spot, drives
from pycram.reasoning.queries.query import world_of
from pycram.reasoning.rejections import TAKEN, NoRoom, OutOfReach, Rejection, Touching
from pycram.scheduling.future import unwrap
from pycram.world.attachment import held
from pycram.world.object import Object
from recorder import geometry
from recorder.geometry import Array, Polygon, Pose, Quaternion, Vector

#: A side of a surface or an object from the robot's view; "front" faces the robot.
Side: TypeAlias = Literal["front", "back", "left", "right"]
SIDES: Final = get_args(Side)

_SPOTS: Final = 40  # number of places in a batch
_BATCHES: Final = 3  # number of batches without a place after which the search on a surface ends
_LATER: Final = 0.6  # for each place that is found on a surface, the surface's score is multiplied by this factor
_BASE: Final = 0.005  # height in m above an object's lowest point; points below this height are its base
_RESTS: Final = 0.01  # tolerance in m between the height of the surface and the height at which the object rests
_YAWS: Final = 12  # number of orientations about the vertical; the motion tries the same orientations
EDGE: Final = 0.01  # minimum distance in m of an object from the edge of its surface
FINGERS: Final = 0.025  # minimum distance in m of an object from other objects, so that a finger fits between them
_RESOLUTION: Final = 0.025  # distance in m between cells
_FINEST: Final = 0.005  # minimum distance in m between cells, used on a surface that is hardly wider than the object
_CELLS: Final = 3  # number of cells across the part of a surface where the object's middle can be
_ABOVE: Final = 0.003  # height in m; lower parts aren't obstacles, because the boxes around surfaces are too high
_NEAR: Final = 0.15  # at this distance in m from a point, a score is half of the best
_FAR: Final = 1.0  # largest distance in m from a place to the point ``near``, or to the object of ``side``
_AWAY: Final = 0.4  # minimum distance in m between a place and the point ``away``
_APART: Final = 0.04  # minimum distance in m of a new place from offered or tried places
_EASY: Final = 0.5  # at this distance in m from the robot's nearest place, a score is half of the best
_FLOOR: Final = 0.15  # distance in m between places of the robot for which the reach is estimated
_COARSE: Final = 0.1  # distance in m between points of a surface for which the reach is estimated


def free_places(
    body: Object,
    *,
    on: Sequence[Object | tuple[Object, Surface | str]],
    near: Sequence[float] | None = None,
    side: str | tuple[str, Object] | None = None,
    orientation: Sequence[float] | None = None,
    reachable_for: Object | None = None,
    arms: Sequence[str] | None = None,
    away: Sequence[float] | None = None,
    seed: int | None = None,
) -> Iterator[FoundPlace]:
    """Return places where an object can be put down on surfaces, best first.

    The motion `place` would put the object down at each place: the whole outline of the object is on the surface, and
    fingers fit between this object and other objects. Each place is checked at the caller's request, and recorded as
    one query. The world may change between requests.

    Args:
        body: the object, in an upright orientation; its present place doesn't matter.
        on: surfaces or their names with the furniture, such as (kitchen, "island"); or objects, whose tops are used.
        near: xyz or xy in m of a point, at most 1 m away.
        side: "front", "back", "left" or "right" of each surface from the robot's view; or (side, object) for a side of
            an object.
        orientation: xyzw of the object at the place; None for any orientation about the vertical.
        reachable_for: a robot that must reach the place; a robot that drives may reach the place from any pose.
        arms: names of the robot's arms that may reach the place; None for all arms.
        away: xyz or xy in m of a point, at least 0.4 m away.
        seed: seed of the draws; None for the run's seed.

    Raises:
        BadArgument: A value is impossible.
        UnknownName: A side, arm or surface is unknown.
        NoPlace: There is no place; raised at the first request.
    """
    body, robot = unwrap(body), unwrap(reachable_for)
    surfaces = []
    for item in on:
        each, surface = item if isinstance(item, tuple | list) else (item, None)
        furniture = unwrap(each)
        world_of(furniture)
        named = surface if surface is None or isinstance(surface, Surface) else furniture.surface(surface)
        surfaces += [(furniture, top) for top in (furniture.tops if named is None else [named])]
    if not surfaces:
        raise BadArgument("on", on, "one or more surfaces with their furniture")
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


@dataclass(slots=True)
class SearchedSurface:
    """The state of the search on a surface."""

    furniture: Object
    surface: Surface
    share: float = 1.0  # factor of the surface's score, which decreases with each place that was found there
    failed: int = 0  # number of batches without a place since the last place

    @property
    def on_object(self) -> bool:
        """Whether the surface is the top of an object, such as a plate."""
        return self.surface.name not in self.furniture.surfaces

    def pose(self) -> Pose:
        """Return the pose of the surface's middle in the world."""
        return self.furniture.surface_pose(self.surface)

    def outline(self) -> Polygon:
        """Return the surface's outline in the world, seen from above, counterclockwise."""
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
        super().__init__(body.world, wanted, arguments, robot)
        self._body, self._orientation, self._near, self._away = body, orientation, near, away
        self._side, self._reference = side  # _reference is the object beside the place; None: the surface
        self._robot, self._arms, self._seed = robot, arms, seed
        self._surfaces = [SearchedSurface(furniture, surface) for furniture, surface in surfaces]
        self._done: list[Vector] = []  # offered or tried places
        self._turn = orientation or geometry.IDENTITY[1]
        self._corners = np.concatenate([corners for _, corners in pieces_of(body.model.path)])
        self._own = {body, *held(body)}

    def _next(self, batch: Batch, number: int) -> FoundPlace | None:
        searched, spots = self._draw(batch, number)
        place = self._first(batch, spots, searched)
        if place is not None:
            searched.failed, searched.share = 0, searched.share * _LATER
        else:
            searched.failed = searched.failed + 1 if spots else _BATCHES
        self._over = all(each.failed >= _BATCHES for each in self._surfaces)
        return place

    def _draw(self, batch: Batch, number: int) -> tuple[SearchedSurface, Sequence[Spot]]:
        """Return the most promising surface, and places from its maps; the number of batches starts at 0."""
        left = [searched for searched in self._surfaces if searched.failed < _BATCHES]
        found = []
        for searched in left:
            grid, factors = self._maps(searched)
            found.append((grid, *self._product(factors)))
        best = max(range(len(left)), key=lambda each: left[each].share * found[each][2])
        searched, (grid, scores, _) = left[best], found[best]
        batch.arguments = {**self._arguments, "on": [searched.furniture, searched.surface.name]}
        random = random_generator(self._seed, self.query, number, repr(batch.arguments))
        # the object's natural yaw: its present yaw, or the direction of a narrow surface
        width, along = geometry.narrowest_width(searched.outline())
        _, around = maps.radii(self._inside(self._turned_corners(self._turn), searched)[:, :2])
        start = along if width < 2 * (around + EDGE) else geometry.yaw_of(self._body.get_orientation())
        (_, _, height), _ = searched.pose()
        spots = []
        for cell, (x, y) in draw_cells(grid, scores, _SPOTS, random):
            step = int(random.integers(_YAWS))
            if self._stays and step % 2:  # an arm puts an object down most easily in its present orientation
                step = 0
            turn = self._orientation or geometry.from_rpy(0.0, 0.0, start + 2 * math.pi * step / _YAWS)
            pose = (x, y, height - float(self._turned_corners(turn)[:, 2].min())), turn
            spots.append(Spot(f"[{x:.3f}, {y:.3f}]", pose, geometry.yaw_of(turn), float(scores[cell])))
        return searched, batch.draw(grid, scores, spots)

    def _maps(self, searched: SearchedSurface) -> tuple[Grid, list[tuple[str, Array]]]:
        """Return the cells of a surface, and the maps (cells,) with the names of their constraints."""
        outline = searched.outline()
        (_, _, height), _ = searched.pose()
        corners = np.array(outline)
        stands = self._turned_corners(self._turn)
        inner, outer = maps.radii(stands[:, :2])
        base = self._inside(stands, searched)[:, :2]
        inside, around = maps.radii(base)
        half = geometry.narrowest_width(geometry.convex_hull(base))[0] / 2 if searched.on_object else inside
        resolution = min(max((geometry.narrowest_width(outline)[0] - 2 * (half + EDGE)) / _CELLS, _FINEST), _RESOLUTION)
        grid = Grid.over(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), height, resolution)
        centers = grid.centers()
        factors = [
            ("clearance", np.full(len(centers), float(np.ptp(stands[:, 2]) <= searched.surface.clearance))),
            ("edge", self._within(centers, outline, inside, around)),
            ("room", maps.clear(centers, self._obstacles(searched), inner, outer + FINGERS)),
        ]
        if self._near is not None:
            factors.append(("near", maps.near(centers, self._near, _NEAR, _FAR)))
        if self._away is not None:
            factors.append(("away-from", maps.away(centers, [self._away], _AWAY)))
        if self._side is not None:
            factors.append((f"side {self._side}", self._beside(centers, searched)))
        if self._robot is not None:
            factors.append(("reach", self._reach(grid, self._robot)))
        factors.append(("tried", maps.away(centers, self._done, _APART)))
        return grid, factors

    def _turned_corners(self, turn: Quaternion) -> Array:
        """Return the object's corners (n, 3) in m relative to its origin, after a rotation."""
        return self._corners @ geometry.to_matrix(turn).T

    @staticmethod
    def _inside(corners: Array, searched: SearchedSurface) -> Array:
        """Return the corners (n, 3) that must be on a surface; on the top of an object, only the corners of the base.

        So the handle of a cup may stick out over the edge of a plate. If the object would tip over, all corners count.
        """
        if not searched.on_object:
            return corners
        lowest = corners[corners[:, 2] < corners[:, 2].min() + _BASE]
        middle = (corners[:, :2].min(axis=0) + corners[:, :2].max(axis=0)) / 2
        base = geometry.convex_hull(lowest[:, :2])
        return lowest if geometry.margin_in_polygon(base, middle.tolist()) > 0.0 else corners

    @staticmethod
    def _within(centers: Array, outline: Polygon, inner: float, outer: float) -> Array:
        """Return scores: 0 where an object sticks out over the edge in all orientations, 1 where it never does."""
        margins = np.full(len(centers), np.inf)
        for (ax, ay), (bx, by) in itertools.pairwise([*outline, outline[0]]):
            length = max(math.hypot(bx - ax, by - ay), 1e-9)
            side = ((bx - ax) * (centers[:, 1] - ay) - (by - ay) * (centers[:, 0] - ax)) / length
            np.minimum(margins, side, out=margins)
        ramp: Array = np.clip((margins - inner - EDGE) / max(outer - inner, 1e-3), 0.0, 1.0)
        return np.where(margins < inner, 0.0, 0.3 + 0.7 * ramp)

    def _obstacles(self, searched: SearchedSurface) -> maps.Footprints:
        """Return the footprints of other objects, from a surface up to the object's height.

        Robots that drive don't count, because these robots can make room.
        """
        clone = clone_of(self._body.world, "reach")
        left_out = {*self._own, *(held(self._robot) if self._robot else ())}
        if not searched.furniture.fixed:  # the outline of a free object's surface excludes its rim or walls
            left_out.add(searched.furniture)
        others = [each for each in self._body.world.objects if each not in left_out]
        (_, _, height), _ = searched.pose()
        boxes = concatenate([_parked(each) if each.is_robot else clone.boxes(each) for each in others])
        return maps.Footprints(boxes, height + _ABOVE, height + float(np.ptp(self._turned_corners(self._turn)[:, 2])))

    def _beside(self, centers: Array, searched: SearchedSurface) -> Array:
        """Return the scores for the wanted side of a surface or an object; the scores are 0 on other sides."""
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
        return np.where(along > np.abs(offsets @ (-y, x)), maps.near(centers, middle, _NEAR, _FAR), 0.0)

    def _reach(self, grid: Grid, robot: Object) -> Array:
        """Return scores of how well the robot reaches each cell; a robot that drives chooses the best place."""
        (x, y, height), here = grid.origin, robot.get_position()
        low, high = (x, y), (x + grid.shape[1] * grid.resolution, y + grid.shape[0] * grid.resolution)
        lift = float(np.ptp(self._corners[:, 2])) / 2  # arms grasp objects at about half of their height, m
        shoulders = [
            (arm_reach(robot, arm), height + lift - robot.get_link_position(arm.base_link)[2]) for arm in self._arms
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
        if drives(robot):  # an arm that stretches far over a surface would hit the objects there
            best /= 1.0 + (distances.min(axis=1) / _EASY) ** 4
        column, row = ((grid.centers() - low) / coarse.resolution).astype(np.intp).T
        spread_out: Array = best.reshape(coarse.shape)[row, column]
        return spread_out

    def _first(self, batch: Batch, spots: Sequence[Spot], searched: SearchedSurface) -> FoundPlace | None:
        outline = searched.outline()
        obstacles = [geometry.convex_hull(each) for each in self._obstacles(searched).corners().reshape(-1, 4, 2)]
        for spot in batch.admitted(spots):
            self._done.append(spot.pose[0])
            excluded = self._excluded(spot, searched, outline, obstacles)
            if isinstance(excluded, FoundPlace):
                answer = {"position": excluded.position, "orientation": excluded.orientation, "arms": excluded.arms}
                batch.take(spot.name, answer)
                return excluded
            self._exclude(batch, spot, *excluded)
        return None

    def _excluded(
        self, spot: Spot, searched: SearchedSurface, outline: Polygon, obstacles: Sequence[Polygon]
    ) -> FoundPlace | tuple[str, Rejection]:
        (x, y, z), turn = spot.pose
        taken = self._no_room(spot, searched, outline, obstacles)
        if taken is not None:
            return taken
        try:
            rest = placing.resting_position(self._body, (x, y, z), turn)
        except PlaceFailed as failure:
            return "room", NoRoom(failure.reason)
        if abs(rest[2] - z) > _RESTS:
            return "room", NoRoom(f"the object wouldn't rest on {searched.surface.name}")
        reasons = {arm.name: self._unreached(arm, (rest, turn)) for arm in self._arms if self._stays}
        missed = [reason for reason in reasons.values() if reason is not None]
        if reasons and len(missed) == len(reasons):
            return "reach", min(missed, key=lambda each: each.miss())
        reached = tuple(name for name, reason in reasons.items() if reason is None)
        return FoundPlace(rest, turn, reached, spot.score, searched.surface.name)

    def _no_room(
        self, spot: Spot, searched: SearchedSurface, outline: Polygon, obstacles: Sequence[Polygon]
    ) -> tuple[str, Rejection] | None:
        (x, y, _), turn = spot.pose
        corners = self._turned_corners(turn)
        own = inside = geometry.convex_hull(corners[:, :2] + (x, y))
        if searched.on_object:
            inside = geometry.convex_hull(self._inside(corners, searched)[:, :2] + (x, y))
        if any(geometry.margin_in_polygon(outline, corner) < EDGE for corner in inside):
            return "edge", NoRoom(f"the object would stick out over the edge of {searched.surface.name}")
        # the outline of an object with a margin for fingers: the hull of circles about the corners
        circle = [(FINGERS * math.cos(angle), FINGERS * math.sin(angle)) for angle in np.arange(8) * (math.pi / 4)]
        wide = geometry.convex_hull(np.array([(a + dx, b + dy) for a, b in own for dx, dy in circle]))
        if any(len(geometry.polygon_intersection(wide, other)) > 2 for other in obstacles if len(other) > 2):
            return "room", NoRoom(TAKEN)
        return None

    def _unreached(self, arm: Arm, pose: Pose) -> Rejection | None:
        """Return why an arm can't move the object to a pose while the base stays; None if the arm can."""
        robot = self._robot
        assert robot is not None  # noqa: S101  the caller has checked
        position, turn = robot.get_position_and_orientation()
        base: Pose = (position[0], position[1], position[2]), (turn[0], turn[1], turn[2], turn[3])
        if self._body in held(robot, arm):
            found = PutDownGoal(robot, PutDown(pose[0], pose[1], self._body)).reached(arm, base)
            return None if isinstance(found, str) else found
        moved = geometry.multiply(pose, geometry.invert(self._body.get_position_and_orientation()))
        grasps = [(grasp.position, grasp.orientation) for grasp in candidates(self._body, robot, arm)]
        tools = [geometry.multiply(moved, grasp) for grasp in grasps]
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


def _parked(robot: Object) -> Boxes:
    """Return boxes around a robot that can't drive, with its arms parked; no boxes for a robot that drives."""
    arms = robot.description.arms.values() if robot.description and not drives(robot) else ()
    park = {joint: value for arm in arms if "park" in arm.poses for joint, value in arm.posture("park").items()}
    if not park:
        return concatenate([])
    with CollisionChecker(robot, park, all_links=True) as checker:
        (candidate,) = checker.predict([park])
        return checker.boxes(candidate)
