"""Sizes of objects: the file of an object that is too large for a hand is probably in another unit than metres."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.models.shapes import piece_bounds

if TYPE_CHECKING:
    from pathlib import Path

WIDEST: Final = 10.0
"""Width in m above which the mesh of a free object is probably in another unit."""


class Oversized(UserWarning):
    """The mesh of a free object is wider than 10 m, so its file is probably in another unit than metres."""


def width(model: Path) -> float:
    """Return the largest extent of a link of a checked URDF, in m."""
    lows: dict[str, list[float]] = {}
    highs: dict[str, list[float]] = {}
    for link, (low, high) in piece_bounds(model):
        lows[link] = [*map(min, low, lows.get(link, low))]
        highs[link] = [*map(max, high, highs.get(link, high))]
    return max(
        (top - bottom for link in lows for bottom, top in zip(lows[link], highs[link], strict=True)), default=0.0
    )


def warning(body: str, wide: float) -> str:
    """Return the message of the warning that an object is oversized."""
    return f"{body} is {wide:.3g} m wide: is its file in millimetres? Object(..., scale=0.001)"
