"""Shapes of a model's links, from its URDF: kind, sizes, pose and colour, without any mesh being read.

Models are canonical (see ``docs/architecture.md``): every shape has its sizes, every mesh is STL or OBJ. A link has any
number of "visual" and "collision" shapes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import Pose

Color: TypeAlias = "tuple[float, float, float, float]"
"""RGBA 0..1."""

GREY: Final[Color] = (0.8, 0.8, 0.8, 1.0)
_SIZES: Final = {"box": ("size",), "sphere": ("radius",), "mesh": ("scale",)}  # of others: radius and length


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of a link.

    Attributes:
        kind: "box", "cylinder", "sphere", "capsule" or "mesh".
        size: edges of a box, radius and length of others in m; scale of a mesh.
        mesh: path of the mesh, as in the model; "" of other shapes.
        pose: in the link's frame.
        color: its own, or grey.
    """

    kind: str
    size: tuple[float, ...]
    mesh: str
    pose: Pose
    color: Color


def read_shapes(model: str | bytes, role: str) -> dict[str, list[Shape]]:
    """The "visual" or "collision" shapes of a URDF by link; only of links that have any."""
    return shapes_in(ET.fromstring(model), role)  # noqa: S314  canonical: written by PyCRAM


def shapes_in(root: ET.Element, role: str) -> dict[str, list[Shape]]:
    """The same of a URDF that is parsed already."""
    palette = {str(element.get("name")): color for element in root.findall("material") if (color := _rgba(element))}
    by_link = {}
    for link in root.findall("link"):
        shapes = [shape for element in link.findall(role) if (shape := _shape(element, palette))]
        if shapes:
            by_link[link.get("name", "")] = shapes
    return by_link


def _shape(element: ET.Element, palette: Mapping[str, Color]) -> Shape | None:
    shape = element.find("geometry/*")
    if shape is None:
        return None
    material = element.find("material")
    color = None if material is None else _rgba(material) or palette.get(material.get("name", ""))
    origin = element.find("origin")
    xyz, rpy = ("0 0 0", "0 0 0") if origin is None else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
    x, y, z = _numbers(xyz)
    keys = _SIZES.get(shape.tag, ("radius", "length"))
    size = tuple(number for key in keys for number in _numbers(shape.get(key, "1 1 1")))
    pose = ((x, y, z), geometry.from_rpy(*_numbers(rpy)))
    return Shape(shape.tag, size, shape.get("filename", ""), pose, color or GREY)


def _rgba(material: ET.Element) -> Color | None:
    element = material.find("color")
    if element is None:
        return None
    red, green, blue, alpha = _numbers(element.get("rgba", ""))
    return red, green, blue, alpha


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split())
