"""The space that a path is searched in: a coordinate for each joint, or three for a base."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from pycram.foundation.failures import CollisionPair
    from pycram.reasoning.collision.checker import Candidate, CollisionChecker, Pair

    Array = NDArray[np.float64]

MARGIN: Final = 5e-3  # m that the robot keeps away from things
_DEEPER: Final = 1e-3  # m that a touch may get deeper than it is at the start or the goal
_SLACK: Final = 0.01  # m that hulls of the robot's own links may overlap more, if there is no other way
_BATCH: Final = 64  # configurations whose boxes are compared at once
_FIRST_BATCH: Final = 16  # of those that are spread over an edge: most edges that aren't free show it there


@dataclass(frozen=True, slots=True)
class Space:
    """Coordinates, unwrapped: also those of joints without limits, and the heading of a base, are plain numbers."""

    lower: Array  # (d,) lower limits
    upper: Array  # (d,) upper limits
    weights: Array  # (d,) of a coordinate in distances, such that a unit of each moves the robot about as far
    step: float  # distance of any coordinate between configurations that are checked while it is searched

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


class Clearance:
    """What would be touched in configurations: rows of numbers, as joint values or poses of a base.

    Args:
        predict: gives the checker's candidates for configurations (n, d).
        start: (d,) configuration in which the robot is.
        goal: (d,) configuration in which it is to be.
    """

    def __init__(
        self, checker: CollisionChecker, predict: Callable[[Array], list[Candidate]], start: Array, goal: Array
    ) -> None:
        self._checker = checker
        self._predict = predict
        self._allowed: dict[Pair, float] = {}  # m of overlap
        self._last: Pair | None = None
        self._deepest: dict[Pair, float] = {}
        # whether it keeps away from things; else it may be as near as it likes, and hulls of its own links may
        # overlap a little more: they do where the robot doesn't
        self.strict = True
        self.checks = 0  # how many configurations were checked
        # how often which two links were in the way, and how deep they overlapped at most, m
        self.blocking: Counter[Pair] = Counter()
        self._allow(start)
        # what would be touched at the goal that isn't touched as deep at the start, deepest first
        self.touched = self._allow(goal)

    def _allow(self, row: Array) -> list[CollisionPair]:
        """Allow what is near in a configuration (d,) to be as near in all; return what is touched but mustn't be."""
        touched = []
        ((candidate, pairs),) = self._candidates(row[None])
        for pair in pairs:
            depth = self._checker.depth(candidate, pair)
            if depth >= max(self._checker.least(pair), self._allowed.get(pair, 0.0)):
                touched.append(self._checker.named(pair, depth))
            if depth > self._allowed_depth(pair):
                self._allowed[pair] = depth + _DEEPER
        return sorted(touched, key=lambda pair: -pair.depth)

    def free(self, rows: Array) -> bool:
        """Return whether nothing is touched in configurations (n, d); those in the middle are looked at first."""
        if not len(rows):
            return True
        spread = rows[_spread(len(rows))]
        starts = (0, *range(_FIRST_BATCH, len(rows), _BATCH), len(rows))
        return not any(True for part in pairwise(starts) for _ in self._touched(spread[slice(*part)]))

    def first_touch(self, rows: Array) -> CollisionPair | None:
        """Return what is touched in the first of configurations (n, d) in which something is; None if nothing is."""
        for begin in range(0, len(rows), _BATCH):
            for pair, depth in self._touched(rows[begin : begin + _BATCH]):
                return self._checker.named(pair, max(depth, 0.0))
        return None

    def worst(self, count: int) -> list[CollisionPair]:
        """Return what was in the way most often, and how deep at most."""
        return [
            self._checker.named(pair, max(self._deepest[pair], 0.0)) for pair, _ in self.blocking.most_common(count)
        ]

    def _touched(self, rows: Array) -> Iterable[tuple[Pair, float]]:
        """Yield for each configuration (n, d) in which something is touched the first pair found, and its depth.

        The depth is in m, and negative where the pair is too near, but apart.
        """
        for candidate, pairs in self._candidates(rows):
            if self._last in pairs:  # what was in the way mostly is so again
                pairs.insert(0, self._last)
            for pair in pairs:
                depth = self._checker.depth(candidate, pair)
                if depth > self._allowed_depth(pair):
                    self._last = pair
                    self.blocking[pair] += 1
                    self._deepest[pair] = max(depth, self._deepest.get(pair, 0.0))
                    yield pair, depth
                    break

    def _candidates(self, rows: Array) -> list[tuple[Candidate, list[Pair]]]:
        """Return candidates for configurations (n, d), and what could touch in each."""
        self.checks += len(rows)
        candidates = self._predict(rows)
        owns = self._checker.self_pairs(candidates)
        return [(each, [*self._checker.pairs(each), *own]) for each, own in zip(candidates, owns, strict=True)]

    def _allowed_depth(self, pair: Pair) -> float:
        """Return the overlap in m up to which two links aren't in the way."""
        usual = self._checker.least(pair)
        if pair[0] is pair[2]:
            usual += 0.0 if self.strict else _SLACK
        elif self.strict and pair[2] is not self._checker.robot:
            usual = -MARGIN
        return max(usual, self._allowed.get(pair, usual))


def _spread(count: int) -> Sequence[int]:
    """Return 0 to count - 1 in an order that is spread over all of them from the first on: by reversed bits."""
    bits = max(1, (count - 1).bit_length())
    return sorted(range(count), key=lambda number: int(f"{number:0{bits}b}"[::-1], 2))
