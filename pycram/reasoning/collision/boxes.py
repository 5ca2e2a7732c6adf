"""Boxes around the convex pieces of bodies, and which of them meet: what can't touch needn't be looked at closely.

Boxes are turned as their links are. First their bounds along the world's axes are compared, then the boxes themselves,
by separating axes (Gottschalk, Lin, Manocha: OBBTree, SIGGRAPH 1996). Each is a little wider than its piece, as the
engine pads shapes, so that boxes which don't meet hold pieces which don't touch.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.visual import pieces_of
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pycram.physics.body import Body
    from pycram.physics.engine import Engine
    from pycram.world.object import Object

    Array = NDArray[np.float64]
    Indices = NDArray[np.intp]

_WIDER: Final = 1.5e-3  # m to each side: the engine's millimetre, and rounding
_PARALLEL: Final = 1e-5  # added to cosines: parallel edges have no cross product, but rounding gives them one
_MANY: Final = 8  # pieces of a link, as of a bowl's wall, that get one box for all

# Of the cross product of edge i of one box and edge j of another, for 3 * i + j, with k and l the axes after i, m and n
# those after j: k, l, (k, j), (l, j); and of the four terms of both boxes' sizes along it the edges and the cosines.
_I, _J = np.divmod(np.arange(9), 3)
_K, _L, _M, _N = (_I + 1) % 3, (_I + 2) % 3, (_J + 1) % 3, (_J + 2) % 3
_KJ, _LJ = 3 * _K + _J, 3 * _L + _J
_SIZES: Final = np.concatenate([_K, _L, 3 + _M, 3 + _N])
_COSINES: Final = np.concatenate([_LJ, _KJ, 3 * _I + _N, 3 * _I + _M])


@dataclass(frozen=True, slots=True)
class Boxes:
    """k boxes.

    Attributes:
        links: (k,) names of the links that they are around.
        centers: (k, 3) in the world, m.
        axes: (k, 3, 3) their unit axes in the world are the columns.
        halves: (k, 3) of their sizes, m.
    """

    links: tuple[str, ...]
    centers: Array
    axes: Array
    halves: Array

    @classmethod
    def around(cls, engine: Engine, body: Body, model: Object) -> Boxes:
        """Boxes around the pieces of a body, where the engine has it.

        Args:
            engine: a world's, or a twin's.
            body: the engine's side of it.
            model: the object whose shapes it has.
        """
        names, low, high = _bounds(model.model.path)
        positions, orientations = engine.link_frames(body, names)
        axes = geometry.to_matrices(orientations)
        centers = np.einsum("kij,kj->ki", axes, (low + high) / 2) + positions
        return cls(names, centers, axes, (high - low) / 2 + _WIDER)

    def chosen(self, which: NDArray[np.bool_]) -> Boxes:
        """Some of them.

        Args:
            which: (k,) flags.
        """
        links = tuple(link for link, wanted in zip(self.links, which, strict=True) if wanted)
        return Boxes(links, self.centers[which], self.axes[which], self.halves[which])

    def carried(self, transforms: Array) -> tuple[Array, Array]:
        """Where they are when each is moved.

        Args:
            transforms: (n, k, 4, 4) for each of n postures and each box.

        Returns:
            Their centers (n, k, 3), m, and axes (n, k, 3, 3).
        """
        turns = transforms[..., :3, :3]
        return (turns @ self.centers[:, :, None])[..., 0] + transforms[..., :3, 3], turns @ self.axes


@lru_cache(maxsize=256)
def _bounds(path: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Links, and lowest and highest corners (k, 3) in their frames: of each piece, of all where a link has many."""
    pieces = list(pieces_of(path))
    links, low, high = [], [], []
    for link, numbers in grouped([name for name, _ in pieces]):
        corners = np.concatenate([pieces[number][1] for number in numbers])
        links.append(link)
        low.append(corners.min(axis=0))
        high.append(corners.max(axis=0))
    return tuple(links), np.array(low).reshape(-1, 3), np.array(high).reshape(-1, 3)


def grouped(links: Sequence[str]) -> list[tuple[str, list[int]]]:
    """Which pieces are in one box.

    Args:
        links: of the pieces.

    Returns:
        For each box its link and the numbers of its pieces: one, or all where a link has many.
    """
    pieces: dict[str, list[int]] = {}
    for number, link in enumerate(links):
        pieces.setdefault(link, []).append(number)
    boxes: list[tuple[str, list[int]]] = []
    for link, mine in pieces.items():
        boxes.extend((link, numbers) for numbers in ([[number] for number in mine] if len(mine) <= _MANY else [mine]))
    return boxes


