"""Convex hulls as the planes that bound them.

Three corners of few span a side of their hull where all others lie behind them: tried one and all. Of many corners
scipy finds them, which takes a quarter of a second to load.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pycram.models.lazy_module import LazyModule
from recorder.packages import needed

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy import spatial

    Array = NDArray[np.float64]
else:
    with needed():
        spatial = LazyModule("scipy.spatial")

_MAX_CHOSEN: Final = 40  # corners: of more, to try all choices of three takes longer than 3 ms
_SHARED: Final = 6  # triangles at a corner, about: so often it stands there where triangles are given
_FLAT: Final = 1e-9  # m that a corner may lie before a plane, and a solid's thickness at least
_IN_LINE: Final = 1e-12  # m^2: twice the area of three corners in a line
_NEXT: Final = [1, 2, 0]  # axes of each factor of a cross product
_OTHER: Final = [2, 0, 1]


class Hull(NamedTuple):
    """A convex hull.

    Attributes:
        corners: (n, 3), m; with what lies within it, of few.
        planes: (k, 4) unit normals, outwards, and offsets in m: points inside have ``normal @ point + offset <= 0``.
            One may be there several times, up to rounding.
    """

    corners: Array
    planes: Array


def convex_hull(corners: Array) -> Hull | None:
    """Return the convex hull of points (n, 3), m; None if all lie in one plane."""
    if _MAX_CHOSEN < len(corners) <= _MAX_CHOSEN * _SHARED:
        corners = np.unique(corners, axis=0)
    if len(corners) > _MAX_CHOSEN:
        try:
            hull = spatial.ConvexHull(corners)
        except spatial.QhullError:  # it is flat
            return None
        return Hull(corners[hull.vertices], hull.equations)
    first, second, third = corners[_triples(len(corners))]
    u, v = second - first, third - first
    normals = u[:, _NEXT] * v[:, _OTHER] - u[:, _OTHER] * v[:, _NEXT]  # np.cross takes longer than all the rest
    areas = np.sqrt((normals * normals).sum(axis=1))
    spans = areas > _IN_LINE
    normals = normals[spans] / areas[spans, None]
    offsets = -(normals * first[spans]).sum(axis=1)
    heights = normals @ corners.T + offsets[:, None]
    outwards, inwards = heights.max(axis=1) < _FLAT, heights.min(axis=1) > -_FLAT
    if not outwards.any() or (outwards & inwards).any():
        return None
    every = np.column_stack([normals, offsets])
    return Hull(corners, np.concatenate([every[outwards], -every[inwards]]))


@cache
def _triples(count: int) -> NDArray[np.intp]:
    """Return all choices (3, k) of three of a count."""
    return np.array(list(itertools.combinations(range(count), 3)), dtype=np.intp).reshape(-1, 3).T
