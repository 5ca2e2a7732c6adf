"""Screw motions of joints for many values at once.

The transform of a joint is a sum of constant matrices: one, one times the cosine of its value, one times the sine, and
one times the value itself (Murray, Li, Sastry: A Mathematical Introduction to Robotic Manipulation, 1994, section 2.2).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]


def constant_parts(axes: Array, points: Array, slides: Flags) -> Array:
    """Return the constant matrices that the transforms of joints are sums of.

    Args:
        axes: (joints, 3) unit vectors.
        points: (joints, 3) on the axes, m.
        slides: (joints,) which of them are prismatic: they slide along their axis instead of turning about it.

    Returns:
        (joints, 4, 4, 4): the matrices for 1, cosine, sine and value.
    """
    x, y, z = axes.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    square = cross @ cross
    parts = np.zeros((len(axes), 4, 4, 4))
    turns = parts[:, :3, :3]
    turns[..., :3] = np.stack([np.eye(3) + square, -square, cross], axis=1)
    turns[..., 3] = -(turns[..., :3] @ points[:, None, :, None])[..., 0]
    turns[:, 0, :, 3] += points
    parts[slides, :3] = 0.0
    parts[slides, 0, :3, :3] = np.eye(3)
    parts[:, 0, 3, 3] = 1.0
    parts[slides, 3, :3, 3] = axes[slides]
    return parts


def transforms(parts: Array, values: Array) -> Array:
    """Return the transforms of joints.

    Args:
        parts: (joints, 3 or 4, m, m) matrices; without that for the value where no joint slides.
        values: (joints, n), rad or m.

    Returns:
        (joints, n, m, m).
    """
    joints, terms, m, _ = parts.shape
    factors = np.empty((*values.shape, terms))
    factors[..., 0] = 1.0
    np.cos(values, out=factors[..., 1])
    np.sin(values, out=factors[..., 2])
    factors[..., 3:] = values[..., None]
    made: Array = (factors @ parts.reshape(joints, terms, m * m)).reshape(*values.shape, m, m)
    return made
