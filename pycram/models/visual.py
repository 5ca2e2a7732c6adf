"""Triangles and colours of a model's shapes, read once from its canonical URDF (:mod:`recorder.geometry.shapes`)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models import mesh
from recorder import geometry
from recorder.geometry.shapes import read_shapes
from recorder.packages import needed

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from recorder.geometry.shapes import Shape

with needed():
    import trimesh

_SECTIONS: Final = 32  # sides of cylinders and spheres


@dataclass(frozen=True, slots=True)
class Shapes:
    """Shapes of a model's k links that have any.

    Attributes:
        links: Their names.
        triangles: For each link (n, 3, 3) corners in its frame, m.
        colors: For each link (n, 3) RGB 0..1 of its triangles.
        low: (k, 3) lowest corners of their boxes in the links' frames, m.
        high: (k, 3) highest corners of their boxes.
    """

    links: tuple[str, ...]
    triangles: tuple[NDArray[np.float64], ...]
    colors: tuple[NDArray[np.float64], ...]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


@lru_cache(maxsize=256)
def shapes_of(path: Path, role: str = "visual") -> Shapes:
    """Return the "visual" or "collision" shapes of the model with a canonical URDF."""
    links, triangles, colors = [], [], []
    for link, parts in read_shapes(path.read_bytes(), role).items():
        pieces = [(_placed(part, _triangles(part, path.parent)), part.color[:3]) for part in parts]
        links.append(link)
        triangles.append(np.concatenate([corners for corners, _ in pieces]))
        colors.append(np.concatenate([np.tile(rgb, (len(corners), 1)) for corners, rgb in pieces]))
    low = np.array([part.min(axis=(0, 1)) for part in triangles]).reshape(-1, 3)
    high = np.array([part.max(axis=(0, 1)) for part in triangles]).reshape(-1, 3)
    return Shapes(tuple(links), tuple(triangles), tuple(colors), low, high)


def pieces_of(path: Path) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield the pieces of collision shapes of which the engine takes the convex hull: link, corners (n, 3) in m."""
    for link, parts in read_shapes(path.read_bytes(), "collision").items():
        for part in parts:
            for group in _groups(part, path.parent):
                yield link, _placed(part, group).reshape(-1, 3)


def _placed(shape: Shape, corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform corners from a shape's frame into its link's."""
    position, orientation = shape.pose
    placed: NDArray[np.float64] = corners @ geometry.to_matrix(orientation).T + np.array(position)
    return placed


def _groups(shape: Shape, folder: Path) -> Iterator[NDArray[np.float64]]:
    """Yield corners (n, 3) or (n, 3, 3) of the groups of a shape in its own frame; only an OBJ has several."""
    if shape.kind == "box":
        yield np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * shape.size
        return
    if not shape.mesh.endswith(".obj"):
        yield _triangles(shape, folder)
        return
    corners: list[list[float]] = []
    groups: list[set[int]] = [set()]
    for line in (folder / shape.mesh).read_text(encoding="utf-8", errors="replace").splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            corners.append([float(word) for word in words[:3]])
        elif key in {"o", "g"}:
            groups.append(set())
        elif key == "f":  # counted from 1, or backwards from the last
            numbers = (int(word.split("/")[0]) for word in words)
            groups[-1].update(number - 1 if number > 0 else len(corners) + number for number in numbers)
    for group in groups:
        if group:
            yield np.array([corners[number] for number in sorted(group)]) * np.array(shape.size)


def _triangles(shape: Shape, folder: Path) -> NDArray[np.float64]:
    """Return the triangles of a shape in its own frame."""
    if shape.kind == "mesh":
        scaled: NDArray[np.float64] = _mesh(folder / shape.mesh) * np.array(shape.size)
        return scaled
    if shape.kind == "box":
        solid = trimesh.creation.box(shape.size)
    elif shape.kind == "sphere":
        solid = trimesh.creation.uv_sphere(shape.size[0], count=(_SECTIONS // 2, _SECTIONS))
    elif shape.kind == "cylinder":
        radius, height = shape.size
        solid = trimesh.creation.cylinder(radius, height, sections=_SECTIONS)
    else:
        radius, height = shape.size
        solid = trimesh.creation.capsule(height, radius, count=(_SECTIONS, _SECTIONS))
        solid.apply_translation(-solid.bounds.mean(axis=0))
    return np.asarray(solid.triangles, dtype=np.float64)


@lru_cache(maxsize=256)
def _mesh(file: Path) -> NDArray[np.float64]:
    if file.suffix == ".stl":  # binary: ASCII ones were converted
        return np.array(mesh.stl_faces(file.read_bytes())["numbers"][:, 1:], dtype=np.float64)
    loaded = trimesh.load_mesh(file, process=False)
    return np.array(loaded.triangles, dtype=np.float64)
