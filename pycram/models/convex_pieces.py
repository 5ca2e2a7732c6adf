"""Convex pieces of a model's collision shapes, as half spaces with which lines can be intersected.

The pieces are those of the engine, which takes the convex hull of each group of a collision mesh. They are read once
from the canonical URDF, whose name changes with its content.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models import visual
from pycram.models.convex_hull import convex_hull
from pycram.models.warming import notable

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_PLANE_DECIMALS: Final = 9  # to which triangles of one face have the same plane


@dataclass(frozen=True, slots=True)
class Solids:
    """A model's k convex pieces with m planes in all, those of a piece side by side.

    Attributes:
        links: (k,) names of the links that they belong to.
        low: (k, 3) lowest corners of their boxes in the links' frames, m.
        high: (k, 3) highest corners of their boxes.
        normals: (m, 3) outward unit vectors in the links' frames.
        offsets: (m,) of the planes from the frames' origins along the normals, m.
        pieces: (m,) number of the piece that each plane belongs to.
    """

    links: tuple[str, ...]
    low: Array
    high: Array
    normals: Array
    offsets: Array
    pieces: NDArray[np.intp]


@lru_cache(maxsize=256)
@notable
def solids_of(path: Path) -> Solids:
    """Return the convex pieces of the model with a canonical URDF."""
    found = list(visual.pieces_of(path))
    planes = [_planes(corners) for _, corners in found]
    every = np.concatenate(planes) if planes else np.zeros((0, 4))
    return Solids(
        tuple(link for link, _ in found),
        np.array([corners.min(axis=0) for _, corners in found]).reshape(-1, 3),
        np.array([corners.max(axis=0) for _, corners in found]).reshape(-1, 3),
        every[:, :3],
        every[:, 3],
        np.repeat(np.arange(len(planes)), [len(each) for each in planes]),
    )


def _planes(corners: Array) -> Array:
    """Return planes (n, 4) around corners (m, 3): of their hull, and of their box, which blunts sharp edges."""
    box = np.column_stack(
        [np.vstack([np.eye(3), -np.eye(3)]), np.concatenate([corners.max(axis=0), -corners.min(axis=0)])]
    )
    hull = convex_hull(corners)
    if hull is None:  # it is flat
        return box
    planes: Array = np.unique(np.vstack([box, hull.planes * [1.0, 1.0, 1.0, -1.0]]).round(_PLANE_DECIMALS), axis=0)
    return planes
