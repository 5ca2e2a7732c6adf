"""Maps of places on record, read with care: they may be a stranger's."""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from recorder.records.log_pb2 import Grid

MAX_CELLS: Final = 1 << 20
"""Of a map; those of recorders have some thousands."""
_FARTHEST: Final = 1e6  # m


def scores_of(grid: Grid) -> NDArray[np.float64]:
    """Return the scores (height, width) of a map's cells, 0 to 1, rows along x from the lowest y.

    Raises:
        ValueError: The map is impossible: too many cells for its bytes, a size that isn't positive, an origin that is
            nowhere.
    """
    width, height = grid.width, grid.height
    if width <= 0 or height <= 0 or width * height > MAX_CELLS:
        raise ValueError(f"a map of {width} x {height} cells")
    origin = list(grid.origin)
    if len(origin) != 3 or not all(math.isfinite(part) and abs(part) <= _FARTHEST for part in origin):
        raise ValueError(f"a map at {origin}")
    if not 0.0 < grid.resolution <= _FARTHEST:
        raise ValueError(f"a map with cells of {grid.resolution} m")
    try:
        content = zlib.decompressobj().decompress(grid.scores, width * height)
    except zlib.error as error:
        raise ValueError(f"a map that can't be inflated: {error}") from error
    if len(content) != width * height:
        raise ValueError(f"a map of {width} x {height} cells with {len(content)} scores")
    scores: NDArray[np.float64] = np.frombuffer(content, dtype=np.uint8).reshape(height, width) / 255.0
    return scores


def spots_of(grid: Grid) -> NDArray[np.float64]:
    """Return the positions (n, 3) of the places that were drawn from a map, m.

    Raises:
        ValueError: One is nowhere.
    """
    positions = [list(spot.position) for spot in grid.spots]
    for position in positions:
        if len(position) != 3 or not all(math.isfinite(part) and abs(part) <= _FARTHEST for part in position):
            raise ValueError(f"a place at {position}")
    return np.array(positions, dtype=np.float64).reshape(-1, 3)
