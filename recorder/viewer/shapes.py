"""Shapes of a URDF's links, as the viewer shows them.

Models in recordings are canonical (see ``docs/architecture.md``): every shape has its sizes, every mesh is STL or OBJ
and attached.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

import rerun as rr

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from recorder.geometry import Pose

Color: TypeAlias = "tuple[float, float, float, float]"
GREY: Final[Color] = (0.8, 0.8, 0.8, 1.0)
_MEDIA: Final = {"stl": "model/stl", "obj": "model/obj"}


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of a link.

    Attributes:
        kind: "box", "cylinder", "sphere", "capsule" or "mesh".
        size: edges of a box, radius and length of what is round, scale of a mesh; m.
        mesh: path of the mesh, as the model tells it; "" of other shapes.
        pose: in the link's frame.
        color: RGBA 0..1.
    """

    kind: str
    size: tuple[float, ...]
    mesh: str
    pose: Pose
    color: Color


def shapes_of(model: bytes, role: str) -> dict[str, list[Shape]]:
    """The shapes of a model by link.

    Args:
        model: text of its URDF.
        role: "visual" or "collision".
    """
    root = ET.fromstring(model)  # noqa: S314  canonical: written by PyCRAM
    palette = {str(element.get("name")): color for element in root.findall("material") if (color := _rgba(element))}
    found = {}
    for link in root.findall("link"):
        shapes = [shape for element in link.findall(role) if (shape := _shape(element, palette))]
        if shapes:
            found[link.get("name", "")] = shapes
    return found


def _shape(element: ET.Element, palette: Mapping[str, Color]) -> Shape | None:
    shape = element.find("geometry/*")
    if shape is None:
        return None
    material = element.find("material")
    color = None if material is None else _rgba(material) or palette.get(material.get("name", ""))
    origin = element.find("origin")
    xyz, rpy = ("0 0 0", "0 0 0") if origin is None else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
    x, y, z = _numbers(xyz)
    keys = {"box": ("size",), "sphere": ("radius",), "mesh": ("scale",)}.get(shape.tag, ("radius", "length"))
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


def drawn(
    shapes: Sequence[Shape], meshes: Callable[[str], bytes | None], color: Color | None
) -> Iterator[tuple[str, list[rr.AsComponents]]]:
    """A link's shapes for the viewer: one entity for all boxes, one for all cylinders, one for each mesh.

    Args:
        shapes: the shapes.
        meshes: gives a mesh's content; None if it is not known.
        color: that of the whole body, which goes before those of the shapes; None for theirs.

    Yields:
        Names, unique within the link, and what is to be shown there.
    """
    for kind, draw in _SOLIDS.items():
        alike = [shape for shape in shapes if shape.kind == kind]
        if alike:
            yield kind, [draw(alike, [color or shape.color for shape in alike])]
    number = 0
    for shape in shapes:
        content = meshes(shape.mesh) if shape.kind == "mesh" else None
        if content is not None:
            media = _MEDIA[shape.mesh.rpartition(".")[2].lower()]
            asset = rr.Asset3D(contents=content, media_type=media, albedo_factor=color or shape.color)
            position, orientation = shape.pose
            place = rr.InstancePoses3D(translations=[position], quaternions=[orientation], scales=[shape.size])
            yield f"mesh_{number}", [asset, place]
            number += 1


def _boxes(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    half = [[edge / 2 for edge in shape.size] for shape in shapes]
    centers, turns = zip(*(shape.pose for shape in shapes), strict=True)
    return rr.Boxes3D(half_sizes=half, centers=centers, quaternions=turns, colors=colors, fill_mode="solid")


def _cylinders(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    centers, turns = zip(*(shape.pose for shape in shapes), strict=True)
    radii, lengths = zip(*(shape.size for shape in shapes), strict=True)
    return rr.Cylinders3D(
        lengths=lengths, radii=radii, centers=centers, quaternions=turns, colors=colors, fill_mode="solid"
    )


def _spheres(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    radii, centers = [shape.size[0] for shape in shapes], [shape.pose[0] for shape in shapes]
    return rr.Ellipsoids3D(radii=radii, centers=centers, colors=colors, fill_mode="solid")


def _capsules(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    """The viewer's capsules begin at their origin and have no length of their caps; a URDF's are centred."""
    radii, lengths = zip(*(shape.size for shape in shapes), strict=True)
    turns = [shape.pose[1] for shape in shapes]
    feet = [geometry.transform(shape.pose, (0.0, 0.0, -shape.size[1] / 2)) for shape in shapes]
    return rr.Capsules3D(
        lengths=lengths, radii=radii, translations=feet, quaternions=turns, colors=colors, fill_mode="solid"
    )


_SOLIDS: Final = {"box": _boxes, "cylinder": _cylinders, "sphere": _spheres, "capsule": _capsules}
