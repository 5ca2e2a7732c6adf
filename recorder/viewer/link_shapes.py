"""A link's shapes, as the viewer draws them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from recorder.geometry.shapes import Color, Shape

_MEDIA_TYPES: Final = {"stl": "model/stl", "obj": "model/obj"}


def draw(
    shapes: Sequence[Shape], meshes: Callable[[str], bytes | None], color: Color | None
) -> Iterator[tuple[str, list[rr.AsComponents]]]:
    """Draws a link's shapes: one entity for all boxes, one for all cylinders, one for each mesh.

    ``meshes`` gives a mesh's content, None if it is not known; without a color of the body, shapes have their own.

    Yields:
        Names, unique within the link, and what is to be shown there.
    """
    for kind, solids in _SOLIDS.items():
        alike = [shape for shape in shapes if shape.kind == kind]
        if alike:
            yield kind, [solids(alike, [color or shape.color for shape in alike])]
    number = 0
    for shape in shapes:
        content = meshes(shape.mesh) if shape.kind == "mesh" else None
        if content is not None:
            media = _MEDIA_TYPES[shape.mesh.rpartition(".")[2].lower()]
            asset = rr.Asset3D(contents=content, media_type=media, albedo_factor=color or shape.color)
            position, orientation = shape.pose
            pose = rr.InstancePoses3D(translations=[position], quaternions=[orientation], scales=[shape.size])
            yield f"mesh_{number}", [asset, pose]
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
