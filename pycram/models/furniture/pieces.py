"""The convex pieces that a model collides with, as the planes that bound them: columns and rays through them.

The engine takes the convex hull of each piece, so a hull is what things stand on, whatever a mesh looks like. A convex
piece is what lies behind all its planes; where a line enters and leaves it is a maximum and a minimum over them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.convex_hull import convex_hull
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


def vertical_extents(every: Sequence[Piece], points: Array) -> tuple[Array, Array]:
    """Return at which heights the vertical lines through points (n, 2) enter and leave pieces; inf, -inf if never.

    Returns:
        Two (n, m), a column for each piece.
    """
    origins = np.column_stack([points, np.zeros(len(points))])
    return _through(*_stacked(every), origins, np.array([[0.0, 0.0, 1.0]]))


def first_met(every: Sequence[Piece], origins: Array, directions: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the numbers of the pieces that rays (n, 3) meet first, and after how many m; infinite if none."""
    into, out = _through(*_stacked(every), origins, directions)
    met = np.where((into <= out) & (out > 0), np.maximum(into, 0.0), np.inf)
    return met.argmin(axis=1), met.min(axis=1)


def _stacked(every: Sequence[Piece]) -> tuple[Array, NDArray[np.intp]]:
    """Return the planes of pieces, and the number of the first of each."""
    starts = np.cumsum([0, *(len(piece.planes) for piece in every[:-1])])
    return np.concatenate([piece.planes for piece in every]), starts


def _through(planes: Array, starts: NDArray[np.intp], origins: Array, directions: Array) -> tuple[Array, Array]:
    """Return where lines enter and leave pieces, m along them; infinity and -infinity where they miss one.

    Args:
        planes: (k, 4) of all pieces.
        starts: (m,) numbers of the first plane of each.
        origins: (n, 3) points on the lines, m.
        directions: (n, 3) or (1, 3) unit vectors.
    """
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
    """Return the convex pieces of the model with a canonical URDF.

    Args:
        path: the URDF.
        poses: of its links in the root link.
    """
    found = []
    for link, corners in pieces_of(path):
        position, orientation = poses[link]
        placed = corners @ geometry.to_matrix(orientation).T + position
        hull = convex_hull(placed)
        if hull is None:  # it is flat: nothing stands on it safely
            continue
        planes = np.array(sorted(set(map(tuple, hull.planes.round(_SAME_PLANE).tolist()))))
        low, high = placed.min(axis=0), placed.max(axis=0)
        found.append(Piece(link, hull.corners, planes, low, high))
    return found
