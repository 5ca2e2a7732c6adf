"""Canonical URDF: the form of URDF that the engine, viewers and recordings read.

Canonical URDF has only elements that URDF defines, and no invalid link: PyBullet would reject such a link without a
reason, or load it silently. Chains of single joints replace planar and floating joints. Each element starts a new line,
because PyBullet breaks lines after 8,191 characters, even inside a number. Numbers keep their digits.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np

from pycram.foundation.failures import AssetError
from pycram.models.files import parse_urdf
from recorder.urdf import Urdf, finite

_OWN_CHILDREN: Final[dict[str, tuple[str, ...]]] = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision", "contact"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
    "material": ("color", "texture"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}
_ANY_CHILD: Final = ("geometry", "contact")  # _check_shape() checks shapes; "contact" is an element of PyBullet
_MAX_JOINTS: Final = 127  # maximum number of joints, including fixed joints; with more, PyBullet returns no states
_MAX_MOVABLE: Final = 121  # maximum number of movable joints: PyBullet's state has 128 values, 7 for the base's pose
_MAX_NAME: Final = 1000  # maximum length of a name in bytes; PyBullet crashes at about 1,024
_FAR: Final = "10000"  # limit in m of the chains that replace planar and floating joints
_SLIDE: Final = f'<limit lower="-{_FAR}" upper="{_FAR}" effort="0" velocity="0"/>'
LARGEST: Final = 1e9  # largest number in a link (m, kg or kg m^2): the engine turns larger numbers into infinity
DENSITY: Final = 700.0  # density in kg/m^3 of household objects of unknown mass
_FRAME_MASS: Final = 1e-3  # mass in kg of a link without shapes
_FRAME_INERTIA: Final = 1e-6  # kg m^2
_JOINT_INERTIA: Final = 0.05  # inertia in kg m^2 of links that only connect two joints, so that motors converge
_ROUNDING: Final = 1e-9  # lowest accepted moment in kg m^2; mesh tools round moments to slightly below 0
_SHAPES: Final = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
    "mesh": (),
}
_MOMENTS: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read(source: Path, content: str | bytes, scale: float = 1.0) -> ET.Element:
    """Return the checked <robot> element of a URDF in metres, without elements that URDF doesn't define.

    ``scale`` is the number of metres in the file's unit of length. AssetError is raised if the text isn't XML, isn't a
    URDF, or has a link that the engine can't use.
    """
    try:
        root = ET.fromstring(content)  # noqa: S314  the user chose the file, and expat limits the expansion of entities
    except (ET.ParseError, LookupError, ValueError) as error:
        raise AssetError(source, f"the file is not well-formed XML: {error}") from error
    namespace, end, tag = root.tag.rpartition("}")
    if tag == "robot" and end:  # URDFs of Drake have a default namespace
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace + end)
    if root.tag != "robot":
        raise AssetError(source, f"the root element is <{root.tag}>, not <robot>")
    _strip(root)
    if root.find("link") is None:
        raise AssetError(source, "the URDF has no links")
    if not root.get("name", "").strip():
        raise AssetError(source, "the element <robot> has no name")
    _scale(root, scale)
    for link in root.findall("link"):
        check_link(source, link)
    return root


def _scale(root: ET.Element, scale: float) -> None:
    """Convert shapes, origins, prismatic joints and moments of inertia of a URDF to metres; masses stay in kg."""
    if scale == 1.0:
        return
    for element in root.iter("origin"):
        _multiply(element, ("xyz",), scale)
    for geometry in root.iter("geometry"):
        for shape in geometry:
            if shape.tag == "mesh":
                shape.set("scale", shape.get("scale", "1 1 1"))
            _multiply(shape, ("size", "radius", "length", "scale"), scale)
    for inertia in root.iter("inertia"):
        _multiply(inertia, _MOMENTS, scale * scale)
    units = {joint.get("name"): scale if joint.get("type") == "prismatic" else 1.0 for joint in root.findall("joint")}
    for joint in root.findall("joint"):
        unit = units[joint.get("name")]
        for limit in joint.findall("limit"):
            _multiply(limit, ("lower", "upper", "velocity"), unit)
        for mimic in joint.findall("mimic"):
            mimic.set("multiplier", mimic.get("multiplier", "1"))
            _multiply(mimic, ("offset",), unit)
            _multiply(mimic, ("multiplier",), unit / units.get(mimic.get("joint"), 1.0))


def _multiply(element: ET.Element, attributes: Iterable[str], factor: float) -> None:
    """Multiply the numbers in attributes; invalid numbers remain, and later checks report them."""
    for attribute in attributes if factor != 1.0 else ():
        with suppress(ValueError):
            numbers = [finite(part) * factor for part in element.attrib.get(attribute, "").split()]
            if numbers:
                element.set(attribute, " ".join(map(repr, numbers)))


def _strip(element: ET.Element) -> None:
    """Remove elements that URDF doesn't define; skip the children of removed elements, which may be nested deeply."""
    own = _OWN_CHILDREN.get(element.tag, ())
    for child in list(element):
        if child.tag in own:
            _strip(child)
        elif element.tag in _ANY_CHILD and not child.tag.startswith("{"):
            del child[:]  # shapes have no children
        else:
            element.remove(child)


