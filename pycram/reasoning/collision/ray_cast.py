"""Ray casts: where straight lines enter and leave an object's collision shapes.

A grasp needs the width of an object between the fingers; the object's bounds are larger than this width, because
bounds grow with rotations and include hollows. All lines are intersected with the model's convex pieces together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.models.shapes import solids_of
from recorder import geometry
from recorder.geometry import Array, Pose, Quaternion, Vector

if TYPE_CHECKING:
    from pycram.world.object import Object


_PADDING: Final = 1e-3  # thickness in m of the padding that the engine adds to convex hulls
_PARALLEL: Final = 1e-9  # a line with a smaller component along a plane's unit normal is parallel to the plane


def center(body: Object) -> Vector:
    """Return the center of an object's bounds in the world, m."""
    return _center(*body.get_AABB())


def _center(low: Sequence[float], high: Sequence[float]) -> Vector:
    (x0, y0, z0), (x1, y1, z1) = low, high
    return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2


def half_extent(low: Sequence[float], high: Sequence[float], direction: Sequence[float]) -> float:
    """Return half of the size of a box (lowest and highest corner) along a unit vector, m."""
    (x0, y0, z0), (x1, y1, z1), (x, y, z) = low, high, direction
    return (abs(x) * (x1 - x0) + abs(y) * (y1 - y0) + abs(z) * (z1 - z0)) / 2


@dataclass(frozen=True, slots=True)
class Scan:
    """Parallel lines at regular distances."""

    frame: Pose  # a frame in the world; the lines are parallel to one of its axes
    first: float  # coordinate of the first line along another axis, m
    step: float  # distance in m between lines


