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
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.grasping import placing
from pycram.reasoning.grasping.grasps import candidates
from pycram.reasoning.grasping.sides import yaw_of
from pycram.reasoning.kinematics.solver import Solver
from pycram.reasoning.places import maps, reaching
from pycram.reasoning.places.arm_reach import arm_reach
from pycram.reasoning.places.batch import Batch, Spot
from pycram.reasoning.places.grid import Grid, generator, spread
from pycram.reasoning.places.outline import room
from pycram.reasoning.places.place import Place, PutDown
from pycram.reasoning.places.reaching import drives
from pycram.reasoning.places.wishes import Wishes
from pycram.reasoning.queries import polygon
from pycram.reasoning.queries.query import world_of
from pycram.reasoning.rejections import NoRoom, OutOfReach, Touching
from pycram.scheduling.future import unwrap
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from pycram.models.robots.description import Arm
    from pycram.reasoning.queries.polygon import Polygon
    from pycram.reasoning.rejections import Rejection
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion, Vector

    Array = NDArray[np.float64]

SIDES: Final = ("front", "back", "left", "right")
"""Of a surface or an object, as its robot sees it: "front" is the side that faces the robot."""

_RESOLUTION: Final = 0.025  # m
_SPOTS: Final = 40  # that are drawn at once
_BATCHES: Final = 3  # without a place, after which a surface is given up
_LATER: Final = 0.6  # of its score that a surface keeps with each place that it has given
_EDGE: Final = 0.01  # m from an object to the edge of what it stands on
_FINGERS: Final = 0.025  # m from an object to others: a finger fits between
_ABOVE: Final = 0.003  # m above a surface from which on something stands in the way; the surface's own boxes are wider
_RESTS: Final = 0.01  # m by which an object may rest higher or lower than on the surface
_NEAR: Final = 0.15  # m at which a place near a point counts half
_FAR: Final = 1.0  # m from a point or an object at which a place isn't near it, or beside it, any more
_AWAY: Final = 0.4  # m from what a place is to be away from
_APART: Final = 0.04  # m between places that are offered, or were tried
_YAWS: Final = 12  # orientations about the vertical, as they are tried where something is placed
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


