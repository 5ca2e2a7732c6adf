"""An object's outline: where straight lines meet its surface.

A gripper has to know how wide an object is where the fingers go, which neither its bounds nor its origin tell: bounds
grow when it turns, and a hollow one has walls. The surface is that of the shapes that touch, as the model says; no
engine is asked, hence nothing can be stale and nothing is put anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.solids import solids_of
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pycram.objects import Object
    from recorder.geometry import Pose, Vector

    Array = NDArray[np.float64]

_PADDED: Final = 1e-3  # m by which the engine makes hulls thicker to all sides
_ALONG: Final = 1e-9  # of a plane's unit normal along a line: less never meets it


def middle(body: Object) -> Vector:
    """The middle of an object's bounds in the world, m.

    Args:
        body: the object.
    """
    (x0, y0, z0), (x1, y1, z1) = body.get_AABB()
    return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2


def half(low: Sequence[float], high: Sequence[float], direction: Sequence[float]) -> float:
    """Half of the size of a box along a direction, m.

    Args:
        low: its lowest corner.
        high: its highest corner.
        direction: a unit vector.
    """
    return sum(abs(d) * (b - a) for d, a, b in zip(direction, low, high, strict=True)) / 2


@dataclass(frozen=True, slots=True)
class Scan:
    """Where lines are drawn, side by side.

    Attributes:
        frame: in the world; lines go along one of its axes.
        first: of the places along another of its axes where there is a line, m.
        step: from one place to the next, m.
    """

    frame: Pose
    first: float
    step: float


class Outline:
    """The surface of one object, as it stands.

    Attributes:
        low: lowest corner of its bounds in the world, m.
        high: highest corner of its bounds in the world, m.
        middle: the middle of its bounds in the world, m.
    """

    def __init__(self, body: Object) -> None:
        """Looks where its faces are.

        Args:
            body: the object; its world's lock is held.
        """
        low, high = body.get_AABB()
        self.low: Vector = (low[0], low[1], low[2])
        self.high: Vector = (high[0], high[1], high[2])
        self.middle = middle(body)
        self._solids = solids = solids_of(body.model.path)
        positions, orientations = body.world.engine.link_frames(body.handle, solids.links)
        turns = geometry.to_matrices(orientations)
        self._centers = np.einsum("kij,kj->ki", turns, (solids.low + solids.high) / 2) + positions
        self._edges = turns * ((solids.high - solids.low) / 2 + 2 * _PADDED)[:, None]
        self._normals = np.einsum("mij,mj->mi", turns[solids.pieces], solids.normals)
        self._offsets = solids.offsets + (self._normals * positions[solids.pieces]).sum(axis=1) + _PADDED

    def half(self, direction: Sequence[float]) -> float:
        """Half of the size of its bounds along a direction, m.

        Args:
            direction: a unit vector in the world.
        """
        return half(self.low, self.high, direction)

    def across(self, scans: Sequence[Scan], count: int, zs: Sequence[float]) -> Array:
        """How far it extends along the y axes of frames.

        Args:
            scans: where lines are drawn along the y axes, at places along the x axes.
            count: of places in each.
            zs: places along the frames' z axes, m; of all of them together the farthest count.

        Returns:
            (len(scans), count, 2), m: lowest and highest y in the frame at each x; nan where there is nothing.
        """
        where, enter, leave = self._met(scans, (0, 2, 1), count, zs)
        low = _each(np.minimum, where, enter.min(axis=1), len(scans), np.inf)
        high = _each(np.maximum, where, leave.max(axis=1), len(scans), -np.inf)
        return np.where((low <= high)[:, :, None], np.stack([low, high], axis=2), np.nan)

    def walls(self, scans: Sequence[Scan], count: int, ys: Sequence[float]) -> Array:
        """Where the walls of something hollow are, looked for from the z axes of frames along their x axes.

        Args:
            scans: where lines are drawn along the x axes, at places along the z axes; those lie inside of the hollow.
            count: of these places in each.
            ys: places along the frames' y axes, m; of all of them together the farthest count.

        Returns:
            (len(scans), count, 2), m: x of the wall's inside and outside at each z; inside is nan where a line enters
            no piece, as where it begins within the solid, both where there is nothing.
        """
        where, enter, leave = self._met(scans, (2, 1, 0), count, ys)
        first = _each(np.minimum, where, np.where(enter > 0.0, enter, np.inf), len(scans), np.inf)
        last = _each(np.maximum, where, np.where(leave > 0.0, leave, -np.inf), len(scans), -np.inf).max(axis=1)
        inside = np.where(np.isfinite(first).all(axis=1), first.min(axis=1), np.nan)
        return np.stack([inside, np.where(np.isfinite(last), last, np.nan)], axis=2)

    def _met(
        self, scans: Sequence[Scan], order: tuple[int, int, int], count: int, vs: Sequence[float]
    ) -> tuple[NDArray[np.intp], Array, Array]:
        """Where parallel lines pass through its pieces: all in one go, as what takes time is numpy's being called.

        Args:
            scans: where lines are drawn.
            order: of the frames' axes: u and v across the lines, w along them.
            count: of places along u.
            vs: places of lines along v, m.

        Returns:
            For each of n scans with a piece that is near: the number of the scan (n,), those of one side by side, and
            (n, len(vs), count), m: w at which each line enters and leaves the piece; inf and -inf where it misses it.
        """
        firsts = np.array([scan.first for scan in scans])
        steps = np.array([scan.step for scan in scans])
        axes = geometry.to_matrices(np.array([scan.frame[1] for scan in scans]))[:, :, order]
        origins = np.array([scan.frame[0] for scan in scans])
        at = (self._centers - origins[:, None]) @ axes[:, :, :2]
        ends = np.stack([firsts, firsts + (count - 1) * steps], axis=1)
        low = np.stack([ends.min(axis=1), np.full(len(scans), min(vs))], axis=1)[:, None]
        high = np.stack([ends.max(axis=1), np.full(len(scans), max(vs))], axis=1)[:, None]
        reach = np.abs(np.einsum("fxu,kxe->fkue", axes[:, :, :2], self._edges)).sum(axis=3)
        near = ((at >= low - reach) & (at <= high + reach)).all(axis=2)
        where, which = np.nonzero(near)
        ends = at[where, which, 0] + np.array([[-1.0], [1.0]]) * reach[where, which, 0]
        ends = (ends - firsts[where]) / np.where(steps == 0.0, _ALONG, steps)[where]
        begins = np.clip(np.ceil(ends.min(axis=0)), 0, count - 1).astype(np.intp)
        width = int((np.clip(np.floor(ends.max(axis=0)), 0, count - 1) - begins).max(initial=0)) + 1
        begins = np.minimum(begins, count - width)  # of the places along u where lines can meet a piece at all
        pieces = self._solids.pieces
        kept = near[:, pieces]
        scan, _ = np.nonzero(kept)
        number = (np.cumsum(near) - 1).reshape(near.shape)[:, pieces][kept]
        u, v, along = (self._normals @ axes)[kept].T
        # a plane that lines go along is left far away by those within, and was left long ago by those without
        along = np.where(np.abs(along) < _ALONG, _ALONG, along)
        room = (self._offsets - origins @ self._normals.T)[kept]
        begin = firsts[scan] + begins[number] * steps[scan]
        factors = np.stack([room - u * begin, -u * steps[scan], -v], axis=1) / along[:, None]
        lines = np.empty((3, len(vs), width))
        lines[0], lines[1], lines[2] = 1.0, np.arange(width), np.reshape(vs, (-1, 1))
        found = []
        for side, nearest in ((along < 0.0, np.max), (along > 0.0, np.min)):  # each piece has planes of both
            counts = np.bincount(number[side], minlength=len(where))
            most = np.arange(counts.max(initial=1))[:, None]
            rows = np.cumsum(counts) - counts + np.minimum(most, counts - 1)
            meets = factors[side].take(rows.ravel(), axis=0) @ lines.reshape(3, -1)
            found.append(nearest(meets.reshape(len(most), len(where), len(vs), width), axis=0))
        met = found[0] <= found[1]
        enter, leave = np.full((2, len(where), len(vs), count), [[[[np.inf]]], [[[-np.inf]]]])
        pairs, beside = np.arange(len(where))[:, None, None], np.arange(len(vs))[:, None]
        cells = pairs, beside, begins[:, None, None] + np.arange(width)
        enter[cells], leave[cells] = np.where(met, found[0], np.inf), np.where(met, found[1], -np.inf)
        return where, enter, leave


def _each(nearest: np.ufunc, where: NDArray[np.intp], values: Array, count: int, nothing: float) -> Array:
    """The nearest or farthest of each scan's values (n, ...), those of one side by side: (count, ...)."""
    found = np.full((count, *values.shape[1:]), nothing)
    scanned, firsts = np.unique(where, return_index=True)
    if len(scanned):
        found[scanned] = nearest.reduceat(values, firsts)
    return found
