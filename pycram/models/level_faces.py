"""Level faces of a model on which objects can stand, with the free height above each face.

A grid divides the top of each link. The grid's lines are the edges of convex pieces, so the result is exact for boxes.
A cell is free if it belongs to the top and has enough free height. A face keeps its shape if nearly all of its cells
are free; else rectangles replace the face. The engine uses the convex hull of each piece, so objects stand on hulls.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from pycram.models.shapes import convex_hulls, distinct, pieces_of
from recorder import geometry
from recorder.geometry import Array, Flags, Indices, Pose


class Least(NamedTuple):
    """Minimum sizes of a face on which an object can stand."""

    area: float  # m^2
    side: float  # m


AREA: Final = 0.02  # minimum area in m^2 of a face of furniture
FURNITURE: Final = Least(AREA, 0.06)  # width of a glass
THINGS: Final = Least(0.0016, 0.04)  # sizes for a plate, a box, or another object that robots carry
_CLEARANCES: Final = (0.25, 0.05)  # free heights in m, first for most of a face, then also for the area below a lamp
_LEVEL: Final = math.cos(math.radians(2.5))  # minimum z of the normal of a level face
_THICK: Final = 0.004  # maximum difference in m between the heights of tops that form one face of a link
_ROUGH: Final = 0.002  # maximum height in m of a bump that isn't an obstacle on a face
_GAP: Final = 0.001  # minimum distance in m of grid lines
_FINE: Final = 0.02  # distance in m of grid lines if edges aren't parallel to the grid
_ALONG: Final = 1e-3  # maximum component of a side's unit normal along a grid axis that is parallel to the side
_WHOLE: Final = 0.97  # minimum free share of a face that keeps its shape
_PARALLEL: Final = 1e-9  # maximum component along a plane's unit normal of a line that is parallel to the plane
_SIMPLE: Final = 16  # maximum number of planes of a simple piece; only near lines intersect other pieces
_ROUNDING: Final = 1e-9  # maximum relative rounding error of an area
_COLUMNS: Final = 8  # number of columns that BLAS multiplies in one call
_SAME_PLANE: Final = 6  # decimal places in which planes of triangles on one side of a hull agree


@dataclass(frozen=True, slots=True)
class Face:
    """A level face, in the frame of the root link."""

    link: str
    middle: Array  # (3,), m
    yaw: float  # orientation of the outline's frame about z, rad
    outline: Array  # (n, 2) corners relative to the middle, counter-clockwise, m
    clearance: float  # free height in m; infinite if the face is open above

    @property
    def area(self) -> float:
        """Area of the face in m^2."""
        return _area(self.outline)


def faces(every: Sequence[Piece], least: Least | None = None) -> Iterator[Face]:
    """Yield the faces of a model's pieces, for each link from low to high; ``least`` is FURNITURE by default."""
    bounds = np.array([(piece.low, piece.high) for piece in every]).reshape(-1, 2, 3)
    by_link: dict[str, list[Piece]] = {}
    for piece in every:
        by_link.setdefault(piece.link, []).append(piece)
    for parts in by_link.values():
        for tops in _levels(parts):
            yield from _faces_of(tops, every, bounds, least or FURNITURE)


def _levels(parts: Sequence[Piece]) -> list[list[Piece]]:
    """Return the pieces of a link that have a level top, grouped by height, from low to high."""
    levels: list[list[Piece]] = []
    height = -math.inf
    level = [piece for piece in parts if piece.planes[:, 2].max() >= _LEVEL and (piece.high - piece.low)[:2].min() > 0]
    for piece in sorted(level, key=lambda piece: float(piece.high[2])):
        if piece.high[2] - height > _THICK:
            levels.append([])
            height = float(piece.high[2])
        levels[-1].append(piece)
    return levels


def _faces_of(tops: Sequence[Piece], every: Sequence[Piece], bounds: Array, least: Least) -> Iterator[Face]:
    """Yield the faces that ``tops`` of one height form; ``bounds`` (k, 2, 3) has corners of boxes around all pieces."""
    height = max(float(piece.high[2]) for piece in tops)
    yaw = _yaw(max(tops, key=lambda piece: float(np.prod((piece.high - piece.low)[:2]))))
    cosine, sine = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cosine, -sine], [sine, cosine]])  # ``corners @ turn`` are the corners in the frame of the face
    edges = np.concatenate([piece.corners[piece.corners[:, 2] > height - 2 * _THICK, :2] for piece in tops])
    corners = edges @ turn
    width, depth = np.ptp(corners, axis=0)
    if min(width, depth) < least.side or width * depth * (1.0 + _ROUNDING) < least.area:
        return
    hull = corners[[np.abs(corners - corner).sum(axis=1).argmin() for corner in geometry.convex_hull(corners)]]
    if _area(hull) < least.area:
        return
    around = (bounds[:, 0, :2] < edges.max(axis=0)) & (bounds[:, 1, :2] > edges.min(axis=0))
    above = list(itertools.compress(every, around.all(axis=1) & (bounds[:, 1, 2] > height + _ROUGH)))
    rows, columns = _lines([*tops, *above], turn, hull)
    middles = np.stack(np.meshgrid(*((line[1:] + line[:-1]) / 2 for line in (rows, columns)), indexing="ij"), axis=-1)
    standing, clearance = _free(tops, above, height, middles @ turn.T)
    cells = np.outer(np.diff(rows), np.diff(columns))
    for height_above in _CLEARANCES:
        free = standing & (clearance >= height_above)
        outlines = [(hull, free)]
        if cells[free].sum() < _WHOLE * _area(hull):
            outlines = list(_rectangles(free, rows, columns, least))
        for outline, within in outlines:
            standing = standing & ~within
            center = (outline.min(axis=0) + outline.max(axis=0)) / 2
            if _area(outline) >= least.area:
                middle = np.array([*(center @ turn.T), height])
                yield Face(tops[0].link, middle, yaw, outline - center, float(clearance[within].min()))


