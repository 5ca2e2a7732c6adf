"""Balls inside of bodies: where those of two bodies overlap, the bodies do for sure, and at least as deep.

It is the other side of what boxes say (:mod:`pycram.reasoning.boxes`): boxes around pieces tell what can't touch, balls
inside of them what does, and the engine needn't be asked. To push bodies apart takes at least what it takes for their
balls; the engine, which makes shapes thicker, says that they overlap a little deeper.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.boxes import grouped
from pycram.solids import solids_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.solids import Solids

    Array = NDArray[np.float64]

FEW: Final = 6  # balls that fill what is in a box
MANY: Final = 32  # balls in a box, those included: the others are all over it
_SIDE: Final = 5  # places along each side of a piece where a ball's centre can be
_TRIED: Final = 250  # places that centres are chosen from


@lru_cache(maxsize=256)
def balls_in(path: Path) -> Array:
    """Balls inside of the pieces of a model.

    Args:
        path: its canonical URDF, beside its meshes.

    Returns:
        (k, MANY, 4): for each of the :class:`~pycram.reasoning.boxes.Boxes` around it centres along the box's axes from
        its middle, and radii, m; the FEW that fill it first. A radius of -inf stands for no ball.
    """
    solids = solids_of(path)
    return np.array([_chosen(*_places(solids, pieces)) for _, pieces in grouped(solids.links)]).reshape(-1, MANY, 4)


def overlaps(
    balls: Array, centers: Array, axes: Array, other_balls: Array, other_centers: Array, other_axes: Array
) -> Array:
    """How far the balls in boxes overlap at most, pair by pair.

    Args:
        balls: (n, a, 4) in n boxes, as :func:`balls_in` has them.
        centers: (n, 3) of these boxes in the world, m.
        axes: (n, 3, 3) of these boxes.
        other_balls: (n, b, 4) in the boxes beside them.
        other_centers: (n, 3) of those.
        other_axes: (n, 3, 3) of those.

    Returns:
        (n,), m; negative where none do.
    """
    back = other_axes.transpose(0, 2, 1)
    at = balls[..., :3] @ (back @ axes).transpose(0, 2, 1) + ((centers - other_centers)[:, None] @ other_axes)
    # |a - b|^2 = (a, |a|^2, 1) . (-2b, 1, |b|^2): one product for all pairs of balls
    one, two = np.ones((*balls.shape[:2], 5)), np.ones((*other_balls.shape[:2], 5))
    one[..., :3], one[..., 3] = at, (at * at).sum(axis=2)
    two[..., :3], two[..., 4] = -2.0 * other_balls[..., :3], (other_balls[..., :3] ** 2).sum(axis=2)
    apart = one @ two.transpose(0, 2, 1)
    np.sqrt(np.maximum(apart, 0.0, out=apart), out=apart)
    np.subtract(other_balls[:, None, :, 3], apart, out=apart)
    deepest: Array = (apart.max(axis=2) + balls[..., 3]).max(axis=1)
    return deepest


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
