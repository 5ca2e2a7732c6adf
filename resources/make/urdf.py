"""URDF text: links made of boxes and cylinders in named materials, with inertia from the densities of the materials.

A shape that is visible but doesn't collide (``solid=False``) has no mass either.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, TypeAlias
from xml.sax.saxutils import quoteattr

import numpy as np

from make.files import number

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from make.solids import Span

Triple: TypeAlias = tuple[float, float, float]

FRAME_MASS = 0.01  # mass in kg of a link without a shape; the engine's default is 1 kg


@dataclass(frozen=True, slots=True)
class Material:
    """A colour (red, green, blue from 0 to 1) and a density in kg per cubic metre."""

    colour: Triple
    density: float


@dataclass(frozen=True, slots=True)
class Shape:
    """A box, or a cylinder within that box, in the frame of its link."""

    centre: Triple  # metres
    size: Triple  # extents along x, y, z, metres
    material: str  # name in the table of materials
    solid: bool = True  # whether the shape collides
    round_about: str = ""  # axis "x", "y" or "z" of the visible cylinder; the collision shape is always a box
    collides: Triple | None = None  # extents of the collision shape, metres; None for ``size``


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint to a parent link: origin and limits in metres and radians, axis in the joint's frame."""

    name: str
    kind: str
    parent: str
    xyz: Triple
    rpy: Triple
    axis: Triple | None = None
    limits: Span | None = None


@dataclass(frozen=True, slots=True)
class Link:
    """A link with its shapes, and the joint to its parent; None for the root."""

    name: str
    shapes: tuple[Shape, ...] = ()
    joint: Joint | None = None


def span(x: Span, y: Span, z: Span, material: str, *, solid: bool = True, round_about: str = "") -> Shape:
    """A shape between two corners."""
    low, high = zip(x, y, z, strict=True)
    cx, cy, cz = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    sx, sy, sz = (b - a for a, b in zip(low, high, strict=True))
    return Shape((cx, cy, cz), (sx, sy, sz), material, solid, round_about)


def document(name: str, links: Sequence[Link], materials: Mapping[str, Material], about: str) -> str:
    """The whole URDF, with the comment ``about`` on top; one of the links has no joint."""
    lines = ['<?xml version="1.0"?>', f"<!-- {about} -->", f"<robot name={quoteattr(name)}>"]
    for key, material in materials.items():
        lines.append(f'  <material name="{key}"><color rgba="{_row((*material.colour, 1.0))}"/></material>')
    for link in links:
        lines += _link(link, materials)
    for link in links:
        if link.joint is not None:
            lines += _joint(link.joint, link.name)
    return "\n".join([*lines, "</robot>"]) + "\n"


def _link(link: Link, materials: Mapping[str, Material]) -> list[str]:
    lines = [f'  <link name="{link.name}">', *_inertial(link.shapes, materials)]
    for shape in link.shapes:
        colour = f'<material name="{shape.material}"/>'
        lines.append(f"    <visual>{_origin(shape)}<geometry>{_seen(shape)}</geometry>{colour}</visual>")
    for shape in link.shapes:
        if shape.solid:
            box = f'<box size="{_row(shape.collides or shape.size)}"/>'
            lines.append(f'    <collision><origin xyz="{_row(shape.centre)}"/><geometry>{box}</geometry></collision>')
    return [*lines, "  </link>"]


def _joint(joint: Joint, child: str) -> list[str]:
    lines = [
        f'  <joint name="{joint.name}" type="{joint.kind}">',
        f'    <parent link="{joint.parent}"/><child link="{child}"/>',
        f'    <origin xyz="{_row(joint.xyz)}" rpy="{_row(joint.rpy)}"/>',
    ]
    if joint.axis is not None and joint.limits is not None:
        lower, upper = (number(limit) for limit in joint.limits)
        lines.append(f'    <axis xyz="{_row(joint.axis)}"/>')
        lines.append(f'    <limit lower="{lower}" upper="{upper}" effort="100" velocity="1"/>')
        lines.append('    <dynamics damping="1" friction="0.5"/>')
    return [*lines, "  </joint>"]


def _seen(shape: Shape) -> str:
    if not shape.round_about:
        return f'<box size="{_row(shape.size)}"/>'
    length = shape.size["xyz".index(shape.round_about)]
    radius = min(size for axis, size in zip("xyz", shape.size, strict=True) if axis != shape.round_about) / 2
    return f'<cylinder radius="{number(radius)}" length="{number(length)}"/>'


def _origin(shape: Shape) -> str:
    turn = {"": "", "z": "", "x": f' rpy="0 {number(pi / 2)} 0"', "y": f' rpy="{number(pi / 2)} 0 0"'}[
        shape.round_about
    ]
    return f'<origin xyz="{_row(shape.centre)}"{turn}/>'


def _inertial(shapes: Iterable[Shape], materials: Mapping[str, Material]) -> list[str]:
    masses, centres, sizes = [], [], []
    for shape in shapes:
        if shape.solid:
            masses.append(materials[shape.material].density * float(np.prod(shape.size)))
            centres.append(shape.centre)
            sizes.append(shape.size)
    if not masses:
        diagonal = number(FRAME_MASS * 1e-2)
        inertia = f'ixx="{diagonal}" iyy="{diagonal}" izz="{diagonal}" ixy="0" ixz="0" iyz="0"'
        return [f'    <inertial><mass value="{number(FRAME_MASS)}"/><inertia {inertia}/></inertial>']
    weights = np.array(masses)
    middle = weights @ np.array(centres) / weights.sum()
    tensor: NDArray[np.float64] = np.zeros((3, 3))
    for mass, centre, size in zip(masses, np.array(centres) - middle, np.array(sizes), strict=True):
        own = np.diag(mass / 12.0 * ((size**2).sum() - size**2))
        tensor += own + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor.tolist()
    named = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (xx, yy, zz, xy, xz, yz), strict=True)
    inertia = " ".join(f'{key}="{number(moment, digits=9)}"' for key, moment in named)
    total = f'<mass value="{number(float(weights.sum()))}"/>'
    return [f'    <inertial><origin xyz="{_row(middle.tolist())}"/>{total}<inertia {inertia}/></inertial>']


def _row(values: Iterable[float]) -> str:
    return " ".join(number(value) for value in values)
