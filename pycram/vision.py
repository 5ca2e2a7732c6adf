"""Cameras, and a renderer that returns the depth and the object at each pixel.

Frames are optical: z points ahead, x to the right, y down. PyBullet's own renderer hangs if a vertex is in the plane of
the camera, and draws wrong lines. This renderer clips triangles at the near plane first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pycram.models.shapes import Shapes, shapes_of
from recorder import geometry
from recorder.geometry import Array, Flags, Pose, Vector

if TYPE_CHECKING:
    from pycram.world.object import Object

Integers: TypeAlias = NDArray[np.int64]  # an array of indices or pixel coordinates, of any shape
Pixels: TypeAlias = NDArray[np.uint8]  # an RGB image (height, width, 3)

NEAR: Final = 0.02  # nearest visible distance in m
FAR: Final = 20.0  # farthest visible distance in m
_SKY: Final = ((0.78, 0.84, 0.92), (0.96, 0.97, 0.98))  # RGB of the background at the top and at the bottom
_HOUSING: Final = 0.005  # largest distance in m between a camera's lens and its housing
_LARGE: Final = 400  # maximum number of pixels in a small triangle's bounds; larger triangles are drawn alone
_BAND: Final = 32  # number of rows of a large triangle that are drawn together; more rows test more outer pixels
_BATCH: Final = 1 << 16  # number of pixels of small triangles that are drawn together; larger batches need more memory


@dataclass(frozen=True, slots=True)
class Rendering:
    """A rendered picture."""

    depth: Array  # (height, width) distance in m along the camera's axis; inf without an object
    bodies: Integers  # (height, width) indices of the rendered objects; -1 without an object
    triangles: Array  # (n, 3, 3) rendered triangles in the camera's frame, m
    colors: Array  # (n, 3) colours of the triangles, RGB 0..1
    seen: Integers  # (height, width) index of the triangle at each pixel; -1 without a triangle
    links: Sequence[str]  # names of the rendered links
    numbers: Integers  # (n,) index of the link of each triangle

    def picture(self, up: Sequence[float]) -> Pixels:
        """Return an RGB image (height, width, 3), lit from the camera and from above (``up`` in the camera's frame)."""
        image = self._lit(up)[self.seen]
        empty = self.seen < 0
        image[empty] = np.asarray(np.linspace(*_SKY, len(image)) * 255, dtype=np.uint8)[np.nonzero(empty)[0]]
        return image

    def picture_before(self, behind: Pixels, depth: Array, up: Sequence[float]) -> Pixels:
        """Return the colour image ``behind``, which has the ``depth`` in m, with the nearer pixels of this picture."""
        nearer = self.depth < depth
        image = behind.copy()
        image[nearer] = self._lit(up)[self.seen[nearer]]
        return image

    def _lit(self, up: Sequence[float]) -> Pixels:
        """Return the colours of the triangles, RGB; only the colours of visible triangles are computed."""
        used = np.zeros(len(self.triangles) + 1, dtype=bool)
        used[self.seen] = True
        used[-1] = False  # the sky
        corners = self.triangles[used[:-1]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        normals *= -np.sign((normals * corners[:, 0]).sum(axis=1, keepdims=True))  # so normals point to the camera
        light = 0.5 + 0.25 * normals @ np.asarray(up) + 0.35 * np.maximum(-normals[:, 2], 0.0)
        lit = np.zeros((len(used), 3), dtype=np.uint8)
        lit[used] = np.clip(self.colors[used[:-1]] * light[:, None], 0.0, 1.0) * 255
        return lit

    def before(self, other: Rendering) -> Rendering:
        """Return this picture merged with another picture of the same camera and size; nearer objects hide others."""
        nearer = other.depth < self.depth
        return Rendering(
            np.where(nearer, other.depth, self.depth),
            np.where(nearer, other.bodies, self.bodies),
            np.concatenate([self.triangles, other.triangles]),
            np.concatenate([self.colors, other.colors]),
            np.where(nearer, other.seen + len(self.triangles), self.seen),
            [*self.links, *other.links],
            np.concatenate([self.numbers, other.numbers + len(self.links)]),
        )


class Drawable(NamedTuple):
    """A body with k links to render, from a physics engine or from a recording."""

    shapes: Shapes  # shapes of the links, in their frames
    positions: Sequence[Sequence[float]]  # (k, 3) positions of the links' frames in the world, m
    orientations: Sequence[Sequence[float]]  # (k, 4) orientations of the links' frames in the world, xyzw
    color: Sequence[float] | None  # RGBA 0..1 of the whole body; None for the model's colours
    is_robot: bool  # whether links around the camera are its housing, which isn't rendered


def drawable_link(
    shapes: Shapes, at: int, pose: Pose, color: Sequence[float] | None, *, is_robot: bool = False
) -> Drawable:
    """Return a link to render: the link with shapes at the index ``at``. Rendering the link reads its mesh."""
    one = Shapes(
        (shapes.links[at],),
        lambda _: shapes.triangles(at),
        lambda _: shapes.colors(at),
        shapes.low[at : at + 1],
        shapes.high[at : at + 1],
    )
    return Drawable(one, pose[:1], pose[1:], color, is_robot)


def drawable(body: Object) -> Drawable:
    """Return an object of a live world to render; the caller holds the world's lock."""
    shapes = shapes_of(body.model.path)
    engine, handle = body.world.engine, body.handle
    if len(handle.links) == 1:  # arrays for each of many objects would take most of the time
        at, turn = engine.snapshot(handle).pose
        return Drawable(shapes, [at] * len(shapes.links), [turn] * len(shapes.links), body.color, body.is_robot)
    positions, orientations = engine.link_frames(handle, shapes.links)
    return Drawable(shapes, positions.tolist(), orientations.tolist(), body.color, body.is_robot)


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera in the world."""

    pose: Pose  # position in m and orientation xyzw of the optical frame
    right: float  # tangent of half the horizontal field of view
    down: float  # tangent of half the vertical field of view
    near: float = NEAR  # nearest visible distance in m
    far: float = FAR  # farthest visible distance in m

    @property
    def window(self) -> Window:
        """The part of the image plane that the camera's picture shows."""
        return Window(-self.right, -self.down, self.right, self.down)

    @property
    def up(self) -> Vector:
        """The upward direction of the world, in the optical frame."""
        return geometry.rotate(geometry.conjugate(self.pose[1]), (0.0, 0.0, 1.0))

    def to_frame(self, points: Array) -> Array:
        """Return world points (..., 3) in the optical frame, m."""
        seen: Array = (points - np.asarray(self.pose[0])) @ geometry.to_matrix(self.pose[1])
        return seen

    def render(
        self, bodies: Sequence[Object], window: Window, size: tuple[int, int], far: float | None = None
    ) -> Rendering:
        """Render objects through a part of the image plane.

        Args:
            bodies: the objects to render, of one world. The caller holds the world's lock.
            size: width and height in pixels.
            far: largest relevant distance in m, if it is less than the camera's.
        """
        return self.draw([drawable(body) for body in bodies], window, size, far)

    def draw(
        self, bodies: Sequence[Drawable], window: Window, size: tuple[int, int], far: float | None = None
    ) -> Rendering:
        """Render bodies without a physics engine; see :meth:`render` for the arguments."""
        limit = self.far if far is None else min(far, self.far)
        parts = list(self._parts(bodies, window, limit))
        numbers = np.repeat(np.arange(len(parts)), [len(part) for _, _, part, _ in parts])
        owners = np.array([index for index, _, _, _ in parts], dtype=np.int64)[numbers]
        triangles = np.concatenate([np.zeros((0, 3, 3)), *(part for _, _, part, _ in parts)])
        colors = np.concatenate([np.zeros((0, 3)), *(paint for _, _, _, paint in parts)])
        depth, seen = rasterize(triangles, window, size, self.near, limit)
        names = [link for _, link, _, _ in parts]
        return Rendering(depth, np.append(owners, -1)[seen], triangles, colors, seen, names, numbers)

    def _parts(self, bodies: Sequence[Drawable], window: Window, far: float) -> Iterator[tuple[int, str, Array, Array]]:
        """Yield links that may be visible: index of the body, name, triangles in the camera's frame, colours."""
        models = [body.shapes for body in bodies]
        links = [(index, link) for index, shapes in enumerate(models) for link in range(len(shapes.links))]
        if not links:
            return
        low = np.concatenate([shapes.low for shapes in models])  # lowest corners of the links, in the links' frames
        high = np.concatenate([shapes.high for shapes in models])
        positions = np.array([at for body in bodies for at in body.positions])
        turns = geometry.to_matrices(np.array([turn for body in bodies for turn in body.orientations]))
        of_robots = np.array([bodies[index].is_robot for index, _ in links])
        eye = np.einsum("kji,kj->ki", turns, np.asarray(self.pose[0]) - positions)
        around = ((eye >= low - _HOUSING) & (eye <= high + _HOUSING)).all(axis=1)
        centers = np.einsum("kij,kj->ki", turns, (low + high) / 2) + positions
        shown = self._shown(centers, np.linalg.norm(high - low, axis=1) / 2, window, far) & ~(of_robots & around)
        to_camera = geometry.to_matrix(self.pose[1]).T
        for number in np.flatnonzero(shown):
            index, link = links[number]
            colors, paint = models[index].colors(link), bodies[index].color
            if paint is not None:
                colors = np.tile(paint[:3], (len(colors), 1))
            turned = models[index].triangles(link) @ (to_camera @ turns[number]).T
            yield index, models[index].links[link], turned + self.to_frame(positions[number]), colors

    def _shown(self, centers: Array, radii: Array, window: Window, far: float) -> Flags:
        """Return whether each sphere is in the view frustum of a window."""
        x, y, z = self.to_frame(centers).T
        shown = (z + radii >= self.near) & (z - radii <= far)
        sides = ((x, window.left, 1), (x, window.right, -1), (y, window.top, 1), (y, window.bottom, -1))
        for across, edge, sign in sides:
            shown &= sign * (across - edge * z) / np.hypot(1.0, edge) >= -radii
        return np.asarray(shown)


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the image plane. Its edges are tangents: x to the right, y down."""

    left: float
    top: float
    right: float
    bottom: float


def rasterize(
    triangles: Array, window: Window, size: tuple[int, int], near: float, far: float
) -> tuple[Array, Integers]:
    """Return the depth and the triangle at each pixel's center. Both sides of triangles are visible.

    Args:
        triangles: (n, 3, 3) corners in the camera's frame, m.
        size: width and height in pixels.

    Returns:
        (height, width) depth along z in m, inf without a triangle; (height, width) index of the triangle, -1 for none.
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
    shown = shown[np.isfinite(planes[shown]).all(axis=(1, 2))]  # triangles that are seen edge-on aren't visible
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
    for part, columns, rows in _covered(shown[pixels[shown] <= _LARGE], left, right, top, bottom):
        for corner in range(3):  # the test at the first corner excludes most pixels
            kept = _value(planes[:, corner], part, columns, rows) >= 0
            part, columns, rows = part[kept], columns[kept], rows[kept]  # noqa: PLW2901
        close = _value(planes[:, 3], part, columns, rows)
        before = nearness[rows, columns]
        np.maximum.at(nearness, (rows, columns), close)
        first = (close > before) & (nearness[rows, columns] == close)
        seen[rows[first], columns[first]] = numbers[part[first]]
    return np.where(seen >= 0, 1.0 / nearness, np.inf), seen


def _value(factors: Array, part: Integers, columns: Integers, rows: Integers) -> Array:
    """Return the value of a triangle's plane at each pixel; ``part`` has the index of the pixel's triangle."""
    a, b, c = factors.T
    values: Array = a[part] * columns + b[part] * rows + c[part]
    return values


def _bounds(axis: Array, limit: int) -> tuple[Integers, Integers]:
    """Return the first pixel along an axis whose center may be in each triangle, and the pixels' end."""
    a, b, c = axis.T  # the minimum of three columns is much faster than the minimum along rows
    low = np.ceil(np.clip(np.minimum(np.minimum(a, b), c), 0, limit)).astype(np.int64)
    return low, np.floor(np.clip(np.maximum(np.maximum(a, b), c), -1, limit - 1)).astype(np.int64) + 1


def _bands(
    planes: Array, left: Integers, right: Integers, top: Integers, bottom: Integers
) -> Iterator[tuple[int, int, int, int, int]]:
    """Yield parts of large triangles: index of the triangle, first row, end of rows, first column, end of columns."""
    counts = -(-(bottom - top) // _BAND)
    owner = np.repeat(np.arange(len(counts)), counts)
    low = top[owner] + _BAND * (np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts))
    high = np.minimum(low + _BAND, bottom[owner])
    a, b, c = planes[owner, :3].transpose(2, 0, 1)  # on an edge, the value a * column + b * row + c is 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([-(b * row[:, None] + c) / a for row in (low, high - 1)])
        slack = 1 + 1e-12 * (np.abs(b) * high[:, None] + np.abs(c)) / np.abs(a)  # possible rounding error
        first = np.where(a > 0, ends.min(axis=0) - slack, -np.inf).max(axis=1, initial=-np.inf)
        last = np.where(a < 0, ends.max(axis=0) + slack, np.inf).min(axis=1, initial=np.inf)
    start = np.clip(np.floor(first), left[owner], right[owner]).astype(np.int64)
    end = np.clip(np.ceil(last) + 1, left[owner], right[owner]).astype(np.int64)
    kept = start < end
    yield from zip(*(each[kept].tolist() for each in (owner, low, high, start, end)), strict=True)


def _planes(u: Array, v: Array, inverse: Array) -> Array:
    """Return (n, 4, 3) factors of column, row and 1: three planes for the corners' weights, one for 1 / depth."""
    u1, v1, u2, v2 = np.roll(u, -1, axis=1), np.roll(v, -1, axis=1), np.roll(u, 1, axis=1), np.roll(v, 1, axis=1)
    edges = np.stack([v1 - v2, u2 - u1, u1 * v2 - u2 * v1], axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = edges / edges[:, :, 2].sum(axis=1)[:, None, None]  # infinite for triangles seen edge-on
        nearness = (weights * inverse[:, :, None]).sum(axis=1, keepdims=True)
    return np.concatenate([weights, nearness], axis=1)


def _clip(triangles: Array, near: float) -> tuple[Array, Integers]:
    """Return the parts of triangles behind the near plane, as triangles, with the indices of the original triangles."""
    beyond = triangles[:, :, 2] > near
    count = beyond.sum(axis=1)
    numbers = np.arange(len(triangles))
    all_three, one, two = (numbers[count == wanted] for wanted in (3, 1, 2))
    tip, left, right = _odd_first(triangles[one], beyond[one])  # the tip is behind the near plane
    lost, first, second = _odd_first(triangles[two], ~beyond[two])  # the tip is in front of the near plane
    on_first, on_second = _at(first, lost, near), _at(second, lost, near)
    parts = [
        triangles[all_three],
        np.stack([tip, _at(tip, left, near), _at(tip, right, near)], axis=1),
        np.stack([on_first, first, second], axis=1),
        np.stack([on_first, second, on_second], axis=1),
    ]
    return np.concatenate(parts), np.concatenate([all_three, one, two, two])


def _odd_first(triangles: Array, odd: Flags) -> tuple[Array, ...]:
    """Return the corners of triangles; the corner that differs in ``odd`` comes first."""
    rows = np.arange(len(triangles))
    start = odd.argmax(axis=1)
    return tuple(triangles[rows, (start + turn) % 3] for turn in range(3))


def _at(a: Array, b: Array, near: float) -> Array:
    """Return the points at which edges cross the near plane."""
    return a + ((near - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None] * (b - a)


def _covered(
    shown: Integers, left: Integers, right: Integers, top: Integers, bottom: Integers
) -> Iterator[tuple[Integers, Integers, Integers]]:
    """Yield batches of pixels in the bounds of triangles: indices of triangles, columns, rows."""
    wide = right - left
    counts = wide[shown] * (bottom - top)[shown]
    for group in np.split(np.arange(len(shown)), np.flatnonzero(np.diff(np.cumsum(counts) // _BATCH, prepend=0))):
        part = np.repeat(shown[group], counts[group])
        offset = np.arange(len(part)) - np.repeat(np.cumsum(counts[group]) - counts[group], counts[group])
        yield part, left[part] + offset % wide[part], top[part] + offset // wide[part]