def _free(tops: Sequence[Piece], above: Sequence[Piece], height: float, points: Array) -> tuple[Flags, Array]:
    """Return whether each of the points (n, m, 2) is on the top, and the free height above each point in m."""
    flat, shape = points.reshape(-1, 2), points.shape[:2]
    standing: Flags = np.any(vertical_extents(tops, flat)[1] >= height - _THICK, axis=1)
    if not above:
        return standing.reshape(shape), np.full(shape, np.inf)
    into, out = vertical_extents(above, flat)
    clearance: Array = np.min(np.where(out > height + _ROUGH, np.maximum(into - height, 0.0), np.inf), axis=1)
    return standing.reshape(shape), clearance.reshape(shape)


def _rectangles(free: Flags, rows: Array, columns: Array, least: Least) -> Iterator[tuple[Array, Flags]]:
    for top, left, bottom, right in divide(free, rows, columns, least.side, least.area):
        within = np.zeros_like(free)
        within[top:bottom, left:right] = True
        (a, b), (c, d) = rows[[top, bottom]], columns[[left, right]]
        yield np.array([[a, c], [b, c], [b, d], [a, d]]), within


def _yaw(piece: Piece) -> float:
    """Return the direction of a grid along the sides of a piece: -pi/4 to pi/4 rad."""
    x, y = piece.planes[np.abs(piece.planes[:, 2]) < _ALONG, :2].T
    if not len(x):
        return 0.0
    turned = (np.arctan2(y, x) + math.pi / 4) % (math.pi / 2) - math.pi / 4
    nearest = turned[np.abs(turned).argmin()]
    return float(nearest) if abs(nearest) > _ALONG else 0.0


def _lines(parts: Sequence[Piece], turn: Array, hull: Array) -> list[Array]:
    """Return the coordinates of the grid lines over a hull, for both axes, m."""
    corners = np.concatenate([piece.corners for piece in parts])[:, :2] @ turn
    normals = np.abs(np.concatenate([piece.planes for piece in parts])[:, :2] @ turn)
    fine = bool(((normals > _ALONG) & (normals < 1 - _ALONG)).any())
    bounds = zip(hull.min(axis=0).tolist(), hull.max(axis=0).tolist(), strict=True)
    return [_between(own, *ends, fine=fine) for own, ends in zip(corners.T, bounds, strict=True)]


def _between(edges: Array, low: float, high: float, *, fine: bool) -> Array:
    """Return the coordinates of the grid lines along an axis from ``low`` to ``high``, m."""
    at = _apart(np.array([low, high, *edges[(edges >= low) & (edges <= high)]]))
    at[-1] = high
    if not fine:
        return at
    regular = np.linspace(low, high, max(int((high - low) / _FINE), 1) + 1)
    return regular if len(at) >= len(regular) else _apart(np.concatenate([at, regular]))


def _apart(values: Array) -> Array:
    """Sort values, and drop values within ``_GAP`` of their predecessor."""
    ordered = distinct(values)
    kept: Array = ordered[np.concatenate([[True], np.diff(ordered) > _GAP])]
    return kept


def _area(outline: Array) -> float:
    x, y = outline.T
    return float(abs(x[:-1] @ y[1:] - y[:-1] @ x[1:] + x[-1] * y[0] - y[-1] * x[0]) / 2)


class Rectangle(NamedTuple):
    """Indices of cells of a grid; ``bottom`` and ``right`` are exclusive."""

    top: int
    left: int
    bottom: int
    right: int


def divide(free: Flags, rows: Array, columns: Array, side: float, area: float) -> Iterator[Rectangle]:
    """Yield disjoint rectangles of free cells: each is the largest rectangle of the remaining cells.

    The flags ``free`` (n, m) are between grid lines, rows (n + 1,) and columns (m + 1,), ascending, m. ``side`` in m
    and ``area`` in m^2 are the minimum sizes.
    """
    left = free.copy()
    while (found := _largest(left, rows, columns, side)) is not None and found[0] >= area:
        cells = found[1]
        yield cells
        left[cells.top : cells.bottom, cells.left : cells.right] = False


