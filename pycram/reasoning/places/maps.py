"""Maps over a grid: a map has a rough score from 0 to 1 of each cell for one constraint. Places are drawn from maps."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pycram.models.robots.description import Arm
from pycram.reasoning.collision.boxes import Boxes
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.kinematics.forward import Chain
from pycram.scheduling.schedule import run_seed
from pycram.world.attachment import held
from pycram.world.object import Object
from recorder import geometry
from recorder.geometry import Array, Flags, Indices, Vector
from recorder.urdf import Urdf

_UPRIGHT: Final = 0.999  # minimum vertical component of a unit axis of an upright box
_LYING: Final = np.array([(1, 2), (0, 2), (0, 1)])  # the two horizontal axes of a box, for each vertical axis
_DIRECTIONS: Final = 36
_BEHIND: Final = 1e-4  # score of a cell behind an obstacle; it isn't 0, because all cells may be behind obstacles
_AT_ONCE: Final = 1 << 15  # number of pairs of a rectangle and a point that fit into the processor's cache together
_SURE: Final = 0.85  # boxes are wider than links: only this share of the inner circle's radius is surely in an outline
RESOLUTION: Final = 0.05  # distance in m between cells
_MAX_CELLS: Final = 1 << 16
_FLOOR: Final = 0.03  # height in m above the ground; the base drives over lower obstacles
_LAYERS: Final = (0.35, 0.7, 1.0, 1.4)  # heights in m that divide a robot into layers with an outline each
_POSTURES: Final = 60_000
_PARTS: Final = 30  # number of parts into which postures are divided, so that each part fits into the processor's cache
_LEVEL: Final = math.sin(math.radians(30))  # maximum vertical component of the tool's axis of a level hand
_DOWN: Final = -math.cos(math.radians(30))  # maximum vertical component of the tool's axis of a hand that points down
_CELL: Final = 0.08  # size in m of a cell in distance and height
_SECTORS: Final = 24  # number of sectors of the bearing in a full turn
_FULL: Final = 0.9  # quantile of the counts from which a cell has the full score


def scattered(scores: Array, cells: Indices, count: int) -> Array:
    """Return a map (count,) that has the scores at some cells and 0 elsewhere."""
    whole = np.zeros(count)
    whole[cells] = scores
    return whole


def near(centers: Array, point: Sequence[float], scale: float, most: float = math.inf) -> Array:
    """Return scores that are 1 at a point, 0.5 at a distance of ``scale`` m, and 0 beyond ``most`` m."""
    distance = np.hypot(*(centers - np.asarray(point[:2])).T)
    return np.where(distance <= most, 1.0 / (1.0 + (distance / scale) ** 2), 0.0)


def away(centers: Array, points: Sequence[Sequence[float]], distance: float) -> Array:
    """Return 0 within a distance in m of any point, and 1 elsewhere."""
    score = np.ones(len(centers))
    for point in points:
        score[np.hypot(*(centers - np.asarray(point[:2])).T) < distance] = 0.0
    return score


class Footprints:
    """Boxes as rectangles, seen from above; boxes below ``low`` or above ``high`` (m above the ground) are left out."""

    def __init__(self, boxes: Boxes, low: float, high: float) -> None:
        extents = (np.abs(boxes.axes) * boxes.half_extents[:, None, :]).sum(axis=2)
        z = boxes.centers[:, 2]
        counted = (z + extents[:, 2] > low) & (z - extents[:, 2] < high)
        axes, halves = boxes.axes[counted], boxes.half_extents[counted]
        self.centers = boxes.centers[counted, :2]  # (k, 2), m
        self.axes = np.repeat(np.eye(2)[None], len(axes), axis=0)  # (k, 2, 2) unit axes as columns
        self.halves = extents[counted, :2]  # (k, 2) half extents, m
        standing = np.abs(axes[:, 2]) > _UPRIGHT  # (k, 3) whether each axis of a box is vertical
        upright = np.flatnonzero(standing.any(axis=1))
        flat = _LYING[standing[upright].argmax(axis=1)]
        self.axes[upright] = np.take_along_axis(axes[upright, :2], flat[:, None], axis=2)
        self.halves[upright] = np.take_along_axis(halves[upright], flat, axis=1)

    def distances(self, points: Array, most: float) -> Array:
        """Return the distances (n,) in m from points (n, 2) to the nearest rectangle, from 0 inside to ``most``."""
        nearest = np.full(len(points), most * most)
        for along, halves in self._along(points, self._beside(points, np.hypot(*self.halves.T)[:, None] + most)):
            beyond = np.maximum(np.abs(along) - halves, 0.0)
            np.square(beyond, out=beyond)
            np.minimum(nearest, beyond.sum(axis=1).min(axis=0), out=nearest)
        distances: Array = np.sqrt(nearest)
        return distances

    def between(self, points: Array, target: Sequence[float]) -> Flags:
        """Return whether the lines from points (n, 2) to a target meet a rectangle that isn't around the target."""
        hidden = np.zeros(len(points), dtype=bool)
        ends = np.vstack([points, np.asarray(target[:2])])
        beside = self._beside(ends, (np.abs(self.axes) * self.halves[:, None]).sum(axis=2))
        for along, halves in self._along(ends, beside):
            first, last = along[..., :-1], along[..., -1:]
            way = last - first
            way[way == 0.0] = 1e-12
            # fractions of a line's length at which the line crosses the sides of the rectangle
            one, other = (-halves - first) / way, (halves - first) / way
            enter, leave = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
            met = np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)
            hidden |= (met & (np.abs(last) > halves).any(axis=1)).any(axis=0)
        return hidden

    def _beside(self, points: Array, around: Array) -> Flags:
        """Return whether rectangles (k,) are within (k, 1) or (k, 2) m of the bounds of points (n, 2)."""
        low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
        counted: Flags = ((self.centers >= low - around) & (self.centers <= high + around)).all(axis=1)
        return counted

    def _along(self, points: Array, counted: Flags) -> Iterator[tuple[Array, Array]]:
        """Yield points (n, 2) in the frames of the counted rectangles, (k, 2, n) in m, and half extents (k, 2, 1).

        The rectangles come in parts that fit into the processor's cache.
        """
        centers, axes, halves = (part[counted] for part in (self.centers, self.axes, self.halves))
        some = max(1, _AT_ONCE // max(1, len(points)))
        for start in range(0, len(centers), some):
            part = slice(start, start + some)
            back = axes[part].transpose(0, 2, 1)
            middles = back @ centers[part, :, None]  # (m, 2, 1)
            yield back @ points.T - middles, halves[part, :, None]

    def corners(self) -> Array:
        """Return the corners (4 * k, 2) of the rectangles in m."""
        signs = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)], dtype=np.float64)
        corners: Array = self.centers[:, None] + np.einsum(
            "kij,skj->ksi", self.axes, signs[:, None] * self.halves[None]
        ).reshape(len(self.centers), 4, 2)
        return corners.reshape(-1, 2)


