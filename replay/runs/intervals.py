"""Intervals of shares, and how surprising a difference of two shares is."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

_Z: Final = 1.959963984540054  # of 95 %


def wilson(count: int, of: int, z: float = _Z) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927, "Probable inference"); 0 to 1 if there are none.

    Unlike the textbook's, it holds for few runs, and for shares near 0 and 1.
    """
    if of == 0:
        return 0.0, 1.0
    share, spread = count / of, z * z / of
    middle = (share + spread / 2) / (1 + spread)
    half = z / (1 + spread) * math.sqrt(share * (1 - share) / of + spread / (4 * of))
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return (0.0 if count == 0 else low), (1.0 if count == of else high)


def difference(a: int, of_a: int, b: int, of_b: int) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two shares (Newcombe 1998, method 10, from Wilson's intervals)."""
    first, second = (a / of_a if of_a else 0.0), (b / of_b if of_b else 0.0)
    (low_a, high_a), (low_b, high_b) = wilson(a, of_a), wilson(b, of_b)
    apart = first - second
    return apart - math.hypot(first - low_a, high_b - second), apart + math.hypot(high_a - first, second - low_b)


def fisher(a: int, of_a: int, b: int, of_b: int) -> float:
    """Return how likely it is by chance that one share is larger than the other by so much (Fisher's exact test)."""
    hits, all_of = a + b, of_a + of_b
    total = _log_choose(all_of, hits)
    terms = (
        _log_choose(of_a, k) + _log_choose(of_b, hits - k) - total
        for k in range(a, min(of_a, hits) + 1)
        if hits - k <= of_b
    )
    return min(1.0, math.fsum(math.exp(term) for term in terms))


@lru_cache(maxsize=100_000)
def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def holm(chances: list[float]) -> list[float]:
    """Return chances corrected for how many comparisons were made (Holm 1979), in the same order.

    That any of those below 0.05 is there by chance alone has a chance below 0.05, however they depend on each other.
    """
    corrected, largest = [1.0] * len(chances), 0.0
    for rank, at in enumerate(sorted(range(len(chances)), key=chances.__getitem__)):
        largest = max(largest, min(1.0, chances[at] * (len(chances) - rank)))
        corrected[at] = largest
    return corrected
