"""A solid is a closed triangle mesh, made from a few numbers.

Each function returns a watertight mesh whose faces point outwards (positive volume). Lengths are in metres. A ring is a
closed polygon whose points ``i`` and ``-1 - i`` face each other, so a strip of quads between these points fills the
ring.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Points: TypeAlias = NDArray[np.float64]
Faces: TypeAlias = NDArray[np.int64]
Span: TypeAlias = tuple[float, float]
Profile: TypeAlias = Sequence[tuple[float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A closed mesh: ``vertices`` (n, 3) in metres, ``faces`` (m, 3), counter-clockwise seen from outside."""

    vertices: Points
    faces: Faces

    @property
    def bounds(self) -> Points:
        """The lowest and the highest corner of the bounding box, shape (2, 3)."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def volume(self) -> float:
        """Volume in cubic metres, negative if the faces look inwards."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
        """The same solid, shifted by metres."""
        return Solid(self.vertices + np.array([x, y, z]), self.faces)

    def scaled(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Solid:
        """The same solid, stretched about the origin by positive factors."""
        return Solid(self.vertices * np.array([x, y, z]), self.faces)

    def turned(self, about: str, angle: float) -> Solid:
        """The same solid, rotated about the axis ``x``, ``y`` or ``z`` through the origin by ``angle`` radians."""
        first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[about]
        turned = self.vertices.copy()
        turned[:, first] = np.cos(angle) * self.vertices[:, first] - np.sin(angle) * self.vertices[:, second]
        turned[:, second] = np.sin(angle) * self.vertices[:, first] + np.cos(angle) * self.vertices[:, second]
        return Solid(turned, self.faces)


def join(solids: Iterable[Solid]) -> Solid:
    """All solids as one mesh of closed shells, which may overlap, like the handle and the wall of a cup."""
    vertices: list[Points] = []
    faces: list[Faces] = []
    count = 0
    for solid in solids:
        vertices.append(solid.vertices)
        faces.append(solid.faces + count)
        count += len(solid.vertices)
    return Solid(np.concatenate(vertices), np.concatenate(faces))


def loft(rings: Sequence[Points]) -> Solid:
    """The skin over a row of rings (k, 3) in metres, closed by a cap at each end; ``k`` is even.

    All rings have the same sense of rotation.
    """
    count, sides = len(rings), len(rings[0])
    faces: list[tuple[int, int, int]] = []
    for ring in range(count - 1):
        for k in range(sides):
            a, b = ring * sides + k, ring * sides + (k + 1) % sides
            faces += [(a, b, b + sides), (a, b + sides, a + sides)]
    last = (count - 1) * sides
    for k in range(sides // 2 - 1):
        a, b, c, d = k, k + 1, sides - 2 - k, sides - 1 - k
        faces += [(a, c, b), (a, d, c), (last + a, last + b, last + c), (last + a, last + c, last + d)]
    return _outward(np.concatenate(list(rings)), faces)


def revolve(profile: Profile, segments: int = 48) -> Solid:
    """The solid that a profile of points (radius, z) in metres sweeps when it turns about the z axis.

    Either both ends of the profile are on the axis (radius 0), or the profile is closed to a ring. ``segments`` flat
    sides approximate the circle; if their number is a multiple of 4, the extents in x and y are exact.
    """
    angles = 2.0 * np.pi * np.arange(segments) / segments
    vertices: list[Points] = []
    starts: list[tuple[int, bool]] = []
    count = 0
    for radius, z in profile:
        pole = radius == 0.0
        ring = np.array([[0.0, 0.0, z]]) if pole else circle(radius, z, angles)
        starts.append((count, pole))
        vertices.append(ring)
        count += len(ring)
    pairs = list(itertools.pairwise(starts))
    if not starts[0][1]:
        pairs.append((starts[-1], starts[0]))
    faces: list[tuple[int, int, int]] = []
    for (low, low_pole), (high, high_pole) in pairs:
        for k in range(segments):
            after = (k + 1) % segments
            if not low_pole:
                faces.append((low + k, low + after, high if high_pole else high + after))
            if not high_pole:
                faces.append((low if low_pole else low + k, high + after, high + k))
    return _outward(np.concatenate(vertices), faces)


def rounded(profile: Profile, times: int = 2) -> list[tuple[float, float]]:
    """The profile with its corners cut off ``times`` times, each time at a quarter of both edges; the ends stay."""
    points = np.array(profile)
    for _ in range(times):
        cut = np.stack([0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]], axis=1)
        points = np.concatenate([points[:1], cut.reshape(-1, 2)[1:-1], points[-1:]])
    return [(float(radius), float(z)) for radius, z in points]


def circle(radius: float, z: float, angles: Points) -> Points:
    """Points of a circle about the z axis at height ``z``, shape (len(angles), 3)."""
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), z)])


