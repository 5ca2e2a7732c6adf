"""Maps of a surface: how well an object could be put down on each of its cells, by each constraint."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.visual import pieces_of
from pycram.reasoning.collision.boxes import concatenate
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.driving import drives
from pycram.reasoning.grasping.sides import yaw_of
from pycram.reasoning.places import maps, reaching
from pycram.reasoning.places.arm_reach import arm_reach
from pycram.reasoning.places.grid import Grid
from pycram.reasoning.places.outline import room
from recorder import geometry
from recorder.geometry import polygon

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pycram.models.robots.description import Arm
    from pycram.models.surfaces import Surface
    from pycram.reasoning.collision.boxes import Boxes
    from pycram.world.object import Object
    from recorder.geometry import Pose, Quaternion, Vector
    from recorder.geometry.polygon import Polygon

    Array = NDArray[np.float64]

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


@dataclass(slots=True)
class SearchedSurface:
    """A surface that is looked at.

    Attributes:
        furniture: whose it is.
        surface: the surface.
        share: of its score that it has kept.
        failed: batches without a place, one after the other.
    """

    furniture: Object
    surface: Surface
    share: float = 1.0
    failed: int = 0

    def pose(self) -> Pose:
        """Return the pose of its middle in the world."""
        return self.furniture.surface_pose(self.surface)

    def outline(self) -> Polygon:
        """Return its outline in the world, seen from above, counterclockwise."""
        pose = self.pose()
        corners = [geometry.transform(pose, (x, y, 0.0))[:2] for x, y in self.surface.outline]
        return polygon.convex_hull(np.array(corners))


class SurfaceMaps:
    """Maps of surfaces for an object.

    Args:
        body: the object.
        near: that it shall be near, m; None for anywhere.
        away: that it shall be away from, m; None for nothing.
        side: of each surface or of the reference, as in :func:`pycram.reasoning.places.free_places`; None for any.
        reference: the object beside which it shall be; None for none.
        orientation: xyzw of the object there; None for any about the vertical.
        robot: that shall reach there; None for nobody.
        arms: its arms that may.
    """

    def __init__(
        self,
        body: Object,
        near: Vector | None,
        away: Vector | None,
        side: str | None,
        reference: Object | None,
        orientation: Quaternion | None,
        robot: Object | None,
        arms: Sequence[Arm],
    ) -> None:
        self._body, self._near, self._away = body, near, away
        self._turn = orientation or geometry.IDENTITY[1]
        self._side, self._reference = side, reference
        self._robot, self._arms = robot, arms
        self._corners = np.concatenate([corners for _, corners in pieces_of(body.model.path)])
        self._own = {body, *reaching.held(body)}

    def of(self, searched: SearchedSurface, done: Sequence[Vector]) -> tuple[Grid, list[tuple[str, Array]]]:
        """Return the cells of a surface, and a map (cells,) for each constraint, by its name.

        Args:
            searched: the surface.
            done: places that were offered or tried.
        """
        outline = searched.outline()
        (_, _, height), _ = searched.pose()
        corners = np.array(outline)
        stands = self.corners(self._turn)
        inner, outer = maps.radii(stands[:, :2])
        strip = polygon.narrowest(outline)[0] - 2 * (inner + EDGE)
        resolution = min(max(strip / _CELLS, _FINEST), _RESOLUTION)
        grid = Grid.over(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), height, resolution)
        centers = grid.centers()
        fits = float(np.ptp(stands[:, 2])) <= searched.surface.clearance
        factors = [
            ("clearance", np.full(len(centers), float(fits))),
            ("edge", self._within(centers, outline, inner, outer)),
            ("room", maps.clear(centers, self.obstacles(searched), inner, outer + FINGERS)),
        ]
        if self._near is not None:
            factors.append(("near", maps.near(centers, self._near, _NEAR, _FAR)))
        if self._away is not None:
            factors.append(("away-from", maps.away(centers, [self._away], _AWAY)))
        if self._side is not None:
            factors.append((f"side {self._side}", self._beside(centers, searched)))
        if self._robot is not None:
            factors.append(("reach", self._reach(grid)))
        factors.append(("tried", maps.away(centers, done, _APART)))
        return grid, factors

    def heading(self, searched: SearchedSurface) -> float:
        """Return a natural yaw of the object on a surface, rad: as it is now, or along what is hardly wider than it."""
        width, along = polygon.narrowest(searched.outline())
        _, outer = maps.radii(self.corners(self._turn)[:, :2])
        return along if width < 2 * (outer + EDGE) else yaw_of(self._body.get_orientation())

    def corners(self, turn: Quaternion) -> Array:
        """Return the object's corners (n, 3) from its origin when it is turned, m."""
        corners: Array = self._corners @ geometry.to_matrix(turn).T
        return corners

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

    def obstacles(self, searched: SearchedSurface) -> maps.Footprints:
        """Return what stands on a surface, or hangs above it as low as the object is high.

        So do robots that are bolted down; others drive away.
        """
        clone = clone_of(self._body.world, "reach")
        carried = reaching.held(self._robot) if self._robot else ()
        others = [each for each in self._body.world.objects if each not in self._own and each not in carried]
        (_, _, height), _ = searched.pose()
        size = float(np.ptp(self.corners(self._turn)[:, 2]))
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