def _largest(free: Flags, rows: Array, columns: Array, side: float) -> tuple[float, Rectangle] | None:
    """Return the largest rectangle of free cells and its area, from a histogram of each row."""
    best: tuple[float, Rectangle] | None = None
    starts = np.zeros(free.shape[1], dtype=np.intp)  # for each column, the first row of free cells above ``row``
    for row, cells in enumerate(free):
        starts = np.where(cells, starts, row + 1)
        below = float(rows[row + 1])
        pending: list[tuple[int, int]] = []  # columns with their first free rows, ascending
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


@dataclass(frozen=True, slots=True)
class Piece:
    """A convex piece of a link, in the frame of the root link."""

    link: str
    corners: Array  # (n, 3), m
    planes: Array  # (k, 4) outward unit normals, and offsets in m: inside, ``normal @ point + offset <= 0``
    low: Array  # lowest corner of the bounding box, m
    high: Array  # highest corner of the bounding box, m


def vertical_extents(every: Sequence[Piece], points: Array) -> tuple[Array, Array]:
    """Return the heights (n, m) where vertical lines through points (n, 2) enter and leave m pieces; see _through()."""
    return _through(every, np.column_stack([points, np.zeros(len(points))]), np.array([[0.0, 0.0, 1.0]]))


def first_met(every: Sequence[Piece], origins: Array, directions: Array) -> tuple[Indices, Array]:
    """Return the index of the first piece that each ray (n, 3) hits, and the distance in m; infinite without a hit."""
    into, out = _through(every, origins, directions)
    met = np.where((into <= out) & (out > 0), np.maximum(into, 0.0), np.inf)
    return met.argmin(axis=1), met.min(axis=1)


def _through(every: Sequence[Piece], origins: Array, directions: Array) -> tuple[Array, Array]:
    """Return the distances (n, m) at which lines enter and leave m pieces; infinity and -infinity for a missed piece.

    The origins (n, 3) are points on the lines, m; the directions are unit vectors (n, 3) or (1, 3).
    """
    into = np.full((len(origins), len(every)), np.inf)
    out = -into
    simple = [number for number, piece in enumerate(every) if len(piece.planes) <= _SIMPLE]
    if simple:
        into[:, simple], out[:, simple] = _between_planes([every[number] for number in simple], origins, directions)
    for number, piece in enumerate(every):
        if len(piece.planes) > _SIMPLE and len(lines := _near(piece, origins, directions)):
            along = directions if len(directions) == 1 else directions[lines]
            ends = _between_planes([piece], origins[lines], along)
            into[lines, number], out[lines, number] = ends[0][:, 0], ends[1][:, 0]
    return into, out


def _near(piece: Piece, origins: Array, directions: Array) -> Indices:
    """Return the indices of the lines that pass through a piece's bounding box, widened by ``_GAP``."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.stack([piece.low - _GAP, piece.high + _GAP])[:, None] - origins) / directions
    low, high = np.sort(ends, axis=0)  # (n, 3); infinite if a line is parallel to a side
    found = np.flatnonzero(low.max(axis=1) <= high.min(axis=1))
    return np.resize(found, 2) if len(found) == 1 else found  # repeated, as BLAS rounds a single row differently


def _between_planes(every: Sequence[Piece], origins: Array, directions: Array) -> tuple[Array, Array]:
    """Return the distances that :func:`_through` describes, from all planes of all pieces."""
    starts = np.cumsum([0, *(len(piece.planes) for piece in every[:-1])])
    planes = np.concatenate([piece.planes for piece in every])
    planes = np.concatenate([planes, planes[[-1] * (-len(planes) % _COLUMNS)]])  # BLAS rounds odd columns differently
    slopes = np.broadcast_to(directions @ planes[:, :3].T, (len(origins), len(planes)))
    heights = origins @ planes[:, :3].T + planes[:, 3]
    along = np.abs(slopes) < _PARALLEL
    with np.errstate(divide="ignore", invalid="ignore"):
        at = -heights / slopes
    into = np.maximum.reduceat(np.where(along | (slopes > 0), -np.inf, at), starts, axis=1)
    out = np.minimum.reduceat(np.where(along | (slopes < 0), np.inf, at), starts, axis=1)
    missed = np.logical_or.reduceat(along & (heights > 0), starts, axis=1) | (into > out)
    return np.where(missed, np.inf, into), np.where(missed, -np.inf, out)


def pieces(path: Path, poses: Mapping[str, Pose]) -> Sequence[Piece]:
    """Return the convex pieces of a canonical URDF for poses of its links in the root link."""
    links, every = [], []
    for link, corners in pieces_of(path):
        position, orientation = poses[link]
        links.append(link)
        every.append(corners @ geometry.to_matrix(orientation).T + position)
    found = []
    for link, placed, hull in zip(links, every, convex_hulls(every), strict=True):
        if hull is None:  # objects don't stand safely on a flat piece
            continue
        planes = np.array(sorted(set(map(tuple, hull.planes.round(_SAME_PLANE).tolist()))))
        low, high = placed.min(axis=0), placed.max(axis=0)
        found.append(Piece(link, hull.corners, planes, low, high))
    return found