def radii(outline: Array) -> tuple[float, float]:
    """Return the radii in m of the widest circle about the origin in the hull of points (n, 2), and around the hull."""
    angles = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    reach = outline @ np.array([np.cos(angles), np.sin(angles)])
    return max(float(reach.max(axis=0, initial=0.0).min()), 0.0), float(np.hypot(*outline.T).max(initial=0.0))


def straight(centers: Array, target: Sequence[float], obstacles: Footprints) -> Array:
    """Return 1 for places with a free straight line to a target, and almost 0 behind obstacles such as walls."""
    return np.where(obstacles.between(centers, target), _BEHIND, 1.0)


def clear(centers: Array, obstacles: Footprints, inner: float, outer: float) -> Array:
    """Return scores: 0 where a circle in an outline touches an obstacle, 1 where a circle around the outline is free.

    ``inner`` and ``outer`` are the radii of these circles in m.
    """
    distance = obstacles.distances(centers, outer)
    sure = _SURE * inner
    score: Array = np.clip((distance - sure) / max(outer - sure, 1e-6), 0.0, 1.0)
    return np.where(distance < sure, 0.0, 0.5 + 0.5 * score)


@dataclass(frozen=True, slots=True)
class Grid:
    """A grid of cells over a horizontal rectangle in the world."""

    origin: Vector  # corner with the lowest x and y, m
    resolution: float  # distance in m between cells
    shape: tuple[int, int]  # number of cells along y and along x

    @classmethod
    def over(cls, low: Sequence[float], high: Sequence[float], height: float, resolution: float = RESOLUTION) -> Grid:
        """Return a grid over a rectangle with lowest and highest x and y, and a height, in m.

        The cells are larger than ``resolution`` if there would be too many.
        """
        width, depth = (max(high[axis] - low[axis], resolution) for axis in (0, 1))
        resolution = max(resolution, (width * depth / _MAX_CELLS) ** 0.5)
        shape = int(np.ceil(depth / resolution)), int(np.ceil(width / resolution))
        return cls((float(low[0]), float(low[1]), float(height)), resolution, shape)

    def centers(self) -> Array:
        """Return the centers (cells, 2) of the cells in the world in m; cells of a row along x come together."""
        rows, columns = np.indices(self.shape).reshape(2, -1).astype(np.float64)
        x, y, _ = self.origin
        half = self.resolution / 2
        return np.column_stack([columns * self.resolution + (x + half), rows * self.resolution + (y + half)])


