"""Convex polygons of the plane: hulls, intersections, distances. Plain numbers: they have few corners."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray

Point: TypeAlias = "tuple[float, float]"
Polygon: TypeAlias = "Sequence[Point]"
"""Corners, counterclockwise; fewer than three where there is no area."""

_DECIMALS: Final = 6  # to which points are the same


def convex_hull(points: NDArray[np.float64]) -> Polygon:
    """Return the convex hull of points (n, 2) (monotone chain)."""
    ordered = sorted(set(map(tuple, points.round(_DECIMALS).tolist())))

    def half(sequence: Iterable[Point]) -> list[Point]:
        chain: list[Point] = []
        for point in sequence:
            while len(chain) > 1 and _side(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return half(ordered) + half(reversed(ordered)) if len(ordered) > 2 else ordered


def intersection(polygon: Polygon, other: Polygon) -> Polygon:
    """Return the intersection of two convex polygons (Sutherland and Hodgman)."""
    kept = list(polygon)
    for a, b in itertools.pairwise([*other, other[0]]):
        corners, kept = kept, []
        for now, after in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            left, follows = _side(a, b, now), _side(a, b, after)
            if left >= 0:
                kept.append(now)
            if left * follows < 0:
                share = left / (left - follows)
                kept.append((now[0] + (after[0] - now[0]) * share, now[1] + (after[1] - now[1]) * share))
    return kept


def margin(polygon: Polygon, point: Sequence[float]) -> float:
    """Return how far a point lies within a convex polygon, m; less than 0 outside, minus infinity without area."""
    if len(polygon) < 3:
        return -math.inf
    x, y = point
    sides = itertools.pairwise([*polygon, polygon[0]])
    return min(_side(a, b, (x, y)) / max(math.dist(a, b), 1e-9) for a, b in sides)


def narrowest(polygon: Polygon) -> tuple[float, float]:
    """Return the width of a convex polygon where that is least, m, and the direction of the side along it, rad."""
    sides = itertools.pairwise([*polygon, polygon[0]])
    return min(
        (max(_side(a, b, corner) for corner in polygon) / math.dist(a, b), math.atan2(b[1] - a[1], b[0] - a[0]))
        for a, b in sides
    )


def _side(a: Point, b: Point, point: Point) -> float:
    """Return a number above 0 if a point lies left of the line from a to b."""
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])
