"""Grids: scores of all places of a rectangle, from which some are drawn."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.scheduling.schedule import run_seed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from recorder.geometry import Vector

    Array = NDArray[np.float64]

RESOLUTION: Final = 0.05  # m
_MAX_CELLS: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells of a horizontal rectangle in the world.

    Attributes:
        origin: corner with the lowest x and y, m.
        resolution: from cell to cell, m.
        shape: cells along y, cells along x.
    """

    origin: Vector
    resolution: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, low: Sequence[float], high: Sequence[float], height: float, resolution: float = RESOLUTION) -> Grid:
        """Return a grid over a rectangle, coarser than asked where that would be too many cells.

        Args:
            low: its lowest x and y, m.
            high: its highest x and y, m.
            height: z of it, m.
            resolution: from cell to cell, m.
        """
        width, depth = (max(high[axis] - low[axis], resolution) for axis in (0, 1))
        resolution = max(resolution, (width * depth / _MAX_CELLS) ** 0.5)
        shape = int(np.ceil(depth / resolution)), int(np.ceil(width / resolution))
        return cls((float(low[0]), float(low[1]), float(height)), resolution, shape)

    def centers(self) -> Array:
        """Return the middles (cells, 2) of the cells in the world, rows along x one after the other, m."""
        rows, columns = np.indices(self.shape).reshape(2, -1).astype(np.float64)
        x, y, _ = self.origin
        half = self.resolution / 2
        return np.column_stack([columns * self.resolution + (x + half), rows * self.resolution + (y + half)])


def generator(seed: int | None, name: str, *about: object) -> np.random.Generator:
    """Return random numbers that depend on the run's seed and on what is asked, not on what was drawn before.

    Args:
        seed: instead of the run's.
        name: of the query.
        about: what tells it from others.
    """
    text = f"{name} {run_seed() if seed is None else seed} {about}"
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big"))


def spread(grid: Grid, scores: Array, count: int, random: np.random.Generator) -> list[tuple[int, tuple[float, float]]]:
    """Return some cells, drawn without putting back with a probability by their scores, the best of them first.

    Args:
        grid: the cells.
        scores: (cells,) 0 and more.
        count: how many, at most.
        random: decides.

    Returns:
        Their numbers, each with x and y of a point in the cell, m.
    """
    possible = np.flatnonzero(scores > 0.0)
    # the largest of log scores with Gumbel noise are such a sample (Yellott 1977; Efraimidis, Spirakis 2006)
    keys = np.log(scores[possible]) + random.gumbel(size=len(possible))
    taken = possible[np.argsort(-keys, kind="stable")[:count]]
    taken = taken[np.argsort(-scores[taken], kind="stable")]
    points = grid.centers()[taken] + random.uniform(-0.5, 0.5, (len(taken), 2)) * grid.resolution
    return list(zip(taken.tolist(), map(tuple, points.round(4).tolist()), strict=True))
