"""What a model looks like: triangles and colours of its links' shapes, read once from its canonical URDF."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
import trimesh

from pycram import mesh
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

_GREY: Final = (0.8, 0.8, 0.8)
_ROUND: Final = 32  # sides of what is round


@dataclass(frozen=True, slots=True)
class Shapes:
    """What a model's k links look like, those that have a shape.

    Attributes:
        links: their names.
        triangles: for each (n, 3, 3) corners in the link's frame, m.
        colors: for each (n, 3) RGB 0..1 of its triangles.
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
    """The shapes of a model's links.

    Args:
        path: its canonical URDF, beside its meshes (see :mod:`pycram.assets`).
        role: "visual", what is seen, or "collision", what touches.
    """
    root = ET.parse(path).getroot()  # noqa: S314  canonical: written by PyCRAM
    palette = {str(element.get("name")): rgb for element in root.findall("material") if (rgb := _rgb(element))}
    links, triangles, colors = [], [], []
    for link in root.findall("link"):
        parts = list(_parts(link.findall(role), path.parent, palette))
        if parts:
            links.append(link.get("name", ""))
            triangles.append(np.concatenate([part for part, _ in parts]))
            colors.append(np.concatenate([np.tile(rgb, (len(part), 1)) for part, rgb in parts]))
    low = np.array([part.min(axis=(0, 1)) for part in triangles]).reshape(-1, 3)
    high = np.array([part.max(axis=(0, 1)) for part in triangles]).reshape(-1, 3)
    return Shapes(tuple(links), tuple(triangles), tuple(colors), low, high)


def pieces_of(path: Path) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """The pieces that collide, of each of which the engine takes the convex hull.

    Args:
        path: its canonical URDF, beside its meshes.

    Yields:
        The link's name and corners (n, 3) in its frame, m.
    """
    root = ET.parse(path).getroot()  # noqa: S314  canonical: written by PyCRAM
    for link in root.findall("link"):
        for piece, _ in _parts(link.findall("collision"), path.parent, {}, grouped=True):
            yield link.get("name", ""), piece.reshape(-1, 3)


def _parts(
    elements: Iterable[ET.Element], folder: Path, palette: dict[str, tuple[float, ...]], *, grouped: bool = False
) -> Iterator[tuple[NDArray[np.float64], tuple[float, ...]]]:
    for element in elements:
        shape = element.find("geometry/*")
        if shape is None:
            continue
        material = element.find("material")
        rgb = None if material is None else _rgb(material) or palette.get(material.get("name", ""))
        origin = element.find("origin")
        xyz, rpy = ("0 0 0", "0 0 0") if origin is None else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
        turn = geometry.to_matrix(geometry.from_rpy(*_numbers(rpy)))
        for corners in _groups(shape, folder) if grouped else [_triangles(shape, folder)]:
            yield corners @ turn.T + np.array(_numbers(xyz)), rgb or _GREY


def _rgb(material: ET.Element) -> tuple[float, ...] | None:
    color = material.find("color")
    return None if color is None else _numbers(color.get("rgba", ""))[:3]


def _groups(shape: ET.Element, folder: Path) -> Iterator[NDArray[np.float64]]:
    """Corners (n, 3) or (n, 3, 3) of the groups of a shape in its own frame; only an OBJ has several."""
    if shape.tag == "box":
        yield np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * _numbers(shape.get("size", ""))
        return
    name = shape.get("filename", "")
    if not name.endswith(".obj"):
        yield _triangles(shape, folder)
        return
    scale = np.array(_numbers(shape.get("scale", "1 1 1")))
    corners: list[list[float]] = []
    groups: list[set[int]] = [set()]
    for line in (folder / name).read_text(encoding="utf-8", errors="replace").splitlines():
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
            yield np.array([corners[number] for number in sorted(group)]) * scale


def _triangles(shape: ET.Element, folder: Path) -> NDArray[np.float64]:
    """Triangles of a shape in its own frame."""
    if shape.tag == "mesh":
        scale = np.array(_numbers(shape.get("scale", "1 1 1")))
        scaled: NDArray[np.float64] = _mesh(folder / shape.get("filename", "")) * scale
        return scaled
    if shape.tag == "box":
        solid = trimesh.creation.box(_numbers(shape.get("size", "")))
    elif shape.tag == "sphere":
        solid = trimesh.creation.uv_sphere(float(shape.get("radius", "")), count=(_ROUND // 2, _ROUND))
    elif shape.tag == "cylinder":
        height = float(shape.get("length", ""))
        solid = trimesh.creation.cylinder(float(shape.get("radius", "")), height, sections=_ROUND)
    else:
        height = float(shape.get("length", ""))
        solid = trimesh.creation.capsule(height, float(shape.get("radius", "")), count=(_ROUND, _ROUND))
        solid.apply_translation(-solid.bounds.mean(axis=0))
    return np.asarray(solid.triangles, dtype=np.float64)


@lru_cache(maxsize=256)
def _mesh(file: Path) -> NDArray[np.float64]:
    if file.suffix == ".stl":  # binary: ASCII ones were converted
        return np.array(mesh.stl_faces(file.read_bytes())["numbers"][:, 1:], dtype=np.float64)
    loaded = trimesh.load_mesh(file, process=False)
    return np.array(loaded.triangles, dtype=np.float64)


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split())