@dataclass(slots=True)
class _Field:
    """A surface that is looked at.

    Attributes:
        furniture: whose it is.
        surface: the surface.
        share: of its score that it has kept.
        vain: batches without a place.
    """

    furniture: Object
    surface: Surface
    share: float = 1.0
    vain: int = 0

    def pose(self) -> Pose:
        """Return the pose of its middle in the world."""
        return self.furniture.surface_pose(self.surface)

    def outline(self) -> Polygon:
        """Return its outline in the world, seen from above, counterclockwise."""
        pose = self.pose()
        corners = [geometry.transform(pose, (x, y, 0.0))[:2] for x, y in self.surface.outline]
        return polygon.convex_hull(np.array(corners))


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
        self._body, self._near, self._side, self._orientation = body, near, side, orientation
        self._robot, self._arms, self._away, self._seed = robot, arms, away, seed
        self._fields = [_Field(furniture, surface) for furniture, surface in surfaces]
        self._done: list[Vector] = []
        self._wishes = Wishes(f"{body.name} on {' or '.join(surface.name for _, surface in surfaces)}")
        self._arguments: Mapping[str, object] = {
            "object": body,
            **({"near": near} if near is not None else {}),
            **({"side": [side[0], *([side[1]] if side[1] else [])]} if side[0] else {}),
            **({"away": away} if away is not None else {}),
            **({"orientation": orientation} if orientation is not None else {}),
            **({"reachable_for": robot, "arms": [arm.name for arm in arms]} if robot is not None else {}),
        }
        self._corners = np.concatenate([corners for _, corners in pieces_of(body.model.path)])
        self._own = {body, *reaching.held(body)}

    def places(self) -> Iterator[Place]:
        """Yield places, each from a query of its own."""
        found = False
        for number in itertools.count():
            batch = Batch("free_places", self._arguments)
            with batch.asked(self._body.world, trace=False):
                clone_of(self._body.world, "reach").sync()
                field, spots = self._drawn(batch, number)
                place = self._first(batch, spots, field)
                if place is None:
                    field.vain = field.vain + 1 if spots else _BATCHES
                over = all(each.vain >= _BATCHES for each in self._fields)
                if over and not found:
                    raise self._wishes.failure()
            if place is not None:
                found, field.vain, field.share = True, 0, field.share * _LATER
                yield place
            elif over:
                return

    # --- all places at once ------------------------------------------------------------------------------------------

    def _maps(self, field: _Field) -> tuple[Grid, Array, float]:
        """Return the cells of a surface, the product (cells,) of its maps, and how good the best cell is."""
        outline = field.outline()
        (_, _, height), _ = field.pose()
        corners = np.array(outline)
        grid = Grid.over(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), height, _RESOLUTION)
        centers = grid.centers()
        stands = self._turned(0.0)
        inner, outer = maps.radii(stands[:, :2])
        fits = float(np.ptp(stands[:, 2])) <= field.surface.clearance
        wishes = [
            ("clearance", np.full(len(centers), float(fits))),
            ("edge", self._within(centers, outline, inner, outer)),
            ("room", maps.clear(centers, self._obstacles(field), inner, outer + _FINGERS)),
        ]
        if self._near is not None:
            wishes.append(("near", maps.near(centers, self._near, _NEAR, _FAR)))
        if self._away is not None:
            wishes.append(("away from", maps.away(centers, [self._away], _AWAY)))
        if self._side[0] is not None:
            wishes.append((f"side {self._side[0]}", self._beside(centers, field)))
        if self._robot is not None:
            wishes.append(("reach", self._reach(grid)))
        wishes.append(("tried", maps.away(centers, self._done, _APART)))
        return grid, *self._wishes.product(wishes)

    def _turned(self, yaw: float) -> Array:
        """Return the object's corners (n, 3) from its origin when it stands upright, turned by a yaw in rad."""
        upright = self._orientation or geometry.from_rpy(0.0, 0.0, yaw)
        corners: Array = self._corners @ geometry.to_matrix(upright).T
        return corners

    @staticmethod
    def _within(centers: Array, outline: Polygon, inner: float, outer: float) -> Array:
        """Return 0 where an object would stick out over the edge however it is turned, 1 where it wouldn't."""
        margins = np.full(len(centers), np.inf)
        for (ax, ay), (bx, by) in itertools.pairwise([*outline, outline[0]]):
            length = max(math.hypot(bx - ax, by - ay), 1e-9)
            side = ((bx - ax) * (centers[:, 1] - ay) - (by - ay) * (centers[:, 0] - ax)) / length
            np.minimum(margins, side, out=margins)
        ramp: Array = np.clip((margins - inner - _EDGE) / max(outer - inner, 1e-3), 0.0, 1.0)
        return np.where(margins < inner, 0.0, 0.3 + 0.7 * ramp)

    def _obstacles(self, field: _Field) -> maps.Footprints:
        """Return what stands on a surface, or hangs above it as low as the object is high."""
        clone = clone_of(self._body.world, "reach")
        robots = {self._robot, *(reaching.held(self._robot) if self._robot else ())}
        others = [each for each in self._body.world.objects if each not in self._own and each not in robots]
        (_, _, height), _ = field.pose()
        size = float(np.ptp(self._turned(0.0)[:, 2]))
        boxes = concatenate([clone.boxes(each) for each in others if not each.is_robot])
        return maps.Footprints(boxes, height + _ABOVE, height + size)

    def _beside(self, centers: Array, field: _Field) -> Array:
        """Return 0 on the other side of a surface or an object, 1 on the wanted one."""
        name, reference = self._side
        middle = center(reference) if reference is not None else field.pose()[0]
        robot = self._robot or self._body.world.robot
        eye = robot.get_position() if robot is not None else (0.0, 0.0, 0.0)
        facing = math.atan2(middle[1] - eye[1], middle[0] - eye[0])
        turn = {"back": 0.0, "left": math.pi / 2, "front": math.pi, "right": -math.pi / 2}[str(name)]
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
        column, row = ((grid.centers() - low) / coarse.resolution).astype(np.intp).T
        spread_out: Array = best.reshape(coarse.shape)[row, column]
        return spread_out

    def _lift(self) -> float:
        """Return how far above what it stands on an object is taken, roughly: at half of its height, m."""
        return float(np.ptp(self._corners[:, 2])) / 2

    def _drawn(self, batch: Batch, number: int) -> tuple[_Field, Sequence[Spot]]:
        """Return the surface that promises most, and places drawn from its maps, for the n-th batch from 0."""
        left = [field for field in self._fields if field.vain < _BATCHES]
        known = [self._maps(field) for field in left]
        best = max(range(len(left)), key=lambda each: left[each].share * known[each][2])
        field, (grid, scores, _) = left[best], known[best]
        batch.arguments = {**self._arguments, "on": [field.furniture, field.surface.name]}
        random = generator(self._seed, "free_places", number, repr(batch.arguments))
        start = yaw_of(self._body.get_orientation())
        (_, _, height), _ = field.pose()
        spots = []
        for cell, (x, y) in spread(grid, scores, _SPOTS, random):
            step = int(random.integers(_YAWS))
            if self._stays() and step % 2:  # an arm that has taken it puts it down most easily as it stood
                step = 0
            yaw = start + 2 * math.pi * step / _YAWS
            turn = self._orientation or geometry.from_rpy(0.0, 0.0, yaw)
            pose = (x, y, height - float(self._turned(yaw)[:, 2].min())), turn
            spots.append(Spot(f"[{x:.3f}, {y:.3f}]", pose, yaw_of(turn), float(scores[cell])))
        return field, batch.draw(grid, scores, spots)

    # --- one place after the other -----------------------------------------------------------------------------------

    def _first(self, batch: Batch, spots: Sequence[Spot], field: _Field) -> Place | None:
        """Return the first place that will do."""
        outline = field.outline()
        obstacles = [polygon.convex_hull(each) for each in self._obstacles(field).corners().reshape(-1, 4, 2)]
        for spot in spots:
            self._done.append(spot.pose[0])
            excluded = self._excluded(spot, field, outline, obstacles)
            if isinstance(excluded, Place):
                batch.take(
                    spot.name,
                    {"position": excluded.position, "orientation": excluded.orientation, "arms": excluded.arms},
                )
                return excluded
            self._wishes.exclude(batch, spot, *excluded)
        return None

    def _excluded(
        self, spot: Spot, field: _Field, outline: Polygon, obstacles: Sequence[Polygon]
    ) -> Place | tuple[str, Rejection]:
        """Return a place that will do, or which wish excludes it, and why."""
        (x, y, z), turn = spot.pose
        corners = self._corners @ geometry.to_matrix(turn).T
        own = polygon.convex_hull(corners[:, :2] + (x, y))
        taken = self._no_room(own, field, outline, obstacles)
        if taken is not None:
            return taken
        try:
            rest = placing.set_down(self._body, (x, y, z), turn)
        except PlaceFailed as failure:
            return "room", NoRoom(failure.reason)
        if abs(rest[2] - z) > _RESTS:
            return "room", NoRoom(f"it would not rest on {field.surface.name}")
        reasons = {arm.name: self._unreached(arm, (rest, turn)) for arm in self._arms if self._stays()}
        missed = [reason for reason in reasons.values() if reason is not None]
        if reasons and len(missed) == len(reasons):
            return "reach", min(missed, key=lambda each: each.miss())
        reached = tuple(name for name, reason in reasons.items() if reason is None)
        return Place(rest, turn, reached, spot.score, field.surface.name)

    def _no_room(
        self, own: Polygon, field: _Field, outline: Polygon, obstacles: Sequence[Polygon]
    ) -> tuple[str, Rejection] | None:
        """Return why there is no room on a surface for the object's outline."""
        if any(polygon.margin(outline, corner) < _EDGE for corner in own):
            return "edge", NoRoom(f"it would stick out over the edge of {field.surface.name}")
        wide = _widened(own, _FINGERS)
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
