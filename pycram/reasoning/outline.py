"""An object's outline: where straight lines meet its surface.

A gripper has to know how wide an object is where the fingers go, which neither its bounds nor its origin tell: bounds
grow when it turns, and a hollow one has walls. The surface is that of the shapes that touch, as the model says; no
engine is asked, hence nothing can be stale and nothing is put anywhere.
"""

from __future__ import annotations

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
        self._normals = np.einsum("mij,mj->mi", turns[solids.pieces], solids.normals)
        self._offsets = solids.offsets + (self._normals * positions[solids.pieces]).sum(axis=1) + _PADDED

    def half(self, direction: Sequence[float]) -> float:
        """Half of the size of its bounds along a direction, m.

        Args:
            direction: a unit vector in the world.
        """
        return half(self.low, self.high, direction)

    def across(self, frames: Sequence[Pose], xs: Sequence[Sequence[float]], zs: Sequence[float]) -> list[Array]:
        """How far it extends along the y axes of frames.

        Args:
            frames: in the world.
            xs: for each frame, places along its x axis, m.
            zs: places along the frames' z axes, m; of all of them together the farthest count.

        Returns:
            For each frame (len(its xs), 2), m: lowest and highest y at each x; nan where there is nothing.
        """
        turns = [geometry.to_matrix(turn) for _, turn in frames]
        starts = [
            (np.asarray(at) + np.asarray(x)[:, None, None] * turn[:, 0] + np.asarray(zs)[:, None] * turn[:, 2])
            for (at, _), turn, x in zip(frames, turns, xs, strict=True)
        ]
        counts = [len(x) * len(zs) for x in xs]
        along = np.repeat(np.array([turn[:, 1] for turn in turns]).reshape(-1, 3), counts, axis=0)
        enter, leave = self._met(np.concatenate([start.reshape(-1, 3) for start in starts]), along)
        lowest = enter.min(axis=1, initial=np.inf).reshape(-1, len(zs)).min(axis=1)
        highest = leave.max(axis=1, initial=-np.inf).reshape(-1, len(zs)).max(axis=1)
        found = np.stack([lowest, highest], axis=1)
        found[~np.isfinite(found)] = np.nan
        return np.split(found, np.cumsum([len(x) for x in xs])[:-1])

    def wall(self, frame: Pose, ys: Sequence[float], zs: Sequence[float]) -> Array:
        """Where the wall of something hollow is, looked for from the origin of a frame along its x axis.

        Args:
            frame: in the world; its origin lies inside of the hollow.
            ys: places along the frame's y axis, m; of all of them together the farthest count.
            zs: places along the frame's z axis, m.

        Returns:
            (len(zs), 2), m: x of the wall's inside and outside at each z; inside is nan where a line enters no piece,
            as where it begins within the solid, both where there is nothing.
        """
        at, turn = frame
        axes = geometry.to_matrix(turn)
        starts = np.asarray(at) + np.asarray(zs)[:, None, None] * axes[:, 2] + np.asarray(ys)[:, None] * axes[:, 1]
        starts = starts.reshape(-1, 3)
        enter, leave = self._met(starts, np.broadcast_to(axes[:, 0], starts.shape))
        shape = len(zs), len(ys)
        first = np.where(enter > 0.0, enter, np.inf).min(axis=1, initial=np.inf).reshape(shape)
        last = np.where(leave > 0.0, leave, -np.inf).max(axis=1, initial=-np.inf).reshape(shape)
        inside = np.where(np.isfinite(first).all(axis=1), first.min(axis=1), np.nan)
        found = np.stack([inside, last.max(axis=1)], axis=1)
        found[~np.isfinite(found)] = np.nan
        return found

    def _met(self, starts: Array, along: Array) -> tuple[Array, Array]:
        """Where lines pass through its pieces.

        Args:
            starts: (n, 3) a point of each line, in the world, m.
            along: (n, 3) unit vectors.

        Returns:
            (n, pieces), m: how far from its point each line enters and leaves each piece; inf and -inf where it misses.
        """
        pieces = self._solids.starts
        if not len(pieces):
            nowhere = np.zeros((len(starts), 0))
            return nowhere, nowhere
        speed = along @ self._normals.T
        speed[np.abs(speed) < _ALONG] = 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            # beside a plane that a line goes along: inf within, -inf without, both as they must be
            meets = (self._offsets - starts @ self._normals.T) / speed
        enter = np.fmax.reduceat(np.where(speed < 0.0, meets, -np.inf), pieces, axis=1)
        leave = np.fmin.reduceat(np.where(speed < 0.0, np.inf, meets), pieces, axis=1)
        missed = enter > leave
        enter[missed], leave[missed] = np.inf, -np.inf
        return enter, leave