def check_link(source: Path, link: ET.Element) -> None:
    """Raise an AssetError if a shape of a ``<link>`` is missing, unknown or impossible, or if a number isn't finite."""
    where = f"link {link.get('name', '')!r}"
    for role in ("visual", "collision"):
        for element in link.findall(role):
            _check_origin(source, f"{where}, {role}", element)
            _check_shape(source, f"{where}, {role}", element.find("geometry"))
            for color in element.iter("color"):
                rgba = _numbers(source, f"{where}, color", color, "rgba", 4)
                if min(rgba) < 0 or max(rgba) > 1:
                    raise AssetError(source, f"{where}: the colour {color.get('rgba')!r} isn't between 0 and 1")
    inertial = link.find("inertial")
    if inertial is not None:
        _check_inertial(source, where, inertial)


def _check_shape(source: Path, where: str, geometry: ET.Element | None) -> None:
    shapes = list(geometry) if geometry is not None else []
    if len(shapes) != 1:
        raise AssetError(source, f"{where}: <geometry> must contain one shape, but contains {len(shapes) or 'none'}")
    shape = shapes[0]
    if shape.tag not in _SHAPES:
        raise AssetError(source, f"{where}: <{shape.tag}> isn't a shape; shapes are {', '.join(_SHAPES)}")
    for attribute, count in _SHAPES[shape.tag]:
        if min(_numbers(source, f"{where}, {shape.tag}", shape, attribute, count)) <= 0:
            reason = f"{attribute} of the {shape.tag} is {shape.get(attribute)!r}, not above 0"
            raise AssetError(source, f"{where}: {reason}")
    if shape.get("scale") is not None and 0.0 in _numbers(source, f"{where}, mesh", shape, "scale", 3):
        raise AssetError(source, f"{where}: a mesh scaled by {shape.get('scale')!r} has no volume")


def _check_inertial(source: Path, where: str, inertial: ET.Element) -> None:
    _check_origin(source, f"{where}, inertial", inertial)
    for name, attributes in (("mass", ("value",)), ("inertia", _MOMENTS)):
        element = inertial.find(name)
        if element is None:
            raise AssetError(source, f"{where}: <inertial> has no <{name}>")
        for attribute in attributes:
            (value,) = _numbers(source, f"{where}, {name}", element, attribute, 1)
            if value < -_ROUNDING and attribute in ("value", "ixx", "iyy", "izz"):
                raise AssetError(source, f"{where}: {name} is {element.get(attribute)!r}, less than 0")


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
        question = "is the file in millimetres? Object(..., scale=0.001)"
        raise AssetError(source, f"{where}: {attribute} is {text!r}: the maximum is {LARGEST:g}; {question}")
    return values


def write(source: Path, root: ET.Element) -> tuple[bytes, Urdf]:
    """Return the canonical text and the tree of a <robot> element from :func:`read`; this modifies the element.

    AssetError is raised if the links aren't a tree, a joint is invalid, or the engine can't handle so many joints.
    """
    tree = parse_urdf(ET.tostring(root), source, chains=True)
    chains = [joint for joint in root.findall("joint") if joint.get("type") in ("planar", "floating")]
    for joint in chains:
        _make_chain(root, joint, tree)
    if chains:
        tree = parse_urdf(ET.tostring(root), source)
    moved = {joint.child for joint in tree.joints.values() if joint.movable}
    for link in root.findall("link"):
        give_inertia(link, moved=link.get("name") in moved)
    for joint in root.findall("joint"):
        # PyBullet multiplies joint values by the axis, so its length must be 1
        known = tree.joints[joint.get("name", "")]
        axis, limit = joint.find("axis"), joint.find("limit")
        if known.movable:
            axis = ET.SubElement(joint, "axis") if axis is None else axis  # without an axis, PyBullet prints a warning
            axis.set("xyz", " ".join(map(repr, known.axis)))
        if limit is not None and known.type == "continuous":
            for bound in ("lower", "upper"):
                limit.attrib.pop(bound, None)
    check_size(source, tree)
    ET.indent(root, " ")
    content = ET.tostring(root)
    return content, parse_urdf(content, source)