def together(parts: Sequence[Boxes]) -> Boxes:
    """All boxes in one.

    Args:
        parts: some boxes.
    """
    if not parts:
        return Boxes((), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    return Boxes(
        tuple(itertools.chain.from_iterable(part.links for part in parts)),
        np.concatenate([part.centers for part in parts]),
        np.concatenate([part.axes for part in parts]),
        np.concatenate([part.halves for part in parts]),
    )


def spans(axes: Array, halves: Array) -> Array:
    """Half of the boxes' sizes along the world's axes.

    Args:
        axes: (..., 3, 3) of the boxes.
        halves: (..., 3) of their sizes, m.
    """
    along: Array = (np.abs(axes) * halves[..., None, :]).sum(axis=-1)
    return along


def meeting(centers: Array, axes: Array, halves: Array, others: Boxes) -> tuple[Indices, Indices, Indices]:
    """Which boxes meet which others, in many postures at once.

    Args:
        centers: (n, k, 3) of the boxes in each posture, in the world, m.
        axes: (n, k, 3, 3) of the boxes.
        halves: (k, 3) of their sizes, m.
        others: boxes that stay.

    Returns:
        Indices of postures, boxes and others that meet, in order.
    """
    mine, theirs = spans(axes, halves), spans(others.axes, others.halves)
    lows, highs = centers - mine, centers + mine
    other_lows, other_highs = others.centers - theirs, others.centers + theirs
    low, high = lows.min(axis=(0, 1), initial=np.inf), highs.max(axis=(0, 1), initial=-np.inf)
    near = np.flatnonzero(((other_highs >= low) & (other_lows <= high)).all(axis=1))
    other_lows, other_highs = other_lows[near], other_highs[near]
    meet = np.ones((len(centers), centers.shape[1], len(near)), dtype=bool)
    for axis in range(3):
        meet &= lows[:, :, None, axis] <= other_highs[:, axis]
        meet &= highs[:, :, None, axis] >= other_lows[:, axis]
    posture, box, other = np.nonzero(meet)
    other = near[other]
    met = _overlap(
        centers[posture, box], axes[posture, box], halves[box], others.centers[other], others.axes[other],
        others.halves[other],
    )  # fmt: skip
    return posture[met], box[met], other[met]


def overlapping(centers: Array, axes: Array, halves: Array, firsts: Indices, seconds: Indices) -> Indices:
    """Which of some pairs of boxes meet.

    Args:
        centers: (k, 3) in the world, m.
        axes: (k, 3, 3) of the boxes.
        halves: (k, 3) of their sizes, m.
        firsts: (n,) indices of boxes.
        seconds: (n,) indices of the boxes beside them.

    Returns:
        Indices of the pairs that meet, in order.
    """
    sizes = spans(axes, halves)
    close = np.abs(centers[firsts] - centers[seconds]) <= sizes[firsts] + sizes[seconds]
    near = np.flatnonzero(close.all(axis=1))
    if not len(near):
        return near
    a, b = firsts[near], seconds[near]
    return near[_overlap(centers[a], axes[a], halves[a], centers[b], axes[b], halves[b])]


def _overlap(
    centers: Array, axes: Array, halves: Array, other_centers: Array, other_axes: Array, other_halves: Array
) -> NDArray[np.bool_]:
    """Whether boxes overlap, pair by pair (n,): none of 15 axes separates them."""
    back = axes.transpose(0, 2, 1)
    turn = back @ other_axes  # the other's axes in the box's frame
    way = (back @ (other_centers - centers)[:, :, None])[:, :, 0]
    cosines = np.abs(turn) + _PARALLEL
    overlap: NDArray[np.bool_] = np.all(np.abs(way) <= halves + (cosines @ other_halves[:, :, None])[:, :, 0], axis=1)
    left = np.flatnonzero(overlap)  # the few that the box's own axes don't separate
    turn, way, cosines, halves, other_halves = (part[left] for part in (turn, way, cosines, halves, other_halves))
    along = (turn.transpose(0, 2, 1) @ way[:, :, None])[:, :, 0]
    apart = (np.abs(along) > other_halves + (cosines.transpose(0, 2, 1) @ halves[:, :, None])[:, :, 0]).any(axis=1)
    # cross products of edge i of the one and edge j of the other (n, 3 * i + j)
    turn, cosines = turn.reshape(-1, 9), cosines.reshape(-1, 9)
    distance = way.take(_L, axis=1) * turn.take(_KJ, axis=1)
    distance -= way.take(_K, axis=1) * turn.take(_LJ, axis=1)
    sizes = np.concatenate([halves, other_halves], axis=1).take(_SIZES, axis=1)
    reach = (sizes * cosines.take(_COSINES, axis=1)).reshape(-1, 4, 9).sum(axis=1)
    apart |= (np.abs(distance) > reach).any(axis=1)
    overlap[left[apart]] = False
    return overlap
