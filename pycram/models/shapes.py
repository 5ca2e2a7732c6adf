"""Shapes of a model: triangles, colours, bounding boxes, and the convex pieces that the engine uses for collisions.

A canonical URDF is read only once, because its name depends on its content. The engine uses the convex hull of each
group of a collision mesh. Each plane of a hull bounds a half space, so lines can be intersected with a hull.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from pycram.models import conversion_cache, mesh, store
from recorder import geometry
from recorder.geometry import Array
from recorder.packages import LazyModule, needed
from recorder.urdf import Shape, shapes_in

Number = TypeVar("Number", np.float64, np.int64)
Ends: TypeAlias = "tuple[Sequence[float] | Array, Sequence[float] | Array]"  # lowest and highest corner of a box, m
_SECTIONS: Final = 32  # number of sides of approximated cylinders and spheres
_NO_AREA: Final = 1e-12  # area in m^2; in a solid 1 m high, a smaller triangle has two corners on the axis
_CUBE: Final = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))  # corners of a cube with edges of 1 m
_SIDES: Final = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Indices of the corners of each side of the cube, counter-clockwise as seen from outside."""
_CUBE_TRIANGLES: Final = np.array([_CUBE[[a, *ends]] for a, b, c, d in _SIDES for ends in ((b, c), (c, d))])
_PLANE_DECIMALS: Final = 9  # decimal places in which planes of triangles on one face agree
_MAX_CHOSEN: Final = 40  # maximum number of corners for trying all choices of three; more would take over 3 ms
_SHARED: Final = 6  # approximate number of triangles that share a corner
_FLAT: Final = 1e-9  # tolerance in m for corners in front of a plane, and minimum thickness of a solid
_IN_LINE: Final = 1e-12  # twice the maximum area in m^2 of a triangle with collinear corners
_NEXT: Final = [1, 2, 0]  # axes of the first factors of the terms of a cross product
_OTHER: Final = [2, 0, 1]  # axes of the second factors


@dataclass(frozen=True, slots=True)
class Shapes:
    """Shapes of a model, each in the frame of its link. Links without shapes are left out; k links remain."""

    links: tuple[str, ...]
    triangles: Callable[[int], Array]  # returns corners (n, 3, 3), m, for the index of a link
    colors: Callable[[int], Array]  # returns RGB 0..1 (n, 3) of the triangles for the index of a link
    low: Array  # (k, 3) lowest corners of bounding boxes, m
    high: Array  # (k, 3) highest corners of bounding boxes, m


@lru_cache(maxsize=256)
def shapes_of(path: Path, role: str = "visual") -> Shapes:
    """Return the "visual" or "collision" shapes of a canonical URDF."""
    links, folder = _read(path, role), path.parent
    by_number = list(links.values())

    @cache
    def triangles(link: int) -> Array:
        return np.concatenate([_placed(part, _triangles(part, folder)) for part in by_number[link]])

    @cache
    def colors(link: int) -> Array:
        return np.concatenate([np.tile(part.color[:3], (len(_triangles(part, folder)), 1)) for part in by_number[link]])

    every = [[_ends(part, folder) for part in parts] for parts in by_number]
    ends = np.array([each[0] if len(each) == 1 else bounds(np.array(each)) for each in every]).reshape(-1, 2, 3)
    return Shapes(tuple(links), triangles, colors, ends[:, 0], ends[:, 1])


@lru_cache(maxsize=256)
def _read(path: Path, role: str) -> dict[str, list[Shape]]:
    return shapes_in(store.document(path), role)


def bounds(corners: Array) -> tuple[Array, Array]:
    """Return the lowest and highest corner of a box around corners (..., 3)."""
    points = corners.reshape(-1, 3)
    return points.min(axis=0), points.max(axis=0)


def _ends(shape: Shape, folder: Path) -> Ends:
    """Return the bounding box of a shape in the frame of its link."""
    position, orientation = shape.pose
    if orientation == geometry.IDENTITY[1]:
        if shape.kind == "box":
            low = [at - edge / 2 for at, edge in zip(position, shape.size, strict=True)]
            return low, [at + edge / 2 for at, edge in zip(position, shape.size, strict=True)]
        if shape.kind == "mesh":
            return bounds(_mesh_ends(folder / shape.mesh) * shape.size + position)
    return bounds(_placed(shape, _CUBE * shape.size if shape.kind == "box" else _triangles(shape, folder)))


@lru_cache(maxsize=256)
def piece_bounds(path: Path) -> Sequence[tuple[str, Ends]]:
    """Return link and bounding box of each piece of :func:`pieces_of`."""
    every: list[tuple[str, Ends]] = []
    for link, parts in _read(path, "collision").items():
        for part in parts:
            if part.mesh.lower().endswith(".obj"):
                every += ((link, bounds(_placed(part, group))) for group in _groups(part, path.parent))
            else:
                every.append((link, _ends(part, path.parent)))
    return every


