"""Balls inside of bodies: where those of two bodies overlap, the bodies do for sure, and at least as deep.

It is the other side of what boxes say (:mod:`pycram.reasoning.collision.boxes`): boxes around pieces tell what can't
touch, balls inside of them what does, and the engine needn't be asked. To push bodies apart takes at least what it
takes for their balls; the engine, which makes shapes thicker, says that they overlap a little deeper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.convex import solids_of
from pycram.reasoning.collision.boxes import grouped

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.models.convex import Solids

    Array = NDArray[np.float64]

FEW: Final = 6  # balls that fill what is in a box
MANY: Final = 32  # balls in a box, those included: the others are all over it
_SIDE: Final = 5  # places along each side of a piece where a ball's centre can be
_TRIED: Final = 250  # places that centres are chosen from


@dataclass(frozen=True, slots=True)
class InscribedSpheres:
    """Balls in k boxes; a radius of -inf stands for none.

    Attributes:
        places: (k, n, 3) of their centres along the box's axes, from its middle, m.
        radii: (k, n), m.
        folded: (k, 4, n) of their centres p what a square of a distance takes: -2 p, and p squared.
    """

    places: Array
    radii: Array
    folded: Array

    def of(self, boxes: NDArray[np.intp], most: int = MANY) -> InscribedSpheres:
        """The first balls in some of the boxes.

        Args:
            boxes: their numbers.
            most: so many in each.
        """
        return InscribedSpheres(self.places[boxes, :most], self.radii[boxes, :most], self.folded[boxes, :, :most])

    def overlaps(self, turns: Array, ways: Array, others: InscribedSpheres) -> Array:
        """How far they overlap with those in other boxes at most, box by box.

        Args:
            turns: (k, 3, 3) axes of their boxes along those of the others.
            ways: (k, 3) from the others' middles to their boxes' along the others' axes, m.
            others: balls in k boxes.

        Returns:
            (k,), m; negative where none do.
        """
        at = np.ones((*self.radii.shape, 4))
        at[..., :3] = places = self.places @ turns.transpose(0, 2, 1) + ways[:, None]
        apart = at @ others.folded
        apart += (places * places).sum(axis=2)[:, :, None]
        np.sqrt(np.maximum(apart, 0.0, out=apart), out=apart)
        np.subtract(others.radii[:, None], apart, out=apart)
        deepest: Array = (apart.max(axis=2) + self.radii).max(axis=1)
        return deepest


@lru_cache(maxsize=256)
def inscribed_spheres(path: Path) -> InscribedSpheres:
    """Balls inside of the pieces of a model.

    Args:
        path: its canonical URDF, beside its meshes.

    Returns:
        MANY in each of the :class:`~pycram.reasoning.collision.boxes.Boxes` around it; the FEW that fill it come first.
    """
    solids = solids_of(path)
    chosen = [_chosen(*_places(solids, pieces)) for _, pieces in grouped(solids.links)]
    balls = np.array(chosen).reshape(-1, MANY, 4)
    places = balls[..., :3]
    folded = np.concatenate([-2.0 * places, (places * places).sum(axis=2, keepdims=True)], axis=2).transpose(0, 2, 1)
    return InscribedSpheres(places, balls[..., 3], np.ascontiguousarray(folded))


def together(parts: Sequence[InscribedSpheres]) -> InscribedSpheres:
    """The balls in all boxes, one after the other.

    Args:
        parts: at least one.
    """
    places, radii, folded = zip(*((part.places, part.radii, part.folded) for part in parts), strict=True)
    return InscribedSpheres(np.concatenate(places), np.concatenate(radii), np.concatenate(folded))


def _places(solids: Solids, pieces: Sequence[int]) -> tuple[Array, Array]:
    """Points (n, 3) inside of pieces, from the middle of their box, and how far (n,) below their surface at least."""
    share = (np.arange(_SIDE) + 0.5) / _SIDE
    grid = np.stack(np.meshgrid(share, share, share, indexing="ij"), axis=-1).reshape(-1, 3)
    places, depths = [], []
    for piece in pieces:
        planes = solids.pieces == piece
        at = solids.low[piece] + grid * (solids.high - solids.low)[piece]
        depth = (solids.offsets[planes] - at @ solids.normals[planes].T).min(axis=1)
        places.append(at[depth > 0.0])
        depths.append(depth[depth > 0.0])
    middle = (solids.low[list(pieces)].min(axis=0) + solids.high[list(pieces)].max(axis=0)) / 2
    return np.concatenate(places) - middle, np.concatenate(depths)


def _chosen(places: Array, depths: Array) -> Array:
    """First the balls that bring most places deepest below a surface, then those that are farthest from others."""
    balls = np.zeros((MANY, 4))
    balls[:, 3] = -np.inf
    some = slice(None, None, len(places) // _TRIED + 1)
    places, depths = places[some], depths[some]
    away = np.linalg.norm(places[:, None] - places, axis=2)
    below = depths[:, None] - away
    best, nearest = np.zeros(len(places)), np.full(len(places), np.inf)
    for number, ball in enumerate(balls[: len(places)]):
        gain = np.maximum(below, best).sum(axis=1) if number < FEW else nearest
        chosen = int(gain.argmax())
        best, nearest = np.maximum(best, below[chosen]), np.minimum(nearest, away[chosen])
        ball[:3], ball[3] = places[chosen], depths[chosen]
    return balls
