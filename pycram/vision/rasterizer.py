"""A rasteriser: depth and the triangle that is seen, at each pixel.

PyBullet's own renderer never returns when a vertex lies in the plane of the camera, and draws what is nearer than the
near plane as lines across the picture. Here triangles are clipped at the near plane first: nothing is divided by zero.

Camera frames are optical: z looks ahead, x is to the right, y is down. A window is a part of the image plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

_LARGE: Final = 400  # pixels of its bounds from which on a triangle is drawn by itself
_BAND: Final = 32  # rows of such a one that are drawn together: most of the bounds of a slanted one is left out
_BATCH: Final = 1 << 16  # pixels of smaller ones that are drawn together; more would only take memory


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the image plane, as tangents: x to the right, y down."""

    left: float
    top: float
    right: float
    bottom: float


def rasterize(
    triangles: NDArray[np.float64], window: Window, size: tuple[int, int], near: float, far: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return which triangle is seen at each pixel's center, from either side.

    Args:
        triangles: (n, 3, 3), corners in the camera's frame, m.
        window: what the picture shows.
        size: width and height in pixels.
        near: m from which on anything is seen.
        far: m up to which it is.

    Returns:
        (height, width) depth along z in m, inf where nothing is; (height, width) numbers of the triangles, -1 for none.
    """
    width, height = size
    nearness = np.full((height, width), 1.0 / far)  # 1 / depth
    seen = np.full((height, width), -1, dtype=np.int64)
    corners, numbers = _clip(triangles, near)
    inverse = 1.0 / corners[:, :, 2]
    u = (corners[:, :, 0] * inverse - window.left) * (width / (window.right - window.left)) - 0.5
    v = (corners[:, :, 1] * inverse - window.top) * (height / (window.bottom - window.top)) - 0.5
    left, right = _bounds(u, width)
    top, bottom = _bounds(v, height)
    shown = np.flatnonzero((left < right) & (top < bottom) & (inverse.max(axis=1) >= 1.0 / far))
    planes = np.zeros((len(u), 4, 3))
    planes[shown] = _planes(u[shown], v[shown], inverse[shown])
    shown = shown[np.isfinite(planes[shown]).all(axis=(1, 2))]  # of an edge-on triangle nothing is seen
    pixels = (right - left) * (bottom - top)
    large = shown[pixels[shown] > _LARGE]
    for number, low, high, start, end in _bands(planes[large], left[large], right[large], top[large], bottom[large]):
        area = slice(low, high), slice(start, end)
        a, b, c = planes[large[number]].T[:, :, None]
        across, down = a * np.arange(start, end) + c, b * np.arange(low, high)
        close = across[3] + down[3][:, None]
        better = close > nearness[area]
        if better.any():
            better &= (across[:3, None, :] + down[:3, :, None]).min(axis=0) >= 0
            nearness[area][better] = close[better]
            seen[area][better] = numbers[large[number]]
    small = shown[pixels[shown] <= _LARGE]
    for part, columns, rows in _covered(small, left, right, top, bottom):
        for corner in range(3):  # one after the other: most pixels are out of the first
            kept = _value(planes[:, corner], part, columns, rows) >= 0
            part, columns, rows = part[kept], columns[kept], rows[kept]  # noqa: PLW2901
        close = _value(planes[:, 3], part, columns, rows)
        before = nearness[rows, columns]
        np.maximum.at(nearness, (rows, columns), close)
        first = (close > before) & (nearness[rows, columns] == close)
        seen[rows[first], columns[first]] = numbers[part[first]]
    return np.where(seen >= 0, 1.0 / nearness, np.inf), seen


def _value(
    factors: NDArray[np.float64], part: NDArray[np.int64], columns: NDArray[np.int64], rows: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the values of planes of triangles (n, 3) at pixels, each for one of the triangles."""
    a, b, c = factors.T
    values: NDArray[np.float64] = a[part] * columns + b[part] * rows + c[part]
    return values


def _bounds(axis: NDArray[np.float64], limit: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first pixel along an axis whose center may lie in each triangle, and the one after the last."""
    low = np.ceil(np.clip(axis.min(axis=1), 0, limit)).astype(np.int64)
    high = np.floor(np.clip(axis.max(axis=1), -1, limit - 1)).astype(np.int64) + 1
    return low, high


def _bands(
    planes: NDArray[np.float64],
    left: NDArray[np.int64],
    right: NDArray[np.int64],
    top: NDArray[np.int64],
    bottom: NDArray[np.int64],
) -> Iterator[tuple[int, int, int, int, int]]:
    """Yield bands of rows of triangles and the columns that they cover: number, rows, columns, each end excluded."""
    counts = -(-(bottom - top) // _BAND)
    owner = np.repeat(np.arange(len(counts)), counts)
    low = top[owner] + _BAND * (np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts))
    high = np.minimum(low + _BAND, bottom[owner])
    a, b, c = planes[owner, :3].transpose(2, 0, 1)  # an edge is where a * column + b * row + c is 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([-(b * row[:, None] + c) / a for row in (low, high - 1)])
        slack = 1 + 1e-12 * (np.abs(b) * high[:, None] + np.abs(c)) / np.abs(a)  # so much these may be wrong by
        first = np.where(a > 0, ends.min(axis=0) - slack, -np.inf).max(axis=1, initial=-np.inf)
        last = np.where(a < 0, ends.max(axis=0) + slack, np.inf).min(axis=1, initial=np.inf)
    start = np.clip(np.floor(first), left[owner], right[owner]).astype(np.int64)
    end = np.clip(np.ceil(last) + 1, left[owner], right[owner]).astype(np.int64)
    kept = start < end
    yield from zip(*(each[kept].tolist() for each in (owner, low, high, start, end)), strict=True)


def _planes(u: NDArray[np.float64], v: NDArray[np.float64], inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return factors (n, 4, 3) of column, row and 1: weights of the corners, and 1 / depth, linear in the image."""
    u1, v1, u2, v2 = np.roll(u, -1, axis=1), np.roll(v, -1, axis=1), np.roll(u, 1, axis=1), np.roll(v, 1, axis=1)
    edges = np.stack([v1 - v2, u2 - u1, u1 * v2 - u2 * v1], axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = edges / edges[:, :, 2].sum(axis=1)[:, None, None]  # not finite for an edge-on triangle
        nearness = (weights * inverse[:, :, None]).sum(axis=1, keepdims=True)
    return np.concatenate([weights, nearness], axis=1)


def _clip(triangles: NDArray[np.float64], near: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return what of triangles is beyond the near plane, as triangles, and the numbers of those that they come from."""
    beyond = triangles[:, :, 2] > near
    count = beyond.sum(axis=1)
    numbers = np.arange(len(triangles))
    all_three, one, two = (numbers[count == wanted] for wanted in (3, 1, 2))
    tip, left, right = _odd_first(triangles[one], beyond[one])  # the tip is beyond
    lost, first, second = _odd_first(triangles[two], ~beyond[two])  # the tip is not
    on_first, on_second = _at(first, lost, near), _at(second, lost, near)
    parts = [
        triangles[all_three],
        np.stack([tip, _at(tip, left, near), _at(tip, right, near)], axis=1),
        np.stack([on_first, first, second], axis=1),
        np.stack([on_first, second, on_second], axis=1),
    ]
    return np.concatenate(parts), np.concatenate([all_three, one, two, two])


def _odd_first(triangles: NDArray[np.float64], odd: NDArray[np.bool_]) -> tuple[NDArray[np.float64], ...]:
    """Return the corners of triangles, the odd one first."""
    rows = np.arange(len(triangles))
    start = odd.argmax(axis=1)
    return tuple(triangles[rows, (start + turn) % 3] for turn in range(3))


def _at(a: NDArray[np.float64], b: NDArray[np.float64], near: float) -> NDArray[np.float64]:
    """Return where edges that cross the near plane cross it."""
    share = (near - a[:, 2]) / (b[:, 2] - a[:, 2])
    return a + share[:, None] * (b - a)


def _covered(
    shown: NDArray[np.int64],
    left: NDArray[np.int64],
    right: NDArray[np.int64],
    top: NDArray[np.int64],
    bottom: NDArray[np.int64],
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Yield pixels in the bounds of triangles: numbers of triangles, columns, rows; not too many at once."""
    wide = right - left
    counts = wide[shown] * (bottom - top)[shown]
    cuts = np.flatnonzero(np.diff(np.cumsum(counts) // _BATCH, prepend=0))
    for group in np.split(np.arange(len(shown)), cuts):
        part = np.repeat(shown[group], counts[group])
        begin = np.cumsum(counts[group]) - counts[group]
        offset = np.arange(len(part)) - np.repeat(begin, counts[group])
        yield part, left[part] + offset % wide[part], top[part] + offset // wide[part]