def random_generator(seed: int | None, name: str, *about: object) -> np.random.Generator:
    """Return a generator that depends only on the seed (None: the run's seed), the name and the other arguments."""
    text = f"{name} {run_seed() if seed is None else seed} {about}"
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big"))


def draw_cells(
    grid: Grid, scores: Array, count: int, random: np.random.Generator
) -> list[tuple[int, tuple[float, float]]]:
    """Draw cells without replacement, with probabilities proportional to their scores (cells,), which aren't negative.

    The result has the index of each drawn cell, and x and y in m of a random point in the cell; high scores come first.
    """
    possible = np.flatnonzero(scores > 0.0)
    # the greatest log scores with Gumbel noise are such a sample (Yellott 1977; Efraimidis, Spirakis 2006)
    taken = possible[np.argsort(-(np.log(scores[possible]) + random.gumbel(size=len(possible))), kind="stable")[:count]]
    taken = taken[np.argsort(-scores[taken], kind="stable")]
    points = grid.centers()[taken] + random.uniform(-0.5, 0.5, (len(taken), 2)) * grid.resolution
    return list(zip(taken.tolist(), map(tuple, points.round(4).tolist()), strict=True))


def surroundings(robot: Object, *without: Object) -> Boxes:
    """Return boxes around all objects except a robot, its held objects, and the objects in ``without``."""
    own = {robot, *held(robot), *without}
    return clone_of(robot.world, "reach").all_boxes(body for body in robot.world.objects if body not in own)[0]


def room(robot: Object, centers: Array) -> Array:
    """Return scores of the room for a robot's base at ``centers`` (cells, 2), m.

    A score is 0 where the robot would touch something in any heading, and 1 where nothing is near. Held objects don't
    count. The caller has synced the clone.
    """
    clone = clone_of(robot.world, "reach")
    others = surroundings(robot)
    position, turn = robot.get_position_and_orientation()
    yaw, ground = geometry.to_rpy(turn)[2], position[2]
    back = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    score = np.ones(len(centers))
    for low, high in itertools.pairwise((_FLOOR, *_LAYERS)):
        outline = Footprints(clone.boxes(robot), ground + low, ground + high).corners()
        inner, outer = radii((outline - np.asarray(position[:2])) @ back)
        left = np.flatnonzero(score)
        score[left] *= clear(centers[left], Footprints(others, ground + low, ground + high), inner, outer)
    return score


