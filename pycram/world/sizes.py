"""Warnings about shapes: a mesh that is too large is probably in another unit; a hollow URDF mesh is filled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pycram.models.shapes import piece_bounds

WIDEST: Final = 10.0  # width in m of a free object's mesh above which its unit is probably wrong
_NAMED: Final = 5  # maximum number of links that a warning names


class Oversized(UserWarning):
    """The mesh of a free object is wider than 10 m, so its file is probably in another unit than metres."""


class Filled(UserWarning):
    """A URDF has a hollow collision mesh in one piece. The engine takes the convex hull of it, so nothing gets in."""


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


def warning_of_filled(body: str, links: Sequence[str]) -> str:
    """Return the message of the warning that hollow collision meshes are filled."""
    names = ", ".join(links[:_NAMED]) + (f" and {len(links) - _NAMED} more" if len(links) > _NAMED else "")
    return (
        f"{body}: the collision mesh of {names} is hollow and in one piece, so the engine takes its solid convex hull; "
        "write its convex parts as an OBJ with a group for each, or as several <collision> elements"
    )
