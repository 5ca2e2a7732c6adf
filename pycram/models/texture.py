"""Textures as colours of triangles: what draws models here, and the engine, have one colour a shape.

A texture is reduced to a palette, and triangles on which it changes are divided until each shows about one spot of it.
"""

from __future__ import annotations

import warnings
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.lazy_module import LazyModule
from recorder.packages import needed
from recorder.tracing.call_stack import call_site

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray
    from PIL import Image

    Array = NDArray[np.float64]
else:
    with needed("executor"):
        Image = LazyModule("PIL.Image")

_COLORS: Final = 8  # of a palette; each is a shape of its own
_SPOT: Final = 1 / 48  # of the texture's width that a triangle may span
_MAX_TRIANGLES: Final = 20_000
_MAX_SIDE: Final = 256  # pixels to which larger images are reduced


class MissingTexture(UserWarning):
    """A model names a texture that isn't there: what it should cover is shown in its material's colour, or in grey."""


@cache
def warn_of_missing(file: Path, name: str) -> None:
    """Warn once in a process that a file names a texture that isn't there; many published models do."""
    text = f"{file}: its texture {name} doesn't exist; what it should cover is shown without"
    warnings.warn_explicit(text, MissingTexture, *call_site())


def bake(triangles: Array, uv: Array, image: Image.Image) -> Iterator[tuple[Array, tuple[float, float, float, float]]]:
    """Yield triangles (m, 3, 3) with their colour RGBA 0..1, one for each colour that is seen.

    Args:
        triangles: (n, 3, 3) corners.
        uv: (n, 3, 2) of these in the texture, from its lower left corner; it repeats outside of 0..1.
        image: The texture.
    """
    reduced = (
        image.reduce(max(1, max(image.size) // _MAX_SIDE)).convert("RGB").quantize(_COLORS, Image.Quantize.FASTOCTREE)
    )
    palette = np.array(reduced.getpalette(), dtype=np.float64).reshape(-1, 3) / 255
    pixels = np.asarray(reduced)
    triangles, uv = _divide(triangles, uv)
    middle = uv.mean(axis=1) % 1.0
    height, width = pixels.shape
    columns = np.minimum((middle[:, 0] * width).astype(np.intp), width - 1)
    rows = np.minimum(((1.0 - middle[:, 1]) * height).astype(np.intp), height - 1)
    numbers = pixels[rows, columns]
    for number in np.unique(numbers):
        red, green, blue = palette[number].tolist()
        yield triangles[numbers == number], (red, green, blue, 1.0)


def _divide(triangles: Array, uv: Array) -> tuple[Array, Array]:
    """Divide triangles that span much of the texture into four each, until none does or they are many."""
    corners = np.concatenate([triangles, uv], axis=2)
    while True:
        large = np.ptp(corners[:, :, 3:], axis=1).max(axis=1) > _SPOT
        if not large.any() or len(corners) + 3 * large.sum() > _MAX_TRIANGLES:
            return corners[:, :, :3], corners[:, :, 3:]
        a, b, c = np.moveaxis(corners[large], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [np.stack(each, axis=1) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        corners = np.concatenate([corners[~large], *quarters])
