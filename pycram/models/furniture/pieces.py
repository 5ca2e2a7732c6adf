"""The convex pieces that a model collides with, as the planes that bound them: columns and rays through them.

The engine takes the convex hull of each piece, so a hull is what things stand on, whatever a mesh looks like. A convex
piece is what lies behind all its planes; where a line enters and leaves it is a maximum and a minimum over them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.visual import pieces_of
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from recorder.geometry import Pose

    Array = NDArray[np.float64]

_PARALLEL: Final = 1e-9  # of a unit normal along a line
_SAME_PLANE: Final = 6  # decimals: triangles of one side of a hull have the same plane


@dataclass(frozen=True, slots=True)
class Piece:
    """A convex piece in the frame of the root link.

    Attributes:
        link: that it belongs to.
        corners: (n, 3), m.
        planes: (k, 4) unit normals, outwards, and offsets in m: points inside have ``normal @ point + offset <= 0``.
        low: lowest corner of its bounds.
        high: highest corner.
    """

    link: str
    corners: Array
    planes: Array
    low: Array
    high: Array

    def columns(self, points: Array) -> tuple[Array, Array]:
        """Return at which heights the vertical lines through points (n, 2) enter and leave it; inf, -inf if never."""
        origins = np.column_stack([points, np.zeros(len(points))])
        return _through(self.planes, origins, np.broadcast_to((0.0, 0.0, 1.0), origins.shape))

    def enter(self, origin: Array, directions: Array) -> Array:
        """Return after how many m rays in directions (n, 3) from a point enter it; infinite if they miss it."""
        into, out = _through(self.planes, np.broadcast_to(origin, directions.shape), directions)
        return np.where((into <= out) & (out > 0), np.maximum(into, 0.0), np.inf)


def _through(planes: Array, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Return where lines (n, 3) enter and leave what lies behind planes (k, 4); infinity and -infinity if never."""
    slopes = directions @ planes[:, :3].T
    heights = origins @ planes[:, :3].T + planes[:, 3]
    along = np.abs(slopes) < _PARALLEL
    with np.errstate(divide="ignore", invalid="ignore"):
        at = -heights / slopes
    into = np.where(along | (slopes > 0), -np.inf, at).max(axis=1)
    out = np.where(along | (slopes < 0), np.inf, at).min(axis=1)
    missed = (along & (heights > 0)).any(axis=1) | (into > out)
    return np.where(missed, np.inf, into), np.where(missed, -np.inf, out)


def pieces(path: Path, poses: Mapping[str, Pose]) -> Sequence[Piece]:
    """Return the convex pieces of the model with a canonical URDF.

    Args:
        path: the URDF.
        poses: of its links in the root link.
    """
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  takes long, and few plans ask for furniture

    found = []
    for link, corners in pieces_of(path):
        position, orientation = poses[link]
        placed = corners @ geometry.to_matrix(orientation).T + position
        try:
            hull = ConvexHull(placed)
        except QhullError:  # it is flat: nothing stands on it safely
            continue
        planes = np.unique(hull.equations.round(_SAME_PLANE), axis=0)
        low, high = placed.min(axis=0), placed.max(axis=0)
        found.append(Piece(link, placed[hull.vertices], planes, low, high))
    return found
