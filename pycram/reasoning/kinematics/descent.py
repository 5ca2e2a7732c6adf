"""Inverse kinematics by damped least squares, from many starts at once, always within the joints' limits.

The method is that of Buss, Introduction to Inverse Kinematics with Jacobian Transpose, Pseudoinverse and Damped Least
Squares Methods, 2004. Everything is deterministic: starting postures are spread by a Halton sequence.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.kinematics.chain import norms, rotation_error

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pycram.reasoning.kinematics.chain import Chain

    Array = NDArray[np.float64]

POSITION_TOLERANCE: Final = 1e-3  # m
TURN_TOLERANCE: Final = 1e-2  # rad
_DAMPING: Final = 1e-2
_ITERATIONS: Final = 40
_MAX_STEP: Final = 0.5  # rad or m a joint moves in one iteration
_MAX_ERROR: Final = 0.6  # m or rad of error that are corrected at once
_STALE: Final = (8, 0.9)  # iterations in which the least error has to fall to this share of itself, or the search ends
_CLOSE: Final = 0.02  # m or rad of error below which a search is never given up


def descend(
    chain: Chain, start: Array, goal: Array, turn: Array | None, *, stop_early: bool
) -> tuple[Array, NDArray[np.bool_]]:
    """Search for postures.

    Args:
        chain: whose tool is to get there.
        start: (n, joints) postures to search from.
        goal: (3,) in the chain's base link, m.
        turn: (3, 3) orientation there; None if any will do.
        stop_early: end as soon as one gets there.

    Returns:
        (n, joints) postures, and which of them reach.
    """
    postures = chain.limited(start)
    rows = 3 if turn is None else 6
    reached = np.zeros(len(postures), dtype=bool)
    damping = _DAMPING * np.eye(rows)
    best = np.inf
    for iteration in range(_ITERATIONS):
        pose, jacobian = chain.forward(postures)
        error = np.zeros((len(postures), rows))
        error[:, :3] = goal - pose[:, :3, 3]
        near = norms(error[:, :3]) < 0.5 * POSITION_TOLERANCE
        if turn is not None:
            error[:, 3:] = rotation_error(pose[:, :3, :3], turn)
            near &= norms(error[:, 3:]) < 0.5 * TURN_TOLERANCE
        reached = near
        if near.all() or (stop_early and near.any()):
            break
        length = norms(error)[:, None]
        if iteration % _STALE[0] == 0:
            nearest = float(length.min())
            if nearest > _STALE[1] * best and nearest > _CLOSE:
                break
            best = nearest
        correction = error * np.minimum(1.0, _MAX_ERROR / np.maximum(length, 1e-9))
        j = jacobian[:, :rows]
        # a joint at its limit that wants to go beyond takes no part
        gradient = np.einsum("nrj,nr->nj", j, correction)
        stuck = chain.bounded & (
            ((postures <= chain.lower + 1e-9) & (gradient < 0)) | ((postures >= chain.upper - 1e-9) & (gradient > 0))
        )
        j = np.where(stuck[:, None, :], 0.0, j)
        scale = np.minimum(1.0, (error**2).sum(axis=1))[:, None, None] + 1e-4
        inner = np.linalg.solve(j @ j.transpose(0, 2, 1) + damping * scale, correction[:, :, None])
        step = (j.transpose(0, 2, 1) @ inner)[:, :, 0]
        step *= np.minimum(1.0, _MAX_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-9))
        postures = chain.limited(np.where(near[:, None], postures, postures + step))
    return postures, reached


def spread(chain: Chain, start: int, count: int) -> Array:
    """Return postures (count, joints) all over a chain's range, from number ``start`` of a Halton sequence on."""
    postures: Array = chain.lower + _halton(start, count, len(chain.joints)) * (chain.upper - chain.lower)
    return postures


@cache
def _halton(start: int, count: int, dimensions: int) -> Array:
    """Return points (count, dimensions) of the Halton sequence."""
    primes: list[int] = []
    number = 2
    while len(primes) < dimensions:
        if all(number % prime for prime in primes):
            primes.append(number)
        number += 1
    return np.array([[_radical_inverse(i + 1, prime) for prime in primes] for i in range(start, start + count)])


def _radical_inverse(index: int, base: int) -> float:
    result, fraction = 0.0, 1.0 / base
    while index:
        result += fraction * (index % base)
        index //= base
        fraction /= base
    return result
