"""Configuration spaces: the coordinates of a path, and its free configurations."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.foundation.failures import CollisionPair

if TYPE_CHECKING:
    from pycram.reasoning.collision.checker import CollisionChecker, Pair, PostureCandidate

    Array = NDArray[np.float64]

MARGIN: Final = 5e-3  # least distance in m between the robot and other objects
_DEEPER: Final = 1e-3  # depth in m by which an overlap may exceed the overlap at the start or goal
_SLACK: Final = 0.01  # additional allowed overlap in m of hulls of the robot's own links, if there is no other path
_BATCH: Final = 64  # number of configurations that are checked together
_FEW: Final = 4  # number of configurations of a batch that are checked first
_FIRST_BATCH: Final = 16  # number of configurations on an edge that are checked first; they find most blocked edges


@dataclass(frozen=True, slots=True)
class Space:
    """Coordinates of joints or of a base; an angle without limits is a plain number, too."""

    lower: Array  # (d,) lower limits
    upper: Array  # (d,) upper limits
    weights: Array  # (d,) weights in distances; equal weighted changes of coordinates move the robot about equally far
    step: float  # weighted change of any coordinate between checked configurations in a search

    def along(self, path: Array, step: float) -> Array:
        """Return configurations (n, d) along a path (m, d), without the first configuration; see :func:`between`."""
        parts: Sequence[Array] = [between(a, b, step / self.weights) for a, b in pairwise(path)]
        return np.concatenate(parts)

    def distance(self, a: Array, b: Array) -> Array:
        """Return weighted Euclidean distances (n,) between rows (n, d) and other rows (n, d), or one row (d,)."""
        distances: Array = np.linalg.norm((a - b) * self.weights, axis=-1)
        return distances


def between(a: Array, b: Array, step: float | Array) -> Array:
    """Return configurations (n, d) from a to b, without a; no coordinate changes by more than ``step`` at a time."""
    count = max(1, math.ceil(float((np.abs(b - a) / step).max(initial=0.0))))
    rows: Array = a + (b - a) * (np.arange(1, count + 1)[:, None] / count)
    rows[-1] = b
    return rows


def nearest_turns(start: Array, goal: Array, lower: Array, upper: Array) -> Array:
    """Return the goal (d,) with the equivalent angles that are within the limits and nearest to the start."""
    turned: Array = start + (goal - start + np.pi) % (2 * np.pi) - np.pi
    return np.where((np.abs(goal - start) > np.pi) & (lower <= turned) & (turned <= upper), turned, goal)


@cache
def _spread(count: int) -> list[int]:
    """Return the numbers below a count in the order of their reversed bits, which covers them coarsely first."""
    bits = max(1, (count - 1).bit_length())
    return sorted(range(count), key=lambda number: int(f"{number:0{bits}b}"[::-1], 2))


class Clearance:
    """Checks whether configurations are free of collisions, and counts these checks.

    A configuration is a row of joint positions, or a pose of a base; ``predict`` returns the checker's candidates for
    configurations (n, d). The robot keeps a distance from objects. If the robot is nearer to an object at the ``start``
    or at the ``goal`` (d,), this smaller distance is allowed on the whole path.
    """

    def __init__(
        self, checker: CollisionChecker, predict: Callable[[Array], list[PostureCandidate]], start: Array, goal: Array
    ) -> None:
        self._checker = checker
        self._predict = predict
        self._allowed: dict[Pair, float] = {}  # allowed overlap in m of each pair
        self._last: Pair | None = None
        self._deepest: dict[Pair, float] = {}
        # Whether the robot keeps a distance from objects. If not, the robot may nearly touch objects, and hulls of its
        # own links may overlap a little more, because hulls are larger than links.
        self.strict = True
        self.checks = 0  # number of checked configurations
        self.blocking: Counter[Pair] = Counter()  # number of times that each pair of links was in the way
        self._allow(start)
        self.touched = self._allow(goal)  # pairs that overlap more at the goal than at the start, deepest first

    def _allow(self, row: Array) -> list[CollisionPair]:
        """Allow each pair of links its distance in a configuration (d,). Return the forbidden contacts there."""
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
        """Return whether configurations (n, d) are free; rows that are far from each other are checked first."""
        if not len(rows):
            return True
        spread = rows[_spread(len(rows))]
        starts = (0, *range(_FIRST_BATCH, len(rows), _BATCH), len(rows))
        return not any(self._touches(spread[slice(*part)]) for part in pairwise(starts))

    def last_free(self, start: Array, rows: Array) -> Array:
        """Return the configuration (d,) before the first of (n, d) that isn't free."""
        for row in rows:
            if not self.free(row[None]):
                break
            start = row
        return start

    def first_touch(self, rows: Array) -> CollisionPair | None:
        """Return the touching pair of the first configuration of (n, d) that isn't free; None if all are free."""
        for begin in range(0, len(rows), _BATCH):
            for candidate, pairs in self._candidates(rows[begin : begin + _BATCH]):
                for pair, depth in self._touched(candidate, pairs):
                    return self._checker.named(pair, max(depth, 0.0))
        return None

    def worst(self, count: int) -> list[CollisionPair]:
        """Return the pairs that were in the way most often, with their deepest overlaps."""
        return [
            self._checker.named(pair, max(self._deepest[pair], 0.0)) for pair, _ in self.blocking.most_common(count)
        ]

    def _touches(self, rows: Array) -> bool:
        """Return whether a configuration of (n, d) isn't free. Own links come last: most edges end at objects."""
        self.checks += len(rows)
        candidates: list[PostureCandidate] = []
        for part in (rows[:_FEW], rows[_FEW:]):
            predicted = self._predict(part) if len(part) else []
            found = [(each, self._checker.pairs(each)) for each in predicted]
            found.sort(key=lambda each: self._last not in each[1])
            if any(True for each in found for _ in self._touched(*each)):
                return True
            candidates += predicted
        return any(
            True
            for each, own in zip(candidates, self._checker.self_pairs(candidates), strict=True)
            for _ in self._touched(each, own)
        )

    def _touched(self, candidate: PostureCandidate, pairs: Sequence[Pair]) -> Iterator[tuple[Pair, float]]:
        """Yield the first of some pairs that collides in a configuration, and its depth in m.

        The depth is negative for a pair that is too near, but doesn't touch.
        """
        for pair in sorted(pairs, key=lambda each: each != self._last):  # the last colliding pair often collides again
            depth = self._checker.depth(candidate, pair)
            if depth > self._allowed_depth(pair):
                self._last = pair
                self.blocking[pair] += 1
                self._deepest[pair] = max(depth, self._deepest.get(pair, 0.0))
                yield pair, depth
                return

    def _candidates(self, rows: Array) -> list[tuple[PostureCandidate, list[Pair]]]:
        """Return candidates for configurations (n, d), each with the pairs that may touch."""
        self.checks += len(rows)
        candidates = self._predict(rows)
        owns = self._checker.self_pairs(candidates)
        return [(each, [*self._checker.pairs(each), *own]) for each, own in zip(candidates, owns, strict=True)]

    def _allowed_depth(self, pair: Pair) -> float:
        """Return the overlap in m that is allowed for a pair; negative for a necessary distance."""
        usual = self._checker.least(pair)
        if pair[0] is pair[2]:
            usual += 0.0 if self.strict else _SLACK
        elif pair[2] is not self._checker.robot and (self.strict or not pair[2].fixed):
            usual = -MARGIN if self.strict else 0.0  # the robot would drag a loose object along
        return max(usual, self._allowed.get(pair, usual))