def block(x: Span, y: Span, z: Span) -> Solid:
    """The axis-aligned box between two corners."""
    ring = np.array([[x[0], y[0], 0.0], [x[1], y[0], 0.0], [x[1], y[1], 0.0], [x[0], y[1], 0.0]])
    return loft([ring + np.array([0.0, 0.0, height]) for height in z])


def bevelled(size: tuple[float, float, float], bevel: float) -> Solid:
    """A box of ``size`` about the origin, with 12 edges that are cut off by ``bevel`` metres."""
    half = np.array(size) / 2.0

    def ring(inset: float, z: float) -> Points:
        a, b = half[0] - inset, half[1] - inset
        c, d = a - bevel, b - bevel
        return np.array(
            [[-a, -d, z], [-c, -b, z], [c, -b, z], [a, -d, z], [a, d, z], [c, b, z], [-c, b, z], [-a, d, z]],
        )

    top = float(half[2])
    return loft([ring(bevel / 2, -top), ring(0.0, bevel - top), ring(0.0, top - bevel), ring(bevel / 2, top)])


def extrude(outline: Profile, y: Span) -> Solid:
    """A prism along y over an outline of points (x, z); the points ``i`` and ``-1 - i`` mirror each other."""
    return loft([np.array([[px, depth, pz] for px, pz in outline]) for depth in y])


def tube(path: Profile, radius: float, sides: int = 8) -> Solid:
    """A round bar that follows a path of points (x, z) in the plane y = 0."""
    points = np.array(path)
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    turns = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    rings = []
    for (px, pz), (tx, tz) in zip(points, tangents, strict=True):
        out, across = radius * np.cos(turns), radius * np.sin(turns)
        rings.append(np.column_stack([px - tz * out, across, pz + tx * out]))
    return loft(rings)


def sectors(inner: Profile, outer: Profile, segments: int) -> list[Solid]:
    """A hollow of revolution in convex pieces: a piece for each band of the wall in each segment of the turn.

    Every face of a piece is a plane trapezoid, so the pieces are exactly convex. The profiles of the inside and of the
    outside have the same number of points (radius, z) from bottom to rim, metres.
    """
    pieces = []
    for k in range(segments):
        angles = 2.0 * np.pi * np.array([k, k + 1]) / segments
        rows = [
            np.concatenate([circle(r_in, z_in, angles), circle(r_out, z_out, angles)[::-1]])
            for (r_in, z_in), (r_out, z_out) in zip(inner, outer, strict=True)
        ]
        pieces += [loft([low, high]) for low, high in itertools.pairwise(rows)]
    return pieces


def disc(radius: float, z: Span, segments: int = 16) -> Solid:
    """A round plate about the z axis."""
    return revolve([(0.0, z[0]), (radius, z[0]), (radius, z[1]), (0.0, z[1])], segments)


def _outward(vertices: Points, faces: list[tuple[int, int, int]]) -> Solid:
    solid = Solid(vertices, np.array(faces, dtype=np.int64))
    return solid if solid.volume > 0.0 else Solid(vertices, solid.faces[:, ::-1])