def _make_chain(root: ET.Element, element: ET.Element, tree: Urdf) -> None:
    """Replace a planar or floating joint by single joints, with links between them.

    A planar joint NAME becomes NAME_x and NAME_y in its plane, and NAME_yaw about its axis. A floating joint NAME
    becomes NAME_x, NAME_y, NAME_z, NAME_yaw, NAME_pitch and NAME_roll, each along or about an axis of the link before.
    """
    name = element.get("name", "")
    if element.get("type") == "planar":
        normal = np.array(tree.joints[name].axis)
        first = next(unit for unit in np.eye(3) if abs(unit @ normal) < 0.9)
        first = first - (first @ normal) * normal
        first /= np.linalg.norm(first)
        axes = {"x": first, "y": np.cross(normal, first), "yaw": normal}
    else:
        x, y, z = np.eye(3)
        axes = {"x": x, "y": y, "z": z, "yaw": z, "pitch": y, "roll": x}
    parent = tree.joints[name].parent
    place = list(root).index(element)
    root.remove(element)
    for number, (part, axis) in enumerate(axes.items()):
        slides = part in ("x", "y", "z")
        joint = ET.Element("joint", name=f"{name}_{part}", type="prismatic" if slides else "continuous")
        origin = element.find("origin")
        if number == 0 and origin is not None:
            joint.append(origin)
        child = tree.joints[name].child if number == len(axes) - 1 else f"{name}_{part}_link"
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(joint, "axis", xyz=" ".join(map(repr, axis.tolist())))
        if slides:
            joint.append(ET.fromstring(_SLIDE))  # noqa: S314  a constant
        if child != tree.joints[name].child:
            ET.SubElement(root, "link", name=child)
        root.insert(place + number, joint)
        parent = child


def give_inertia(link: ET.Element, *, moved: bool) -> None:
    """Add the inertia of a household object to a checked ``<link>`` element without inertia.

    A link without shapes gets a negligible inertia, because PyBullet would use 1 kg and print a warning. If two moments
    add up to less than the third, their mean replaces all three, because the engine would replace them by 0. ``moved``
    is whether a joint moves the link.
    """
    inertia = link.find("inertial/inertia")
    if inertia is not None:
        ixx, ixy, ixz, iyy, iyz, izz = (float(inertia.get(moment, "0")) for moment in _MOMENTS)
        low, middle, high = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]).tolist()
        if low < 0 or high > low + middle:
            mean = repr(max((ixx + iyy + izz) / 3, 0.0))
            inertia.attrib.update(dict.fromkeys(_MOMENTS, "0") | {"ixx": mean, "iyy": mean, "izz": mean})
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


def _box(collision: ET.Element) -> tuple[float, float, float] | None:
    """Return the extents of a primitive shape in m; None for meshes."""
    shape = collision.find("geometry/*")
    if shape is None or shape.tag == "mesh":
        return None
    if shape.tag == "box":
        x, y, z = (float(part) for part in shape.get("size", "").split())
        return x, y, z
    d = 2 * float(shape.get("radius", "0"))
    return d, d, float(shape.get("length", d))


def check_size(source: Path, tree: Urdf) -> None:
    """Raise an AssetError if the engine can't handle the number of joints, the lengths of names or the distances."""
    for count, most, what in (
        (len(tree.joints), _MAX_JOINTS, "joints, including fixed joints"),
        (len(tree.movable), _MAX_MOVABLE, "movable joints"),
    ):
        if count > most:
            raise AssetError(source, f"the URDF has {count} {what}: the physics engine takes at most {most}")
    for name in (tree.name, *tree.links, *tree.joints):
        if len(name.encode()) > _MAX_NAME:
            reason = f"a name has {len(name.encode())} bytes, {name[:20]}..."
            raise AssetError(source, f"{reason}: the physics engine takes at most {_MAX_NAME}")
    for joint in tree.joints.values():
        at, _ = joint.origin
        if max(map(abs, at)) > LARGEST:
            raise AssetError(source, f"joint {joint.name!r}: the origin {at} has a coordinate above {LARGEST:g}")
