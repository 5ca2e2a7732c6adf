"""Which configurations of a robot are free of collisions: many at once, and each counted against a budget.

What the robot touches already is no obstacle, as a counter that its wheels stand beside or an object between its
fingers; but it must not get deeper there, nor touch anything else.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from pycram.foundation.collision_pair import CollisionPair
    from pycram.reasoning.collision.checker import Candidate, CollisionChecker, Pair

    Array = NDArray[np.float64]

_DEEPER: Final = 1e-3  # m that a touch may get deeper than it is at the start
_BATCH: Final = 64  # configurations whose boxes are compared at once


class Clearance:
    """What would be touched in configurations: rows of numbers, as joint values or poses of a base.

    Args:
        checker: of the robot.
        predict: gives the checker's candidates for configurations (n, d).
        start: (d,) configuration in which the robot is.

    Attributes:
        checks: how many configurations were checked.
        blocking: how often which two links were in the way, and how deep they overlapped at most, m.
    """

    def __init__(self, checker: CollisionChecker, predict: Callable[[Array], list[Candidate]], start: Array) -> None:
        self._checker = checker
        self._predict = predict
        self._allowed: dict[Pair, float] = {}
        self._last: Pair | None = None
        self.checks = 0
        self.blocking: Counter[Pair] = Counter()
        self._deepest: dict[Pair, float] = {}
        (candidate,) = predict(start[None])
        (own,) = checker.self_pairs([candidate])
        for pair in (*checker.pairs(candidate), *own):
            depth = checker.depth(candidate, pair)
            if depth:
                self._allowed[pair] = max(depth + _DEEPER, checker.least(pair))

    def free(self, rows: Array) -> bool:
        """Return whether nothing is touched in configurations (n, d); those in the middle are looked at first."""
        for begin in range(0, len(rows), _BATCH):
            part = rows[begin : begin + _BATCH]
            if any(True for _ in self._touched(part[_spread(len(part))])):
                return False
        return True

    def first_touch(self, rows: Array) -> tuple[int, CollisionPair] | None:
        """Return the number of the first configuration (n, d) in which something is touched, and what; None if none."""
        for begin in range(0, len(rows), _BATCH):
            for number, pair, depth in self._touched(rows[begin : begin + _BATCH]):
                return begin + number, self._checker.named(pair, depth)
        return None

    def touches(self, row: Array) -> list[CollisionPair]:
        """Return all that is touched in a configuration (d,), deepest first."""
        (candidate,), (own,) = self._candidates(row[None])
        depths = {pair: self._checker.depth(candidate, pair) for pair in (*self._checker.pairs(candidate), *own)}
        touched = {pair: depth for pair, depth in depths.items() if depth >= self._least(pair)}
        return [self._checker.named(pair, depth) for pair, depth in sorted(touched.items(), key=lambda item: -item[1])]

    def worst(self, count: int) -> list[CollisionPair]:
        """Return what was in the way most often, and how deep at most."""
        return [self._checker.named(pair, self._deepest[pair]) for pair, _ in self.blocking.most_common(count)]

    def _touched(self, rows: Array) -> Iterable[tuple[int, Pair, float]]:
        """Yield configurations (n, d) in which something is touched, the first pair that was found, and how deep."""
        for number, (candidate, own) in enumerate(zip(*self._candidates(rows), strict=True)):
            pairs: Sequence[Pair] = (*self._checker.pairs(candidate), *own)
            if self._last is not None and self._last in pairs:  # what was in the way mostly is so again
                pairs = (self._last, *pairs)
            for pair in pairs:
                depth = self._checker.depth(candidate, pair)
                if depth >= self._least(pair):
                    self._last = pair
                    self.blocking[pair] += 1
                    self._deepest[pair] = max(depth, self._deepest.get(pair, 0.0))
                    yield number, pair, depth
                    break

    def _candidates(self, rows: Array) -> tuple[list[Candidate], list[list[Pair]]]:
        self.checks += len(rows)
        candidates = self._predict(rows)
        return candidates, self._checker.self_pairs(candidates)

    def _least(self, pair: Pair) -> float:
        """Return the overlap in m from which on two links are in the way."""
        return self._allowed.get(pair) or self._checker.least(pair)


def _spread(count: int) -> Sequence[int]:
    """Return 0 to count - 1 in an order that is spread over all of them from the first on: by reversed bits."""
    bits = max(1, (count - 1).bit_length())
    return sorted(range(count), key=lambda number: int(f"{number:0{bits}b}"[::-1], 2))
