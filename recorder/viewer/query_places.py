"""The places that the last query for some considered: a coloured map on the floor, and what became of each sample.

Where a place may do, a cell is coloured: blue where hardly, green where well. What was taken is a green point with its
heading, what won't do a red one that says why, what nobody looked at a grey one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from recorder.records.grids import scores_of, spots_of
from recorder.records.places import NOT_TRIED, TAKEN, fates, fates_text
from recorder.viewer.colors import BLUE, GREEN, GREY, RED
from recorder.viewer.marks import Marks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from recorder.records import Query
    from recorder.viewer.columns import Columns, TimePoint
    from recorder.viewer.scene import Scene

PLACES: Final = "places"
_ABOVE: Final = 0.01  # m, of what would lie in the floor or on a surface
_POINT: Final = 0.025  # m
_TAKEN: Final = 0.05
_HEADING: Final = 0.15  # m, of the arrow of a place that was taken
_ALPHA: Final = 150
_MAX_LABELS: Final = 200
_COLORS: Final = {TAKEN: GREEN, NOT_TRIED: GREY}


class QueryPlaces:
    """The map and the samples of the last query for places, until the next one, or until a task begins that moves."""

    def __init__(self, columns: Columns, scene: Scene) -> None:
        self._marks = Marks(columns, scene)

    def clear(self, now: TimePoint) -> None:
        """Removes them."""
        self._marks.clear(now)

    def show(self, record: Query, now: TimePoint) -> None:
        """Shows a query for places.

        Raises:
            ValueError: The map is impossible.
        """
        if not record.HasField("grid"):
            return
        self._marks.clear(now)
        cells = _cells(record)
        if cells is not None:
            self._marks.add(record.world, (PLACES, record.name, "map"), now, cells)
        spots = spots_of(record.grid) + np.array([0.0, 0.0, _ABOVE])
        if len(spots):
            names = list(fates(record))
            labels = [fate.partition("|")[0] for fate in names] if len(names) <= _MAX_LABELS else None
            points = rr.Points3D(
                spots,
                colors=[_COLORS.get(name, RED) for name in names],
                radii=[_TAKEN if name == TAKEN else _POINT for name in names],
                labels=labels,
                show_labels=False,
            )
            self._marks.add(record.world, (PLACES, record.name, "samples"), now, points)
            self._marks.add(record.world, (PLACES, record.name, "taken"), now, *_taken(record, spots, names))


def _taken(record: Query, spots: NDArray[np.float64], names: list[str]) -> list[rr.AsComponents]:
    """Return where something was taken, and how it faces; above the map else what became of all."""
    text = fates_text(record)
    chosen = [number for number, name in enumerate(names) if name == TAKEN]
    if not chosen:
        return [rr.Points3D([spots.mean(axis=0)], colors=[RED], radii=[_POINT], labels=[text])]
    ways = [(math.cos(yaw), math.sin(yaw), 0.0) for yaw in (record.grid.spots[number].yaw for number in chosen)]
    vectors = np.array(ways) * _HEADING
    return [rr.Arrows3D(origins=spots[chosen], vectors=vectors, colors=[GREEN], radii=[_POINT / 2], labels=[text])]


def _cells(record: Query) -> rr.Mesh3D | None:
    """Return the cells where a place may do, as coloured squares; None if there are none."""
    grid = record.grid
    scores = scores_of(grid)
    rows, columns = np.nonzero(scores)
    if not len(rows):
        return None
    x, y, z = grid.origin
    corners = np.stack([columns, rows], axis=1)[:, None, :] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    points = np.empty((len(rows), 4, 3), np.float32)
    points[..., :2] = corners * grid.resolution + (x, y)
    points[..., 2] = z + _ABOVE / 2
    share = scores[rows, columns][:, None]
    colors = np.empty((len(rows), 4), np.uint8)
    colors[:, :3] = share * np.array(GREEN) + (1.0 - share) * np.array(BLUE)
    colors[:, 3] = _ALPHA
    first = 4 * np.arange(len(rows), dtype=np.uint32)[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]], np.uint32)).reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=points.reshape(-1, 3), triangle_indices=triangles, vertex_colors=np.repeat(colors, 4, axis=0)
    )
