"""Paden and Kahan's subproblems, for many rows at once: angles by which axes turn a point to where it is wanted.

Arms whose axes meet in shoulder and wrist are solved by a chain of these (Murray, Li, Sastry: A Mathematical
Introduction to Robotic Manipulation, 1994, section 3.3.2). Points and vectors are the columns of arrays (3, n) or
(3, 1); axes are unit vectors (3,); angles are (n,) in rad. Where no angle does it, the nearest is returned, with a
strain: about how many rad are missing, 0 for solutions.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Hinge = tuple[Array, Array, Array]

_ROUNDING: Final = 1e-9  # of a cosine: no miss


def turned(axis: Array, angle: Array, vector: Array) -> Array:
    """Return vectors turned about an axis through the origin (Rodrigues' formula)."""
    along, across, beside = _parts(axis, vector)
    result: Array = along + np.cos(angle) * across + np.sin(angle) * beside
    return result


def _parts(axis: Array, vector: Array) -> tuple[Array, Array, Array]:
    """Return the parts of vectors along an axis and across it, and the latter turned on by a right angle."""
    along, across, beside = (_split(axis.tobytes()) @ vector).reshape(3, 3, -1)
    return along, across, beside


@lru_cache(maxsize=256)
def _split(axis: bytes) -> Array:
    """Return the matrix (9, 3) of these parts, for an axis that comes again and again."""
    x, y, z = unit = np.frombuffer(axis)
    along = np.outer(unit, unit)
    return np.vstack([along, np.eye(3) - along, [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]])


def _dot(some: Array, others: Array) -> Array:
    """Return scalar products, column by column."""
    products: Array = np.einsum("in,in->n", some, others)
    return products


def angle_between(axis: Array, start: Array, end: Array) -> Array:
    """Return the angle about an axis through the origin that turns a vector's direction into another's: subproblem 1.

    Args:
        axis: of the turn.
        start: the vector before.
        end: the vector after; what of both lies along the axis doesn't count.
    """
    _, across, beside = _parts(axis, start)
    result: Array = np.arctan2(_dot(beside, end), _dot(across, end))
    return result


def two_turns(first: Array, second: Array, start: Array, end: Array) -> tuple[Array, Array, Array]:
    """Return angles about two axes through the origin, not parallel, that turn a vector into another: subproblem 2.

    Args:
        first: the outer axis.
        second: the inner axis, about which the vector is turned first.
        start: the vector before.
        end: the vector after; its direction counts.

    Returns:
        Angles (2, n) about the outer and about the inner axis, of both solutions, within two turns, and their strain
        (n,).
    """
    cosine, sine, outer_frame, inner_frame = _crossing(first.tobytes(), second.tobytes())
    # the vector before, and after, each by its parts beside the other axis, across both axes, and along its own axis
    x, y, z = inner_frame @ start
    squares = x * x + y * y
    lengths = squares + z * z
    ends = outer_frame @ end
    u, v, w = ends * np.sqrt(lengths / np.maximum((ends * ends).sum(axis=0), 1e-12))
    # between both turns it has the parts along both axes, and either of two across them
    inner, outer = (w - cosine * z) / sine, (z - cosine * w) / sine
    rest = squares - inner * inner
    across = np.sqrt(np.maximum(rest, 0.0))
    inner, outer = np.arctan2(across, inner), np.arctan2(across, outer)
    before, after = np.arctan2(y, x), np.arctan2(v, u)
    short = -rest / (sine * sine * np.maximum(lengths, 1e-12))
    return (
        np.array([after - outer, after + outer]),
        np.array([-inner - before, inner - before]),
        np.sqrt(np.maximum(short - _ROUNDING, 0.0)),
    )


@lru_cache(maxsize=64)
def _crossing(first: bytes, second: bytes) -> tuple[float, float, Array, Array]:
    """Return cosine and sine between two axes, and frames (3, 3) around each: towards the other, across, along it."""
    a, b = np.frombuffer(first), np.frombuffer(second)
    cosine = float(a @ b)
    sine = math.sqrt(1.0 - cosine * cosine)
    frames = []
    for axis, beside in ((a, b), (b, a)):
        towards = (beside - cosine * axis) / sine
        frames.append(np.stack([towards, np.cross(axis, towards), axis]))
    return cosine, sine, frames[0], frames[1]


def twice(vectors: Array) -> Array:
    """Return vectors (3, n) once more beside themselves, (3, 1) as they are."""
    return vectors if vectors.shape[1] == 1 else np.concatenate([vectors, vectors], axis=1)


def hinge(axis: Array, start: Array, end: Array) -> Hinge:
    """Return what of subproblem 3 doesn't depend on the distance.

    Args:
        axis: of the turn.
        start: the point that turns.
        end: the point that stays.

    Returns:
        The angle where the points are nearest, the mean of the squares of their least and greatest distance, and half
        of what these differ by; (n,) or (1,) each.
    """
    _, a, beside = _parts(axis, start)
    _, b, _ = _parts(axis, end)
    apart = axis @ (start - end)
    squares = _dot(a, a), _dot(b, b)
    straight = np.arctan2(_dot(beside, b), _dot(a, b))
    return straight, squares[0] + squares[1] + apart * apart, 2.0 * np.sqrt(squares[0] * squares[1])


def opened(hinge: Hinge, distance: Array) -> tuple[Array, Array]:
    """Return the angle about an axis that brings a point to a distance from another: subproblem 3.

    Args:
        hinge: of the axis and both points.
        distance: wanted between them, (n,), m.

    Returns:
        Angles (2, n) of both solutions, and their strain (n,).
    """
    straight, mean, half = hinge
    cosine = (mean - distance * distance) / np.maximum(half, 1e-12)
    away = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))
    strain = np.sqrt(2.0 * np.maximum(np.abs(cosine) - 1.0 - _ROUNDING, 0.0))
    return np.array([straight + away, straight - away]), strain
