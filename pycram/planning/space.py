"""The space that a path is searched in: a coordinate for each joint, or three for a base."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Space:
    """Coordinates, unwrapped: also those of joints without limits, and the heading of a base, are plain numbers.

    Attributes:
        lower: (d,) lower limits.
        upper: (d,) upper limits.
        weights: (d,) of a coordinate in distances, such that a unit of each moves the robot about as far.
        step: distance of any coordinate between configurations that are checked while it is searched.
    """

    lower: Array
    upper: Array
    weights: Array
    step: float

    def along(self, path: Array, step: float) -> Array:
        """Return configurations (n, d) along a path (m, d), without its first; see :func:`between`."""
        parts: Sequence[Array] = [between(a, b, step / self.weights) for a, b in pairwise(path)]
        return np.concatenate(parts)

    def distance(self, a: Array, b: Array) -> Array:
        """Return the Euclidean distances (n,) of weighted coordinates between rows (n, d) and rows or one (d,)."""
        distances: Array = np.linalg.norm((a - b) * self.weights, axis=-1)
        return distances


def between(a: Array, b: Array, step: float | Array) -> Array:
    """Return configurations (n, d) from a to b, without a, with at most a step in any coordinate."""
    count = max(1, math.ceil(float((np.abs(b - a) / step).max(initial=0.0))))
    rows: Array = a + (b - a) * (np.arange(1, count + 1)[:, None] / count)
    rows[-1] = b
    return rows


def nearest_turns(start: Array, goal: Array, lower: Array, upper: Array) -> Array:
    """Return the goal (d,) by the equivalent turns of its angles that are nearest to the start, within limits."""
    turned: Array = start + (goal - start + np.pi) % (2 * np.pi) - np.pi
    other = (np.abs(goal - start) > np.pi) & (lower <= turned) & (turned <= upper)
    return np.where(other, turned, goal)