class RayCaster:
    """Casts rays at an object at its present pose; the caller holds the world's lock.

    With ``lean``, a rotation xyzw about the center of its bounds, the object is treated as upright.
    """

    def __init__(self, body: Object, lean: Quaternion | None = None) -> None:
        self.low, self.high = body.get_AABB()
        self.center = _center(self.low, self.high)  # center of the bounds in the world, m
        solids = solids_of(body.model.path)
        positions, orientations = body.world.engine.link_frames(body.handle, solids.links)
        turns = geometry.to_matrices(orientations)
        if lean is not None:
            upright = geometry.to_matrices(np.array([lean]))[0].T
            turns = upright @ turns
            positions = (positions - self.center) @ upright.T + self.center
            middles = np.einsum("kij,kj->ki", turns, (solids.low + solids.high) / 2) + positions
            halves = np.einsum("kij,kj->ki", np.abs(turns), (solids.high - solids.low) / 2) + _PADDING
            self.low, self.high = (middles - halves).min(axis=0).tolist(), (middles + halves).max(axis=0).tolist()
        self._centers = np.einsum("kij,kj->ki", turns, (solids.low + solids.high) / 2) + positions
        self._edges = turns * ((solids.high - solids.low) / 2 + 2 * _PADDING)[:, None]
        self._pieces = solids.pieces
        self._counts = np.bincount(solids.pieces)
        self._planes = np.empty((len(solids.pieces), 4))
        self._planes[:, :3] = normals = np.einsum("mij,mj->mi", turns[solids.pieces], solids.normals)
        self._planes[:, 3] = solids.offsets + (normals * positions[solids.pieces]).sum(axis=1) + _PADDING

    def extents(self, scans: Sequence[Scan], count: int | Sequence[int], zs: Sequence[float]) -> Array:
        """Return the extents of the object along the y axes of frames, over all z coordinates ``zs``, m.

        The lines of each scan are parallel to the y axis of its frame, at coordinates along the x axis. The result
        (len(scans), greatest count, 2) in m has the lowest and the highest y in the frame at each x; nan outside of the
        object. Rows beyond the count of their scan are undefined.
        """
        hits = self._intersect(scans, (0, 2, 1), count, zs)
        ends = hits.nearest(np.stack([hits.enter.min(axis=1), -hits.leave.max(axis=1)], axis=1))
        found = ends.transpose(0, 2, 1) * [1.0, -1.0]
        return np.where(found[:, :, :1] <= found[:, :, 1:], found, np.nan)

    def walls(self, scans: Sequence[Scan], count: int, ys: Sequence[float]) -> Array:
        """Return the walls of a hollow object along the x axes of frames, over all y coordinates ``ys``, m.

        The lines of each scan start in the hollow, parallel to the x axis of its frame, at coordinates along the z
        axis. The result (len(scans), count, 2) in m has x of the inner and of the outer surface of the wall at each z.
        The inner surface is nan if a line starts in a wall; both are nan without a wall.
        """
        hits = self._intersect(scans, (2, 1, 0), count, ys)
        first = hits.nearest(np.where(hits.enter > 0.0, hits.enter, np.inf))
        last = -hits.nearest(np.where(hits.leave > 0.0, -hits.leave, np.inf)).min(axis=1)
        inside = np.where(np.isfinite(first).all(axis=1), first.min(axis=1), np.nan)
        return np.stack([inside, np.where(np.isfinite(last), last, np.nan)], axis=2)

    def _intersect(
        self, scans: Sequence[Scan], order: tuple[int, int, int], count: int | Sequence[int], vs: Sequence[float]
    ) -> _Intersections:
        """Intersect parallel lines with all pieces of the object in one step, because each call of numpy takes time.

        ``order`` gives the indices of three axes of the frames: u and v across the lines, and w along them. Each scan
        has ``count`` lines along u; ``vs`` are the lines' coordinates along v in ascending order, m.
        """
        last = np.broadcast_to(count, len(scans)) - 1
        most = int(last.max(initial=0)) + 1
        numbers = np.array([(scan.first, scan.step, *scan.frame[0], *scan.frame[1]) for scan in scans])
        firsts, steps, origins = numbers[:, 0], numbers[:, 1], numbers[:, 2:5]
        frames = np.zeros((len(scans), 4, 4))
        frames[:, 3, 3] = 1.0
        frames[:, :3, :3] = axes = geometry.to_matrices(numbers[:, 5:])[:, :, order]
        frames[:, :3, 3] = -origins
        across = axes[:, :, :2]
        middle, half = np.empty((2, len(scans), 1, 2))  # middle and half extent of the lines along u and v
        half[:, 0, 0], half[:, 0, 1] = last / 2 * steps, (vs[-1] - vs[0]) / 2
        middle[:, 0, 0], middle[:, 0, 1] = firsts + half[:, 0, 0], (vs[-1] + vs[0]) / 2
        away = (self._centers - origins[:, None]) @ across - middle
        reach = np.abs(across.transpose(0, 2, 1)[:, None] @ self._edges).sum(axis=3)
        near = (np.abs(away) <= reach + np.abs(half)).all(axis=2)
        where, which = np.nonzero(near)
        # for each piece, the first and the last line along u that may meet the piece
        middles, spread = away[where, which, 0], reach[where, which, 0]
        paces = np.where(steps == 0.0, _PARALLEL, steps)[where]
        middles, spread = middles / paces + last[where] / 2, np.abs(spread / paces)
        begins = np.maximum(np.ceil(middles - spread), 0.0).astype(np.intp)
        width = int((np.minimum(np.floor(middles + spread), last[where]).astype(np.intp) - begins).max(initial=0)) + 1
        begins = np.minimum(begins, most - width)
        # intersect each plane of a piece with the lines of the scans near the piece
        planes = (self._planes @ frames).reshape(-1, 4).take(np.flatnonzero(near[:, self._pieces]), axis=0)
        number = np.repeat(np.arange(len(where)), self._counts[which])
        u, v, along, room = planes.T
        # a line parallel to a plane leaves the plane far ahead if the line is inside, and far behind if it is outside
        along = np.where(np.abs(along) < _PARALLEL, _PARALLEL, along)
        factors = np.empty((len(planes), 3))
        factors[:, 0] = room - u * (firsts[where] + begins * steps[where])[number]
        factors[:, 1] = u * -steps[where][number]
        factors[:, 2] = -v
        factors /= along[:, None]
        lines = np.empty((3, len(vs), width))
        lines[0], lines[1], lines[2] = 1.0, np.arange(width), np.reshape(vs, (-1, 1))
        found = []
        for side, nearest in ((along < 0.0, np.max), (along > 0.0, np.min)):  # each piece has planes on two sides
            mine = np.flatnonzero(side)
            counts = np.bincount(number[mine], minlength=len(where))
            each = np.arange(counts.max(initial=1))[:, None]
            rows = mine.take(np.cumsum(counts) - counts + np.minimum(each, counts - 1))
            meets = factors.take(rows.ravel(), axis=0) @ lines.reshape(3, -1)
            found.append(nearest(meets.reshape(len(each), len(where), len(vs), width), axis=0))
        hit = found[0] <= found[1]
        enter, leave = np.where(hit, found[0], np.inf), np.where(hit, found[1], -np.inf)
        return _Intersections(near.sum(axis=1), most, begins, enter, leave)


@dataclass(frozen=True, slots=True)
class _Intersections:
    """The intersections of scans with pieces; there are n pairs of a scan and a near piece."""

    pieces: NDArray[np.intp]  # (scans,) number of pieces near each scan; pairs are ordered by scan, then by piece
    count: int  # greatest number of lines in a scan
    begins: NDArray[np.intp]  # (n,) index of the first line that may meet the piece
    enter: Array  # (n, beside, width), m: where each line enters the piece; inf if it misses the piece
    leave: Array  # (n, beside, width), m: where each line leaves the piece; -inf if it misses the piece

    def nearest(self, values: Array) -> Array:
        """Return the lowest value (scans, beside, count) of pieces with values (n, beside, width); inf for none."""
        pieces, beside, width = values.shape
        cells = np.full((pieces, beside, self.count), np.inf)
        across = np.arange(pieces)[:, None, None], np.arange(beside)[:, None]
        cells[across[0], across[1], self.begins[:, None, None] + np.arange(width)] = values
        found = np.full((len(self.pieces), beside, self.count), np.inf)
        scanned = np.flatnonzero(self.pieces)
        if len(scanned):
            found[scanned] = np.minimum.reduceat(cells, (np.cumsum(self.pieces) - self.pieces)[scanned])
        return found
