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
_CLOSE: Final = 0.005  # m or rad of error below which a search is never given up


def descend(
    chain: Chain, start: Array, goals: Array, turns: Array | None, targets: NDArray[np.intp], *, stop_early: bool
) -> tuple[Array, NDArray[np.bool_]]:
    """Search for postures that reach targets, from several starts each, all at once.

    What is found for a target doesn't depend on which others there are.

    Args:
        chain: whose tool is to get there.
        start: (n, joints) postures to search from.
        goals: (n, 3) where from each of them, in the chain's base link, m.
        turns: (n, 3, 3) orientations there; None if any will do.
        targets: (n,) ascending numbers of the targets that these are.
        stop_early: end the search for a target as soon as one of its postures gets there.

    Returns:
        (n, joints) postures, and which of them reach.
    """
    found = chain.limited(start)
    reached = np.zeros(len(found), dtype=bool)
    rows = np.arange(len(found))  # that are searched on
    size = 3 if turns is None else 6
    damping = _DAMPING * np.eye(size)
    nearest = np.full(int(targets.max(initial=-1)) + 1, np.inf)
    first = _first_rows(targets)
    for iteration in range(_ITERATIONS):
        postures = found[rows]
        pose, jacobian = chain.forward(postures)
        error = np.zeros((len(rows), size))
        error[:, :3] = goals[rows] - pose[:, :3, 3]
        near = norms(error[:, :3]) < 0.5 * POSITION_TOLERANCE
        if turns is not None:
            error[:, 3:] = rotation_error(pose[:, :3, :3], turns[rows])
            near &= norms(error[:, 3:]) < 0.5 * TURN_TOLERANCE
        reached[rows] = near
        length = norms(error)
        ended = (np.logical_or if stop_early else np.logical_and).reduceat(near, first)
        if iteration % _STALE[0] == 0:
            which = targets[rows[first]]
            least = np.minimum.reduceat(length, first)
            ended |= (least > _STALE[1] * nearest[which]) & (least > _CLOSE)
            nearest[which] = least
        if ended.any():
            going = ~np.repeat(ended, np.diff(first, append=len(rows)))
            if not going.any():
                break
            rows, postures, near, error, length = (part[going] for part in (rows, postures, near, error, length))
            jacobian, first = jacobian[going], _first_rows(targets[rows])
        step = _step(chain, postures, jacobian[:, :size], error, length[:, None], damping)
        found[rows] = chain.limited(np.where(near[:, None], postures, postures + step))
    return found, reached


def _first_rows(targets: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the first row of each target, of which rows have the ascending numbers."""
    return np.flatnonzero(np.diff(targets, prepend=-1))


def _step(chain: Chain, postures: Array, jacobian: Array, error: Array, length: Array, damping: Array) -> Array:
    """Return the changes (n, joints) of postures that lessen errors (n, 3 or 6) of a length (n, 1)."""
    correction = error * np.minimum(1.0, _MAX_ERROR / np.maximum(length, 1e-9))
    # a joint at its limit that wants to go beyond takes no part
    gradient = np.einsum("nrj,nr->nj", jacobian, correction)
    stuck = chain.bounded & (
        ((postures <= chain.lower + 1e-9) & (gradient < 0)) | ((postures >= chain.upper - 1e-9) & (gradient > 0))
    )
    j = np.where(stuck[:, None, :], 0.0, jacobian)
    scale = np.minimum(1.0, (error**2).sum(axis=1))[:, None, None] + 1e-4
    inner = np.linalg.solve(j @ j.transpose(0, 2, 1) + damping * scale, correction[:, :, None])
    step: Array = (j.transpose(0, 2, 1) @ inner)[:, :, 0]
    step *= np.minimum(1.0, _MAX_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-9))
    return step


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