def pieces_of(path: Path) -> Iterator[tuple[str, Array]]:
    """Yield link and corners (n, 3), m, of each piece of a collision shape; the engine uses the piece's convex hull."""
    for link, parts in _read(path, "collision").items():
        for part in parts:
            for group in _groups(part, path.parent):
                yield link, _placed(part, group).reshape(-1, 3)


def _placed(shape: Shape, corners: Array) -> Array:
    """Transform corners from the frame of a shape into the frame of its link."""
    position, orientation = shape.pose
    turned = corners if orientation == geometry.IDENTITY[1] else corners @ geometry.to_matrix(orientation).T
    placed: Array = turned + np.array(position)
    return placed


def _groups(shape: Shape, folder: Path) -> Iterator[Array]:
    """Yield corners (n, 3) or (n, 3, 3) of each group of a shape, in the shape's frame; only OBJs have several."""
    if shape.kind == "box":
        yield _CUBE * shape.size
        return
    if not shape.mesh.lower().endswith(".obj"):
        yield _triangles(shape, folder)
        return
    corners: list[list[str]] = []
    groups: list[set[str]] = [set()]  # the indices stay text, because each occurs about six times
    for key, words in _obj_lines(folder / shape.mesh):
        if key == "v":
            corners.append(words)
        elif key == "f":
            groups[-1].update(words)
        elif key in {"o", "g"}:
            groups.append(set())
    every = np.array(corners, dtype=np.float64) * np.array(shape.size)
    for group in groups:
        if group:
            yield every[np.array(sorted(set(map(int, group)))) - 1]


