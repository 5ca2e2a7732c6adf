"""Canonical URDF: the one form that the engine, viewers and recordings read, whatever a file was like.

Only what URDF defines is kept: elements of Gazebo, of sensors and of others' namespaces go, with all that is in them,
before anything is read. Planar and floating joints become chains of joints that the engine knows. Each element begins a
line, for PyBullet breaks lines after 8,191 characters, also within a number. Numbers keep their digits.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation.failures import AssetError
from pycram.models import links
from pycram.models.files import parse_urdf

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.urdf import Urdf

_OWN_CHILDREN: Final[dict[str, tuple[str, ...]]] = {
    "robot": ("link", "joint", "material"),
    "link": ("inertial", "visual", "collision", "contact"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
    "material": ("color", "texture"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}
_ANY_CHILD: Final = ("geometry", "contact")  # shapes are checked by name; contact is PyBullet's
_XACRO: Final = "ros.org/wiki/xacro}"
_MAX_JOINTS: Final = 127  # of PyBullet, fixed ones too; with one more it returns no states
_MAX_MOVABLE: Final = 121  # 128 numbers of state less 7 of the base
_MAX_NAME: Final = 1000  # bytes of a name; from about 1,024 on PyBullet crashes, and the process with it
_FAR: Final = "10000"  # m: planar and floating joints have no limits
_SLIDE: Final = f'<limit lower="-{_FAR}" upper="{_FAR}" effort="0" velocity="0"/>'


def read(source: Path, content: str | bytes) -> ET.Element:
    """Return the checked <robot> element of a URDF with nothing but URDF in it.

    Args:
        source: Its file, for errors.
        content: Its text.

    Raises:
        AssetError: It isn't XML or no URDF, is xacro, or has a link that the engine can't use.
    """
    try:
        root = ET.fromstring(content)  # noqa: S314  a model of the user's own, and expat limits entity expansion
    except (ET.ParseError, LookupError, ValueError) as error:
        if b"<xacro:" in (content.encode() if isinstance(content, str) else content):
            raise _expand_first(source) from error
        raise AssetError(source, f"is not well-formed XML: {error}") from error
    if source.suffix == ".xacro" or any(_XACRO in element.tag for element in root.iter()):
        raise _expand_first(source)
    _unqualify(root)
    if root.tag != "robot":
        raise AssetError(source, f"its root element is <{root.tag}>, not <robot>")
    _strip(root)
    if root.find("link") is None:
        raise AssetError(source, "has no links")
    if not root.get("name", "").strip():
        raise AssetError(source, "its <robot> has no name")
    for link in root.findall("link"):
        links.check(source, link)
    return root


def _expand_first(source: Path) -> AssetError:
    target = source.name.removesuffix(".xacro").removesuffix(".urdf") + ".urdf"
    target = target if target != source.name else f"expanded_{target}"
    return AssetError(source, f"is xacro, from which a URDF has yet to be made: xacro {source.name} > {target}")


def _unqualify(root: ET.Element) -> None:
    """Take from all names the namespace that a document declares for its own elements, as Drake's do."""
    namespace, end, tag = root.tag.rpartition("}")
    if tag == "robot" and end:
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace + end)


def _strip(element: ET.Element) -> None:
    """Remove what isn't URDF; no deeper than what is kept, however deep the rest is nested."""
    own = _OWN_CHILDREN.get(element.tag, ())
    for child in list(element):
        if child.tag in own:
            _strip(child)
        elif element.tag in _ANY_CHILD and not child.tag.startswith("{"):
            del child[:]  # a shape has no parts
        else:
            element.remove(child)


def write(source: Path, root: ET.Element) -> tuple[bytes, Urdf]:
    """Return the canonical text of what :func:`read` returned, which it changes, and its tree.

    Raises:
        AssetError: Its links and joints are no tree, a joint is broken, or they are more than the engine takes.
    """
    tree = parse_urdf(ET.tostring(root), source, chains=True)
    chains = [joint for joint in root.findall("joint") if joint.get("type") in ("planar", "floating")]
    for joint in chains:
        _make_chain(root, joint, tree)
    if chains:
        tree = parse_urdf(ET.tostring(root), source)
    moved = {joint.child for joint in tree.joints.values() if joint.movable}
    for link in root.findall("link"):
        links.give_inertia(link, moved=link.get("name") in moved)
    for joint in root.findall("joint"):
        _normalize(joint, tree)
    check_size(source, tree)
    ET.indent(root, " ")
    content = ET.tostring(root)
    return content, parse_urdf(content, source)


def _normalize(element: ET.Element, tree: Urdf) -> None:
    """Give an axis unit length, by which PyBullet would multiply joint values; take limits from a continuous joint."""
    joint = tree.joints[element.get("name", "")]
    axis, limit = element.find("axis"), element.find("limit")
    if joint.movable:
        axis = ET.SubElement(element, "axis") if axis is None else axis  # PyBullet would print that there is none
        axis.set("xyz", " ".join(map(repr, joint.axis)))
    if limit is not None and joint.type == "continuous":
        for bound in ("lower", "upper"):
            limit.attrib.pop(bound, None)


def check_size(source: Path, tree: Urdf) -> None:
    """Refuse a robot of more joints, with longer names, or with joints farther away, than the engine takes.

    Raises:
        AssetError: It is one.
    """
    for count, most, what in (
        (len(tree.joints), _MAX_JOINTS, "joints, fixed ones included"),
        (len(tree.movable), _MAX_MOVABLE, "movable joints"),
    ):
        if count > most:
            raise AssetError(source, f"has {count} {what}: the physics engine takes {most}")
    for name in (tree.name, *tree.links, *tree.joints):
        if len(name.encode()) > _MAX_NAME:
            reason = f"has a name of {len(name.encode())} bytes, {name[:20]}...: the physics engine takes {_MAX_NAME}"
            raise AssetError(source, reason)
    for joint in tree.joints.values():
        at, _ = joint.origin
        if max(map(abs, at)) > links.LARGEST:
            raise AssetError(source, f"joint {joint.name!r}: its origin is {at}: numbers go up to {links.LARGEST:g}")


def _make_chain(root: ET.Element, element: ET.Element, tree: Urdf) -> None:
    """Put single joints and frames between them in the place of a planar or floating joint.

    A planar joint NAME becomes NAME_x, NAME_y in its plane and NAME_yaw about its axis; a floating one NAME_x, NAME_y,
    NAME_z, NAME_yaw, NAME_pitch and NAME_roll, about the axes of the joint's frame as these turn along.
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
            joint.append(ET.fromstring(_SLIDE))  # noqa: S314  our own
        if child != tree.joints[name].child:
            ET.SubElement(root, "link", name=child)
        root.insert(place + number, joint)
        parent = child
