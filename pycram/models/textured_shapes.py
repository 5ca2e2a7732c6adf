"""Boxes, cylinders and spheres that a URDF's material covers with a texture: their triangles by colour, as of meshes.

A texture is upright on each face of a box, goes once around a cylinder, whose ends show a disc of it, and around a
sphere from pole to pole.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models import parts, texture

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_SECTIONS: Final = 32  # around a cylinder or sphere
_AXES: Final = np.eye(3)


def cover(kind: str, size: Sequence[float], picture: Path) -> list[tuple[str, bytes, parts.Rgba]]:
    """Return file name, content and colour RGBA 0..1 of each part of a shape; nothing if the picture can't be read.

    Args:
        kind: "box", "cylinder" or "sphere".
        size: The box's edges; radius and length of the cylinder; radius of the sphere, m.
        picture: The texture.
    """
    image = parts.read_image(picture)
    if image is None:
        return []
    triangles, uv = {"box": _box, "cylinder": _cylinder, "sphere": _sphere}[kind](size)
    edges = triangles[:, 1:] - triangles[:, :1]
    solid = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > 1e-12 * np.ptp(triangles)  # not so at poles
    baked = texture.bake(triangles[solid], uv[solid], image)
    return [(f"{picture.stem}-{kind}-{n}.stl", parts.stl(some), rgba) for n, (some, rgba) in enumerate(baked)]


def _box(size: Sequence[float]) -> tuple[Array, Array]:
    """Return triangles (n, 3, 3), and where their corners are in the texture (n, 3, 2)."""
    faces = []
    for axis in range(3):
        for side in (1.0, -1.0):
            out, up = side * _AXES[axis], _AXES[1 if axis == 2 else 2]
            right = np.cross(up, out)
            faces.append([out + u * right + v * up for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    corners = np.array(faces) * np.array(size) / 2
    return _halves(corners), _halves(np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), (6, 1, 1)))


def _cylinder(size: Sequence[float]) -> tuple[Array, Array]:
    radius, length = size
    around = np.linspace(0.0, 1.0, _SECTIONS + 1)
    ring = np.column_stack([np.cos(2 * math.pi * around), np.sin(2 * math.pi * around)])
    ends = [np.column_stack([ring * radius, np.full(len(ring), z)]) for z in (-length / 2, length / 2)]
    triangles, uv = _strip(ends, np.array([0.0, 1.0]), around)
    for number, end in enumerate(ends):
        middle = np.array([0.0, 0.0, end[0, 2]])
        disc = np.stack([np.broadcast_to(middle, end[:-1].shape), end[:-1], end[1:]], axis=1)
        triangles.append(disc if number else disc[:, ::-1])
        uv.append(triangles[-1][:, :, :2] / (2 * radius) + 0.5)
    return np.concatenate(triangles), np.concatenate(uv)


def _sphere(size: Sequence[float]) -> tuple[Array, Array]:
    (radius,) = size
    around, upwards = np.linspace(0.0, 1.0, _SECTIONS + 1), np.linspace(0.0, 1.0, _SECTIONS // 2 + 1)
    rings = []
    for height in upwards:
        angle = math.pi * (height - 0.5)
        ring = np.column_stack([np.cos(2 * math.pi * around), np.sin(2 * math.pi * around)]) * math.cos(angle)
        rings.append(radius * np.column_stack([ring, np.full(len(ring), math.sin(angle))]))
    triangles, uv = _strip(rings, upwards, around)
    return np.concatenate(triangles), np.concatenate(uv)


def _strip(rings: Sequence[Array], upwards: Array, around: Array) -> tuple[list[Array], list[Array]]:
    """Return triangles between rings (k, 3), one above the other, and where their corners are in the texture."""
    triangles, uv = [], []
    for (low, high), (v, w) in zip(pairwise(rings), pairwise(upwards), strict=True):
        triangles.append(_halves(np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)))
        corners = [np.column_stack([u, np.full(len(u), h)]) for u, h in ((around, v), (around, w))]
        uv.append(_halves(np.stack([corners[0][:-1], corners[0][1:], corners[1][1:], corners[1][:-1]], axis=1)))
    return triangles, uv


def _halves(squares: Array) -> Array:
    """Return the triangles (2 n, 3, k) of squares (n, 4, k)."""
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
