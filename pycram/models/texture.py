"""Textures become colours of triangles, because the engine and the viewers support one colour per shape.

A texture is reduced to a palette, and triangles are divided until each triangle has about one colour. A box shows the
texture upright on each face. A cylinder shows the texture once around its side, and a disc of the texture on both ends.
A sphere shows the texture once around, from pole to pole.
"""

from __future__ import annotations

import math
import warnings
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from recorder.packages import LazyModule, needed
from recorder.tracing.call_stack import call_site

if TYPE_CHECKING:
    import io
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from PIL import Image

    from recorder.geometry import Array

    Rgba = tuple[float, float, float, float]
else:
    with needed("executor"):
        Image = LazyModule("PIL.Image")

_COLORS: Final = 8  # number of colours in the palette; each colour becomes a shape
_SPOT: Final = 1 / 48  # maximum share of the texture's width that a triangle covers
_MAX_TRIANGLES: Final = 20_000
_MAX_SIDE: Final = 256  # maximum size of an image in pixels; larger images are reduced
_SECTIONS: Final = 32  # number of sides of approximated cylinders and spheres
_AXES: Final = np.eye(3)


class MissingTexture(UserWarning):
    """A model names a texture that doesn't exist; the shapes have the colour of the material, or are grey."""


@cache
def warn_of_missing(file: Path, name: str) -> None:
    """Warn, once per process, about a missing texture, because many published models name missing textures."""
    text = f"{file}: the texture {name} doesn't exist; shapes are shown without a texture"
    warnings.warn_explicit(text, MissingTexture, *call_site())


def read_image(source: Path | io.BytesIO) -> Image.Image | None:
    """Return a texture; None if the file doesn't exist or isn't an image."""
    try:
        image = Image.open(source)
        image.load()
    except OSError:
        return None
    return image


def mean(image: Image.Image) -> Rgba:
    """Return the mean colour of an image, for triangles without texture coordinates."""
    red, green, blue = np.asarray(image.convert("RGB"), dtype=np.float64).reshape(-1, 3).mean(axis=0) / 255
    return float(red), float(green), float(blue), 1.0


def bake(triangles: Array, uv: Array, image: Image.Image) -> Iterator[tuple[Array, Rgba]]:
    """Yield, for each visible colour, its triangles (m, 3, 3) and its RGBA 0..1.

    The texture coordinates ``uv`` (n, 3, 2) of the corners start at the lower left; outside of 0..1 the texture
    repeats.
    """
    small = image.reduce(max(1, max(image.size) // _MAX_SIDE))
    reduced = small.convert("RGB").quantize(_COLORS, Image.Quantize.FASTOCTREE)
    palette = np.array(reduced.getpalette(), dtype=np.float64).reshape(-1, 3) / 255
    pixels = np.asarray(reduced)
    triangles, uv = _divide(triangles, uv)
    middle = uv.mean(axis=1) % 1.0
    height, width = pixels.shape
    columns = np.minimum((middle[:, 0] * width).astype(np.intp), width - 1)
    numbers = pixels[np.minimum(((1.0 - middle[:, 1]) * height).astype(np.intp), height - 1), columns]
    for number in np.unique(numbers):
        red, green, blue = palette[number].tolist()
        yield triangles[numbers == number], (red, green, blue, 1.0)


def _divide(triangles: Array, uv: Array) -> tuple[Array, Array]:
    """Divide large triangles into four, until all are small or there are ``_MAX_TRIANGLES``."""
    corners = np.concatenate([triangles, uv], axis=2)
    while True:
        large = np.ptp(corners[:, :, 3:], axis=1).max(axis=1) > _SPOT
        if not large.any() or len(corners) + 3 * large.sum() > _MAX_TRIANGLES:
            return corners[:, :, :3], corners[:, :, 3:]
        a, b, c = np.moveaxis(corners[large], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [np.stack(each, axis=1) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        corners = np.concatenate([corners[~large], *quarters])


def cover_shape(kind: str, size: Sequence[float], picture: Path) -> list[tuple[Array, Rgba]]:
    """Return the triangles (m, 3, 3) of each colour of a shape, with the colour; [] without a readable image.

    ``size`` has the edges of a "box", the radius and length of a "cylinder", or the radius of a "sphere", m.
    """
    image = read_image(picture)
    if image is None:
        return []
    triangles, uv = {"box": _box, "cylinder": _cylinder, "sphere": _sphere}[kind](size)
    edges = triangles[:, 1:] - triangles[:, :1]
    # some triangles at poles have no area
    solid = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > 1e-12 * np.ptp(triangles)
    return list(bake(triangles[solid], uv[solid], image))


def _box(size: Sequence[float]) -> tuple[Array, Array]:
    """Return triangles (n, 3, 3) and texture coordinates of their corners (n, 3, 2)."""
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
        disc = np.stack([np.broadcast_to(np.array([0.0, 0.0, end[0, 2]]), end[:-1].shape), end[:-1], end[1:]], axis=1)
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
    """Return triangles between stacked rings (k, 3), and texture coordinates of their corners."""
    triangles, uv = [], []
    for (low, high), (v, w) in zip(pairwise(rings), pairwise(upwards), strict=True):
        triangles.append(_halves(np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)))
        corners = [np.column_stack([u, np.full(len(u), h)]) for u, h in ((around, v), (around, w))]
        uv.append(_halves(np.stack([corners[0][:-1], corners[0][1:], corners[1][1:], corners[1][:-1]], axis=1)))
    return triangles, uv


def _halves(squares: Array) -> Array:
    """Return the triangles (2 n, 3, k) of squares (n, 4, k)."""
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
