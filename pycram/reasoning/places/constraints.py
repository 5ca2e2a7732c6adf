"""Which constraints excluded how many places: constraints may exclude each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pycram.foundation.failures import NoPlace

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pycram.reasoning.places.batch import Batch, Spot
    from pycram.reasoning.rejections import Rejection

    Array = NDArray[np.float64]


class ConstraintCounts:
    """Counts of the places that each constraint excluded.

    Args:
        wanted: for what a place is wanted, in words.
    """

    def __init__(self, wanted: str) -> None:
        self._wanted = wanted
        self._counts: dict[str, int] = {}
        self._last = ""

    def product(self, maps: Iterable[tuple[str, Array]]) -> tuple[Array, float]:
        """Return the product (cells,) of maps by their constraints, the best cell 1, and how good that one is.

        All cells are 0 if none is left.
        """
        scores = np.ones(1)
        for constraint, score in maps:
            left = scores.any()
            scores = scores * score
            if left and not scores.any() and not self._counts:
                self._counts[constraint], self._last = len(scores), constraint
        best = float(scores.max())
        return scores / (best or 1.0), best

    def exclude(self, batch: Batch, spot: Spot, constraint: str, reason: Rejection) -> None:
        """Say that a constraint excludes a place, and why."""
        batch.reject(spot.name, reason)
        self._counts[constraint] = self._counts.get(constraint, 0) + 1
        self._last = constraint

    def failure(self) -> NoPlace:
        """Return the failure that says so."""
        return NoPlace(self._wanted, self._counts, self._last)
