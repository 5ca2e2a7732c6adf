"""Maps: scores of all cells of a grid for one constraint each, 0 to 1. They are rough, and multiplied."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from pycram.reasoning.collision.boxes import Boxes

    Array = NDArray[np.float64]

_UPRIGHT: Final = 0.999  # of a unit axis along the vertical
_LYING: Final = np.array([(1, 2), (0, 2), (0, 1)])  # the other axes of a box, by the one that is vertical
_DIRECTIONS: Final = 36
_BEHIND: Final = 1e-4  # of its score that a place keeps with something between: where all have that, none is better
_AT_ONCE: Final = 1 << 15  # pairs of a rectangle and a point
_SURE: Final = 0.85  # of the radius of a circle within an outline: boxes are a little wider than what they are around


def scattered(scores: Array, cells: NDArray[np.intp], count: int) -> Array:
    """Return a map (count,) with the scores of some cells, and 0 elsewhere."""
    whole = np.zeros(count)
    whole[cells] = scores
    return whole


def near(centers: Array, point: Sequence[float], scale: float, most: float = math.inf) -> Array:
    """Return 1 at a point, falling with the distance: half at ``scale`` m, 0 farther away than ``most`` m."""
    distance = np.hypot(*(centers - np.asarray(point[:2])).T)
    return np.where(distance <= most, 1.0 / (1.0 + (distance / scale) ** 2), 0.0)


def away(centers: Array, points: Sequence[Sequence[float]], distance: float) -> Array:
    """Return 0 within a distance in m of some points, else 1."""
    score = np.ones(len(centers))
    for point in points:
        score[np.hypot(*(centers - np.asarray(point[:2])).T) < distance] = 0.0
    return score


class Footprints:
    """Boxes seen from above, as rectangles.

    Args:
        boxes: the boxes.
        low: m above the ground; boxes that end below don't count.
        high: m above the ground; boxes that begin above don't count.

    Attributes:
        centers: (k, 2), m.
        axes: (k, 2, 2) their unit axes are the columns.
        halves: (k, 2) half extents, m.
    """

    def __init__(self, boxes: Boxes, low: float, high: float) -> None:
        extents = (np.abs(boxes.axes) * boxes.half_extents[:, None, :]).sum(axis=2)
        z = boxes.centers[:, 2]
        counted = (z + extents[:, 2] > low) & (z - extents[:, 2] < high)
        axes, halves = boxes.axes[counted], boxes.half_extents[counted]
        self.centers = boxes.centers[counted, :2]
        self.axes = np.repeat(np.eye(2)[None], len(axes), axis=0)
        self.halves = extents[counted, :2]
        standing = np.abs(axes[:, 2]) > _UPRIGHT  # (k, 3): which of its axes is vertical
        upright = np.flatnonzero(standing.any(axis=1))
        flat = _LYING[standing[upright].argmax(axis=1)]
        self.axes[upright] = np.take_along_axis(axes[upright, :2], flat[:, None], axis=2)
        self.halves[upright] = np.take_along_axis(halves[upright], flat, axis=1)

    def distances(self, points: Array, most: float) -> Array:
        """Return how far points (n, 2) are from the nearest rectangle, m: 0 inside of one, ``most`` and more alike."""
        nearest = np.full(len(points), most * most)
        around = np.hypot(*self.halves.T)[:, None] + most
        for along, halves in self._along(points, self._beside(points, around)):
            beyond = np.maximum(np.abs(along) - halves, 0.0)
            np.square(beyond, out=beyond)
            np.minimum(nearest, beyond.sum(axis=1).min(axis=0), out=nearest)
        distances: Array = np.sqrt(nearest)
        return distances

    def between(self, points: Array, target: Sequence[float]) -> NDArray[np.bool_]:
        """Return for points (n, 2) whether a rectangle meets the straight line to a target that isn't in it."""
        end = np.asarray(target[:2])
        hidden = np.zeros(len(points), dtype=bool)
        ends = np.vstack([points, end])
        beside = self._beside(ends, (np.abs(self.axes) * self.halves[:, None]).sum(axis=2))
        for along, halves in self._along(ends, beside):
            first, last = along[..., :-1], along[..., -1:]
            way = last - first
            way[way == 0.0] = 1e-12
            one, other = (-halves - first) / way, (halves - first) / way  # shares of the way, by slabs
            enter, leave = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
            met = np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)
            hidden |= (met & (np.abs(last) > halves).any(axis=1)).any(axis=0)
        return hidden

    def _beside(self, points: Array, around: Array) -> NDArray[np.bool_]:
        """Return which rectangles (k,) come as near as (k, 1) or (k, 2) m to the bounds of points (n, 2)."""
        low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
        counted: NDArray[np.bool_] = ((self.centers >= low - around) & (self.centers <= high + around)).all(axis=1)
        return counted

    def _along(self, points: Array, counted: NDArray[np.bool_]) -> Iterator[tuple[Array, Array]]:
        """Yield where points (n, 2) are in the frames of rectangles, (m, 2, n) m, with half extents (m, 2, 1).

        It yields as many rectangles at once as a processor's cache holds.
        """
        centers, axes, halves = (part[counted] for part in (self.centers, self.axes, self.halves))
        some = max(1, _AT_ONCE // max(1, len(points)))
        for start in range(0, len(centers), some):
            part = slice(start, start + some)
            back = axes[part].transpose(0, 2, 1)
            middles = back @ centers[part, :, None]  # (m, 2, 1)
            yield back @ points.T - middles, halves[part, :, None]

    def corners(self) -> Array:
        """Return the corners (4 * k, 2) of the rectangles, m."""
        signs = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)], dtype=np.float64)
        corners: Array = self.centers[:, None] + np.einsum(
            "kij,skj->ksi", self.axes, signs[:, None] * self.halves[None]
        ).reshape(len(self.centers), 4, 2)
        return corners.reshape(-1, 2)


def radii(outline: Array) -> tuple[float, float]:
    """Return radii of circles about the origin: within the hull of points (n, 2), and around it, m."""
    angles = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    reach = outline @ np.array([np.cos(angles), np.sin(angles)])
    inner = float(reach.max(axis=0, initial=0.0).min())
    return max(inner, 0.0), float(np.hypot(*outline.T).max(initial=0.0))


def straight(centers: Array, target: Sequence[float], obstacles: Footprints) -> Array:
    """Return little where something is between a place and a target, as a wall or the side of a cupboard, else 1."""
    return np.where(obstacles.between(centers, target), _BEHIND, 1.0)


def clear(centers: Array, obstacles: Footprints, inner: float, outer: float) -> Array:
    """Return 0 where something is within a robot's outline whatever its heading, 1 where nothing is near.

    Args:
        centers: (cells, 2), m.
        obstacles: what stands around.
        inner: radius of a circle within the outline, m.
        outer: radius of a circle around it, m.
    """
    distance = obstacles.distances(centers, outer)
    sure = _SURE * inner
    score: Array = np.clip((distance - sure) / max(outer - sure, 1e-6), 0.0, 1.0)
    return np.where(distance < sure, 0.0, 0.5 + 0.5 * score)