def _obj_lines(file: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield key and words of each line of an OBJ: a vertex's coordinates, or a face's indices, from 1."""
    count = 0
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            count += 1
            words = words[:3]
        elif key == "f":
            if "/" in line:  # indices of normals and texture coordinates follow the vertex's index
                words = [word.split("/")[0] for word in words]
            if "-" in line:  # negative indices are relative to the last vertex
                words = [str(count + 1 + int(word)) if word.startswith("-") else word for word in words]
        yield key, words


def _triangles(shape: Shape, folder: Path) -> Array:
    if shape.kind == "mesh":
        scaled: Array = _mesh(folder / shape.mesh) * np.array(shape.size)
        return scaled
    if shape.kind == "box":
        return _CUBE_TRIANGLES * shape.size
    if shape.kind == "cylinder":
        radius, height = shape.size
        return _revolved(np.array([(0, -height / 2), (radius, -height / 2), (radius, height / 2), (0, height / 2)]))
    radius, height = shape.size if shape.kind == "capsule" else (shape.size[0], 0.0)
    angles = np.linspace(-np.pi / 2, 0, _SECTIONS // 4 + 1)
    below = np.column_stack([np.cos(angles), np.sin(angles)]) * radius - (0, height / 2)
    return _revolved(np.concatenate([below, below[::-1] * (1, -1)]))


def _revolved(profile: Array) -> Array:
    """Return the triangles of a solid of revolution about the z axis; their corners are counter-clockwise from outside.

    The profile (k, 2) has points from bottom to top: the distance from the axis, and the height, m.
    """
    angles = np.arange(_SECTIONS) * 2 * np.pi / _SECTIONS
    distance, height = profile.T
    rings = np.empty((_SECTIONS, len(profile), 3))
    rings[..., 0], rings[..., 1] = np.outer(np.cos(angles), distance), np.outer(np.sin(angles), distance)
    rings[..., 2] = height
    following = np.roll(rings, -1, axis=0)
    a, b, c, d = rings[:, :-1], following[:, :-1], following[:, 1:], rings[:, 1:]
    triangles = np.concatenate([np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))])
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    return np.asarray(triangles[areas > _NO_AREA * np.abs(profile).max() ** 2])


@lru_cache(maxsize=1024)
def _mesh_ends(file: Path) -> Array:
    return np.array(bounds(_mesh(file)))


@lru_cache(maxsize=256)
def _mesh(file: Path) -> Array:
    if file.suffix.lower() == ".stl":  # a binary STL, because the store contains no ASCII STL
        return np.array(mesh.stl_faces(file.read_bytes())["numbers"][:, 1:], dtype=np.float64)
    corners: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for key, words in _obj_lines(file):
        if key == "v":
            corners.append([float(word) for word in words])
        elif key == "f":
            first, *others = (int(word) - 1 for word in words)
            faces += [(first, second, third) for second, third in itertools.pairwise(others)]
    triangles: Array = np.array(corners)[np.array(faces)]
    return triangles


@dataclass(frozen=True, slots=True)
class Solids:
    """The k convex pieces of a model, and their m planes in the order of the pieces, in the frames of the links."""

    links: tuple[str, ...]  # (k,) the link of each piece
    low: Array  # (k, 3) lowest corners of bounding boxes, m
    high: Array  # (k, 3) highest corners of bounding boxes, m
    normals: Array  # (m, 3) outward unit normals of the planes
    offsets: Array  # (m,) distances of the planes from the origin along the normals, m
    pieces: NDArray[np.intp]  # (m,) index of the piece of each plane


@lru_cache(maxsize=256)
def solids_of(path: Path) -> Solids:
    """Return the convex pieces of a canonical URDF."""
    found = list(pieces_of(path))
    hulls = convex_hulls([corners for _, corners in found])
    planes = [_planes(corners, hull) for (_, corners), hull in zip(found, hulls, strict=True)]
    every = np.concatenate(planes) if planes else np.zeros((0, 4))
    return Solids(
        tuple(link for link, _ in found),
        np.array([corners.min(axis=0) for _, corners in found]).reshape(-1, 3),
        np.array([corners.max(axis=0) for _, corners in found]).reshape(-1, 3),
        every[:, :3],
        every[:, 3],
        np.repeat(np.arange(len(planes)), [len(each) for each in planes]),
    )


def _planes(corners: Array, hull: Hull | None) -> Array:
    """Return planes (n, 4) of a hull, and of the bounding box, which cuts off the padding at sharp edges."""
    ends = np.concatenate([corners.max(axis=0), -corners.min(axis=0)])
    box = np.column_stack([np.vstack([np.eye(3), -np.eye(3)]), ends])
    if hull is None:  # flat
        return box
    return distinct(np.vstack([box, hull.planes * [1.0, 1.0, 1.0, -1.0]]).round(_PLANE_DECIMALS), axis=0)


def distinct(values: NDArray[Number], axis: int | None = None) -> NDArray[Number]:
    """Return the sorted distinct values. Without counts, NumPy would import masked arrays, which takes 10 ms."""
    return np.unique(values, return_counts=True, axis=axis)[0]


class Hull(NamedTuple):
    """A convex hull."""

    corners: Array  # (n, 3), m; a small set of corners also contains inner points
    planes: Array  # (k, 4) outward unit normals and offsets in m: inside, ``normal @ point + offset <= 0``; may repeat


def convex_hulls(every: Iterable[Array]) -> Sequence[Hull | None]:
    """Return the convex hulls of sets of points (n, 3), m; None for a set of coplanar points.

    SciPy computes the hulls of large sets. A cache keeps these hulls, because SciPy takes 0.25 s to import.
    """
    some = range(_MAX_CHOSEN + 1, _MAX_CHOSEN * _SHARED + 1)  # numbers of points that may repeat a few corners
    sets = [distinct(corners, axis=0) if len(corners) in some else corners for corners in every]
    large = [np.ascontiguousarray(corners) for corners in sets if len(corners) > _MAX_CHOSEN]
    found = iter(_large_hulls(large) if large else ())
    return [next(found) if len(corners) > _MAX_CHOSEN else _small_hull(corners) for corners in sets]


def _large_hulls(every: Sequence[Array]) -> Iterator[Hull | None]:
    """Yield the hulls of large sets of points from the cache; SciPy computes missing hulls."""

    def find() -> Sequence[tuple[str, bytes, None]]:
        with needed():  # pictures of recordings work without SciPy
            spatial: Any = LazyModule("scipy.spatial")
        found = []
        for corners in every:
            try:
                hull = spatial.ConvexHull(corners)
                parts: tuple[Array, ...] = corners[hull.vertices], hull.equations
            except spatial.QhullError:  # the points of the set are in a plane
                parts = np.zeros((0, 3)), np.zeros((0, 4))
            found += [("", np.ascontiguousarray(part).tobytes(), None) for part in parts]
        return found

    cached = conversion_cache.kept("hulls", (corners.tobytes() for corners in every), find)
    arrays = iter([np.frombuffer(content) for _, content, _ in cached])
    for corners, planes in zip(arrays, arrays, strict=True):
        yield Hull(corners.reshape(-1, 3), planes.reshape(-1, 4)) if len(planes) else None


def _small_hull(corners: Array) -> Hull | None:
    """Return a hull from all choices of three points, which span a side if no point is in front of their plane."""
    first, second, third = corners[_triples(len(corners))]
    u, v = second - first, third - first
    normals = u[:, _NEXT] * v[:, _OTHER] - u[:, _OTHER] * v[:, _NEXT]  # np.cross would take most of the running time
    areas = np.sqrt((normals * normals).sum(axis=1))
    spans = areas > _IN_LINE
    normals = normals[spans] / areas[spans, None]
    offsets = -(normals * first[spans]).sum(axis=1)
    heights = normals @ corners.T + offsets[:, None]
    outwards, inwards = heights.max(axis=1) < _FLAT, heights.min(axis=1) > -_FLAT
    if not outwards.any() or (outwards & inwards).any():
        return None
    every = np.column_stack([normals, offsets])
    return Hull(corners, np.concatenate([every[outwards], -every[inwards]]))


@cache
def _triples(count: int) -> NDArray[np.intp]:
    return np.array(list(itertools.combinations(range(count), 3)), dtype=np.intp).reshape(-1, 3).T
