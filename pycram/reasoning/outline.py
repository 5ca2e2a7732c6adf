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
        self._centers = np.einsum("kij,kj->ki", turns, (solids.low + solids.high) / 2) + positions
        self._radii = np.linalg.norm(solids.high - solids.low, axis=1) / 2 + 2 * _PADDED
        self._normals = np.einsum("mij,mj->mi", turns[solids.pieces], solids.normals)
        self._offsets = solids.offsets + (self._normals * positions[solids.pieces]).sum(axis=1) + _PADDED

    def half(self, direction: Sequence[float]) -> float:
        """Half of the size of its bounds along a direction, m.

        Args:
            direction: a unit vector in the world.
        """
        return half(self.low, self.high, direction)

    def across(self, frame: Pose, xs: Sequence[float], zs: Sequence[float]) -> Array:
        """How far it extends along the y axis of a frame.

        Args:
            frame: in the world.
            xs: places along the frame's x axis, m.
            zs: places along the frame's z axis, m; of all of them together the farthest count.

        Returns:
            (len(xs), 2), m: lowest and highest y in the frame at each x; nan where there is nothing.
        """
        enter, leave = self._met(frame, (0, 2, 1), xs, zs)
        found = np.stack([enter.min(axis=(1, 2), initial=np.inf), leave.max(axis=(1, 2), initial=-np.inf)], axis=1)
        found[~np.isfinite(found)] = np.nan
        return found

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
        enter, leave = self._met(frame, (2, 1, 0), zs, ys)
        first = np.where(enter > 0.0, enter, np.inf).min(axis=2, initial=np.inf)
        inside = np.where(np.isfinite(first).all(axis=1), first.min(axis=1), np.nan)
        outside = np.where(leave > 0.0, leave, -np.inf).max(axis=(1, 2), initial=-np.inf)
        found = np.stack([inside, outside], axis=1)
        found[~np.isfinite(found)] = np.nan
        return found

    def _met(
        self, frame: Pose, order: tuple[int, int, int], us: Sequence[float], vs: Sequence[float]
    ) -> tuple[Array, Array]:
        """Where parallel lines pass through its pieces.

        Args:
            frame: in the world.
            order: of the frame's axes: u and v across the lines, w along them.
            us: places of lines along u, m.
            vs: places of lines along v, m.

        Returns:
            (len(us), len(vs), pieces), m: w at which each line enters and leaves each piece that is near; inf and -inf
            where it misses it.
        """
        position, turn = frame
        axes = geometry.to_matrix(turn)[:, order]
        at = (self._centers - position) @ axes[:, :2]
        low, high = np.array([min(us), min(vs)]), np.array([max(us), max(vs)])
        reach = self._radii[:, None]
        near = ((at >= low - reach) & (at <= high + reach)).all(axis=1)
        chosen = near[self._solids.pieces]
        pieces, normals = self._solids.pieces[chosen], self._normals[chosen]
        u, v, along = (normals @ axes).T
        # a plane that lines go along is left far away by those within, and was left long ago by those without
        along = np.where(np.abs(along) < _ALONG, _ALONG, along)
        room = (self._offsets[chosen] - normals @ np.asarray(position)) / along
        u, v = u / along, v / along
        ends = []
        for side, nearest in ((along < 0.0, np.maximum), (along > 0.0, np.minimum)):  # each piece has planes of both
            meets = room[side] - np.multiply.outer(us, u[side])[:, None] - np.multiply.outer(vs, v[side])
            firsts = np.flatnonzero(np.diff(pieces[side], prepend=-1))
            ends.append(nearest.reduceat(meets, firsts, axis=2) if len(firsts) else meets)
        enter, leave = ends
        missed = enter > leave
        enter[missed], leave[missed] = np.inf, -np.inf
        return enter, leave
