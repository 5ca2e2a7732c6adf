"""Cameras: which of a world's objects is seen at each pixel.

Frames are optical: z looks ahead, x is to the right, y is down. Links of a robot that are around the camera are its
housing, which it looks out of: they are not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.visual import Each, Shapes, shapes_of
from pycram.vision.rasterizer import Window, rasterize
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from pycram.world.object import Object
    from recorder.geometry import Pose

NEAR: Final = 0.02  # m
FAR: Final = 20.0  # m
_SKY: Final = ((0.78, 0.84, 0.92), (0.96, 0.97, 0.98))  # RGB behind everything, above and below
_HOUSING: Final = 0.005  # m that a housing may end before the lens


@dataclass(frozen=True, slots=True)
class Rendering:
    """What a camera sees.

    Attributes:
        depth: (height, width) along the camera's axis in m; inf where nothing is.
        bodies: (height, width) indices of the objects that were rendered, -1 where nothing is.
        triangles: (n, 3, 3) that were rendered, in the camera's frame, m.
        colors: (n, 3) of them, RGB 0..1.
        seen: (height, width) the number of the triangle that is seen, -1 where nothing is.
    """

    depth: NDArray[np.float64]
    bodies: NDArray[np.int64]
    triangles: NDArray[np.float64]
    colors: NDArray[np.float64]
    seen: NDArray[np.int64]

    def picture(self, up: Sequence[float]) -> NDArray[np.uint8]:
        """Return a colour image, lit from above and from the camera.

        Args:
            up: unit vector in the camera's frame that points upwards in the world.

        Returns:
            (height, width, 3) RGB.
        """
        rows = np.broadcast_to(np.linspace(*_SKY, self.seen.shape[0])[:, None], (*self.seen.shape, 3)).copy()
        shown, numbers = self.seen >= 0, np.unique(self.seen[self.seen >= 0])
        corners = self.triangles[numbers]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        normals *= -np.sign((normals * corners[:, 0]).sum(axis=1, keepdims=True))  # they face the camera
        light = 0.5 + 0.25 * normals @ np.asarray(up) + 0.35 * np.maximum(-normals[:, 2], 0.0)
        lit = np.clip(self.colors[numbers] * light[:, None], 0.0, 1.0)
        rows[shown] = lit[np.searchsorted(numbers, self.seen[shown])]
        return np.asarray(rows * 255, dtype=np.uint8)

    def before(self, other: Rendering) -> Rendering:
        """Return this picture with another one of the same camera and size: the nearer is seen at each pixel."""
        nearer = other.depth < self.depth
        return Rendering(
            np.where(nearer, other.depth, self.depth),
            np.where(nearer, other.bodies, self.bodies),
            np.concatenate([self.triangles, other.triangles]),
            np.concatenate([self.colors, other.colors]),
            np.where(nearer, other.seen + len(self.triangles), self.seen),
        )


@dataclass(frozen=True, slots=True)
class Drawable:
    """A body as a camera needs it, whether a physics engine or a recording tells where its k links are.

    Attributes:
        shapes: its links' shapes, in the links' frames.
        positions: (k, 3) of the links' frames in the world, m.
        orientations: (k, 4) of the same, xyzw.
        color: RGBA 0..1 of the whole body; None for the colours of its model.
        is_robot: whether links of it that surround the camera are the camera's housing.
    """

    shapes: Shapes
    positions: NDArray[np.float64]
    orientations: NDArray[np.float64]
    color: Sequence[float] | None
    is_robot: bool


def drawable_link(
    shapes: Shapes, at: int, pose: Pose, color: Sequence[float] | None, *, is_robot: bool = False
) -> Drawable:
    """Return the n-th link with shapes of a model, alone, at a pose in the world; its mesh is read when it is seen."""
    one = Shapes(
        (shapes.links[at],),
        Each([lambda: shapes.triangles[at]]),
        Each([lambda: shapes.colors[at]]),
        shapes.low[at : at + 1],
        shapes.high[at : at + 1],
    )
    return Drawable(one, np.array([pose[0]]), np.array([pose[1]]), color, is_robot)


def drawable(body: Object) -> Drawable:
    """Return an object of a live world, whose lock is held, as cameras need it."""
    shapes = shapes_of(body.model.path)
    frames = body.world.engine.link_frames(body.handle, shapes.links)
    return Drawable(shapes, *frames, body.color, body.is_robot)


@dataclass(frozen=True, slots=True)
class _Boxes:
    """Boxes of k links, in their frames, and where these are in the world.

    Attributes:
        low: (k, 3) lowest corners, m.
        high: (k, 3) highest corners, m.
        positions: (k, 3) of the frames, m.
        turns: (k, 3, 3) of the frames.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    positions: NDArray[np.float64]
    turns: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera in the world.

    Attributes:
        pose: position in m and orientation xyzw of its optical frame.
        right: tangent of half the horizontal field of view.
        down: tangent of half the vertical field of view.
        near: m from which on it sees.
        far: m up to which it sees.
    """

    pose: Pose
    right: float
    down: float
    near: float = NEAR
    far: float = FAR

    @property
    def window(self) -> Window:
        """The part of the image plane that it sees."""
        return Window(-self.right, -self.down, self.right, self.down)

    def to_frame(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return world points (..., 3) in the optical frame, m."""
        seen: NDArray[np.float64] = (points - np.asarray(self.pose[0])) @ geometry.to_matrix(self.pose[1])
        return seen

    def render(
        self, bodies: Sequence[Object], window: Window, size: tuple[int, int], far: float | None = None
    ) -> Rendering:
        """Render objects through a part of the image plane.

        Args:
            bodies: the objects, of one world whose lock is held; nothing else is seen.
            window: the part of the image plane.
            size: width and height in pixels.
            far: m up to which anything matters, if less than the camera sees.
        """
        return self.draw([drawable(body) for body in bodies], window, size, far)

    def draw(
        self, bodies: Sequence[Drawable], window: Window, size: tuple[int, int], far: float | None = None
    ) -> Rendering:
        """Render bodies without a physics engine; see :meth:`render` for the arguments."""
        limit = self.far if far is None else min(far, self.far)
        parts = list(self._parts(bodies, window, limit))
        owners = np.repeat([index for index, _, _ in parts], [len(part) for _, part, _ in parts]).astype(np.int64)
        triangles = np.concatenate([np.zeros((0, 3, 3)), *(part for _, part, _ in parts)])
        colors = np.concatenate([np.zeros((0, 3)), *(paint for _, _, paint in parts)])
        depth, seen = rasterize(triangles, window, size, self.near, limit)
        return Rendering(depth, np.append(owners, -1)[seen], triangles, colors, seen)

    def _parts(
        self, bodies: Sequence[Drawable], window: Window, far: float
    ) -> Iterator[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
        """Yield links that may be seen: index of the body, triangles in the camera's frame, colours."""
        models = [body.shapes for body in bodies]
        links = [(index, link) for index, shapes in enumerate(models) for link in range(len(shapes.links))]
        if not links:
            return
        boxes = _Boxes(
            low=np.concatenate([shapes.low for shapes in models]),
            high=np.concatenate([shapes.high for shapes in models]),
            positions=np.concatenate([body.positions for body in bodies]),
            turns=geometry.to_matrices(np.concatenate([body.orientations for body in bodies])),
        )
        of_robots = np.array([bodies[index].is_robot for index, _ in links])
        shown = self._shown(boxes, window, far) & ~(of_robots & self._in(boxes))
        to_camera = geometry.to_matrix(self.pose[1]).T
        for number in np.flatnonzero(shown):
            index, link = links[number]
            colors, paint = models[index].colors[link], bodies[index].color
            if paint is not None:
                colors = np.tile(paint[:3], (len(colors), 1))
            turned = models[index].triangles[link] @ (to_camera @ boxes.turns[number]).T
            yield index, turned + self.to_frame(boxes.positions[number]), colors

    def _shown(self, boxes: _Boxes, window: Window, far: float) -> NDArray[np.bool_]:
        """Return which boxes have a bounding sphere in the view frustum of a window."""
        centers = np.einsum("kij,kj->ki", boxes.turns, (boxes.low + boxes.high) / 2) + boxes.positions
        radii = np.linalg.norm(boxes.high - boxes.low, axis=1) / 2
        x, y, z = self.to_frame(centers).T
        shown = (z + radii >= self.near) & (z - radii <= far)
        sides = ((x, window.left, 1), (x, window.right, -1), (y, window.top, 1), (y, window.bottom, -1))
        for across, edge, sign in sides:
            shown &= sign * (across - edge * z) / np.hypot(1.0, edge) >= -radii
        return np.asarray(shown)

    def _in(self, boxes: _Boxes) -> NDArray[np.bool_]:
        """Return which boxes are around the camera."""
        eye = np.einsum("kji,kj->ki", boxes.turns, np.asarray(self.pose[0]) - boxes.positions)
        return np.asarray(((eye >= boxes.low - _HOUSING) & (eye <= boxes.high + _HOUSING)).all(axis=1))
