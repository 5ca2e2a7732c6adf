"""Links of a URDF: invalid ones, which PyBullet refuses without a reason or loads silently, are refused by name.

Frames without inertia get a negligible one: PyBullet would give them 1 kg each and print a warning.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation.failures import AssetError
from recorder.urdf import finite

if TYPE_CHECKING:
    from pathlib import Path

LARGEST: Final = 1e9
"""m, kg or kg m^2, of anything in a link: of larger ones the engine makes infinite ones."""
DENSITY: Final = 700.0  # kg/m^3, of household objects of unknown mass
_FRAME_MASS: Final = 1e-3  # kg, of links that are only frames
_FRAME_INERTIA: Final = 1e-6  # kg m^2
_JOINT_INERTIA: Final = 0.05  # kg m^2, of frames between joints, as of rotors: motors in a row agree sooner
_ROUNDING: Final = 1e-9  # kg m^2 below 0 that are a rounding error of a mesh tool
_SHAPES: Final = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
    "mesh": (),
}
_MOMENTS: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def check(source: Path, link: ET.Element) -> None:
    """Refuse a ``<link>`` element that the engine can't use; errors name its source.

    Raises:
        AssetError: A shape is missing, unknown or of impossible size; an origin, a mass, an inertia or a colour isn't
            made of finite numbers.
    """
    where = f"link {link.get('name', '')!r}"
    for role in ("visual", "collision"):
        for element in link.findall(role):
            _check_origin(source, f"{where}, {role}", element)
            _check_shape(source, f"{where}, {role}", element.find("geometry"))
            for color in element.iter("color"):
                rgba = _numbers(source, f"{where}, color", color, "rgba", 4)
                if min(rgba) < 0 or max(rgba) > 1:
                    raise AssetError(source, f"{where}: the colour {color.get('rgba')!r} isn't within 0 and 1")
    inertial = link.find("inertial")
    if inertial is not None:
        _check_inertial(source, where, inertial)


def _check_shape(source: Path, where: str, geometry: ET.Element | None) -> None:
    shapes = list(geometry) if geometry is not None else []
    if len(shapes) != 1:
        raise AssetError(source, f"{where}: takes one shape in <geometry>, has {len(shapes) or 'none'}")
    shape = shapes[0]
    if shape.tag not in _SHAPES:
        raise AssetError(source, f"{where}: <{shape.tag}> is none of {', '.join(_SHAPES)}")
    for attribute, count in _SHAPES[shape.tag]:
        values = _numbers(source, f"{where}, {shape.tag}", shape, attribute, count)
        if min(values) <= 0:
            raise AssetError(
                source, f"{where}: {attribute} of the {shape.tag} is {shape.get(attribute)!r}, not above 0"
            )
    if shape.get("scale") is not None and 0.0 in _numbers(source, f"{where}, mesh", shape, "scale", 3):
        raise AssetError(source, f"{where}: a mesh scaled by {shape.get('scale')!r} has no volume")


def _check_inertial(source: Path, where: str, inertial: ET.Element) -> None:
    _check_origin(source, f"{where}, inertial", inertial)
    for name, attributes in (("mass", ("value",)), ("inertia", _MOMENTS)):
        element = inertial.find(name)
        if element is None:
            raise AssetError(source, f"{where}: its <inertial> has no <{name}>")
        for attribute in attributes:
            (value,) = _numbers(source, f"{where}, {name}", element, attribute, 1)
            if value < -_ROUNDING and attribute in ("value", "ixx", "iyy", "izz"):
                raise AssetError(source, f"{where}: its {name} is {element.get(attribute)!r}, less than 0")


def _check_origin(source: Path, where: str, element: ET.Element) -> None:
    origin = element.find("origin")
    for attribute in ("xyz", "rpy"):
        if origin is not None and origin.get(attribute) is not None:
            _numbers(source, f"{where}, origin", origin, attribute, 3)


def _numbers(source: Path, where: str, element: ET.Element, attribute: str, count: int) -> list[float]:
    text = element.get(attribute)
    try:
        values = [finite(part) for part in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count:
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise AssetError(source, f"{where}: {attribute} takes {wanted}, has {text!r}")
    if max(map(abs, values)) > LARGEST:
        raise AssetError(source, f"{where}: {attribute} is {text!r}: numbers go up to {LARGEST:g}")
    return values


def give_inertia(link: ET.Element, *, moved: bool) -> None:
    """Give a checked ``<link>`` element without inertia that of a solid of household density.

    One whose inertia no body can have, such as two moments that don't add up to the third, gets moments that are their
    mean: the engine would make them 0.

    Args:
        link: The element.
        moved: Whether a joint moves it.
    """
    inertia = link.find("inertial/inertia")
    if inertia is not None:
        _balance(inertia)
        return
    sizes = [size for collision in link.findall("collision") if (size := _box(collision)) is not None]
    if sizes:
        mass = sum(DENSITY * x * y * z for x, y, z in sizes)
        x, y, z = max(sizes, key=lambda size: size[0] * size[1] * size[2])
        moments = [mass / 12 * (b * b + c * c) for b, c in ((y, z), (x, z), (x, y))]
    else:
        mass, moments = _FRAME_MASS, [_JOINT_INERTIA if moved else _FRAME_INERTIA] * 3
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value=repr(mass))
    tensor = dict.fromkeys(_MOMENTS, "0") | dict(zip(("ixx", "iyy", "izz"), map(repr, moments), strict=True))
    ET.SubElement(inertial, "inertia", attrib=tensor)


def _balance(inertia: ET.Element) -> None:
    ixx, ixy, ixz, iyy, iyz, izz = (float(inertia.get(moment, "0")) for moment in _MOMENTS)
    low, middle, high = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]).tolist()
    if low < 0 or high > low + middle:
        mean = repr(max((ixx + iyy + izz) / 3, 0.0))
        inertia.attrib.update(dict.fromkeys(_MOMENTS, "0") | {"ixx": mean, "iyy": mean, "izz": mean})


def _box(collision: ET.Element) -> tuple[float, float, float] | None:
    """Return the extents in m of a primitive shape; None for meshes."""
    shape = collision.find("geometry/*")
    if shape is None or shape.tag == "mesh":
        return None
    if shape.tag == "box":
        x, y, z = (float(part) for part in shape.get("size", "").split())
        return x, y, z
    d = 2 * float(shape.get("radius", "0"))
    return d, d, float(shape.get("length", d))
