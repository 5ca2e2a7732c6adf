"""Intervals of shares, and of their differences."""

from __future__ import annotations

import math
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