class ArmReach:
    """Scores of how well an arm reaches positions around the robot while its hand is level or points down.

    The scores come from counts of random postures (Zacharias, Borst, Hirzinger: Capturing robot workspace structure,
    IROS 2007). The scores are rough; only inverse kinematics decides whether an arm reaches a position.
    """

    def __init__(self, urdf: Urdf, arm: Arm) -> None:
        chain = Chain(urdf, arm.base_link, arm.tool_frame, arm.joints, tool=arm.tool_offset)
        random = np.random.default_rng(0)
        postures = chain.lower + random.random((_POSTURES, len(arm.joints))) * (chain.upper - chain.lower)
        base_T_root = geometry.pose_matrix(urdf.forward_kinematics({}, arm.base_link))
        tools = np.concatenate([chain.poses(some) for some in np.array_split(postures, _PARTS)])
        points = tools[:, :3, 3] @ base_T_root[:3, :3].T
        across = (base_T_root[:3, :3] @ tools[:, :3, :3])[:, 2, 0]
        points = points[(np.abs(across) < _LEVEL) | (across < _DOWN)]
        flat = points[:, :2] + base_T_root[:2, 3]
        distance = np.hypot(*flat.T)
        self.radius = float(distance.max(initial=0.0))  # largest reached distance from the robot's axis, m
        self._low = float(points[:, 2].min(initial=0.0))
        shape = (int((points[:, 2].max(initial=0.0) - self._low) / _CELL) + 1, int(self.radius / _CELL) + 1, _SECTORS)
        counts = np.zeros(shape)
        np.add.at(counts, self._cells(points[:, 2], distance, np.arctan2(flat[:, 1], flat[:, 0]), shape), 1.0)
        for axis, wrap in ((0, False), (1, False), (2, True)):  # a cell has few postures, so its neighbours count, too
            before, after = (np.roll(counts, step, axis=axis) for step in (1, -1))
            if not wrap:
                first: list[slice | int] = [slice(None)] * counts.ndim
                last = list(first)
                first[axis], last[axis] = 0, -1
                before[tuple(first)], after[tuple(last)] = 0.0, 0.0
            counts = (before + 2 * counts + after) / 4
        counts /= np.maximum(np.arange(shape[1]) + 0.5, 0.5)[None, :, None]  # distant cells have larger volumes
        full = np.quantile(counts[counts > 0.0], _FULL) if counts.any() else 1.0
        self._scores = np.sqrt(np.minimum(counts / full, 1.0))

    def _cells(
        self, height: Array, distance: Array, bearing: Array, shape: tuple[int, ...]
    ) -> tuple[Indices, Indices, Indices]:
        z = ((height - self._low) / _CELL).astype(np.intp).clip(0, shape[0] - 1)
        rho = (distance / _CELL).astype(np.intp).clip(0, shape[1] - 1)
        return z, rho, np.round(bearing / (2 * math.pi / _SECTORS)).astype(np.intp) % _SECTORS

    def scores(self, height: float, distance: Array, bearing: Array) -> Array:
        """Return scores of how well the hand reaches points at a height above the arm's base link, m.

        ``distance`` (...) is the distance of the points from the robot's axis, m; ``bearing`` (...) is their direction
        from the robot's heading, counterclockwise, rad.
        """
        every = np.full(distance.shape, height)
        found: Array = self._scores[self._cells(every, distance, bearing, self._scores.shape)]
        outside = (distance > self.radius) | (every < self._low) | (every > self._low + len(self._scores) * _CELL)
        return np.where(outside, 0.0, found)

    def best(self, height: float, distance: Array) -> Array:
        """Return the scores of points (...) for the best heading of the robot; see :meth:`scores`."""
        z = int((height - self._low) / _CELL)
        if not 0 <= z < len(self._scores):
            return np.zeros(distance.shape)
        by_distance = np.append(self._scores[z].max(axis=1), 0.0)
        found: Array = by_distance[(distance / _CELL).astype(np.intp).clip(0, len(by_distance) - 1)]
        return found


_known: dict[tuple[Path, str, str], ArmReach] = {}  # reaches of arms by model, text of the description, and arm


def arm_reach(robot: Object, arm: Arm) -> ArmReach:
    """Return the reach of a robot's arm, which is computed once for each model and description."""
    key = (robot.model.path, robot.description.text if robot.description else "", arm.name)
    if key not in _known:
        _known[key] = ArmReach(robot.urdf, arm)
    return _known[key]
