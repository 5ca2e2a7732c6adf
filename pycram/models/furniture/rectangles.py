"""Rectangles in a grid whose lines are unevenly spaced: a surface with holes is divided into them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


class Rectangle(NamedTuple):
    """Cells of a grid: rows and columns from the first up to, but without, the last."""

    top: int
    left: int
    bottom: int
    right: int


def divide(
    free: NDArray[np.bool_], rows: NDArray[np.float64], columns: NDArray[np.float64], side: float, area: float
) -> Iterator[Rectangle]:
    """Yield rectangles of free cells that don't overlap: the largest, then the largest in what it leaves, and so on.

    Args:
        free: (n, m) cells.
        rows: (n + 1,) lines between rows, m, ascending.
        columns: (m + 1,) lines between columns, m, ascending.
        side: the least length of a side, m.
        area: the least area, m^2.
    """
    left = free.copy()
    while (found := _largest(left, rows, columns, side)) is not None and found[0] >= area:
        cells = found[1]
        yield cells
        left[cells.top : cells.bottom, cells.left : cells.right] = False


def _largest(
    free: NDArray[np.bool_], rows: NDArray[np.float64], columns: NDArray[np.float64], side: float
) -> tuple[float, Rectangle] | None:
    """Return the largest rectangle of free cells and its area: that of a histogram, row by row."""
    best: tuple[float, Rectangle] | None = None
    starts = np.zeros(free.shape[1], dtype=np.intp)  # the row at which each column's free cells begin
    for row, cells in enumerate(free):
        starts = np.where(cells, starts, row + 1)
        below = float(rows[row + 1])
        pending: list[tuple[int, int]] = []  # columns from which free cells reach up to a row, ever lower ones
        for column, start in enumerate([*starts.tolist(), row + 1]):
            first = column
            while pending and pending[-1][1] < start:
                first, top = pending.pop()
                height, width = below - float(rows[top]), float(columns[column] - columns[first])
                if min(height, width) >= side and (best is None or height * width > best[0]):
                    best = height * width, Rectangle(top, first, row + 1, column)
            if not pending or pending[-1][1] > start:
                pending.append((first, start))
    return best
