"""Rigid parts and single links of a model, as separate models for collision checks and simulation clones.

An engine's step takes longer with more links, even if they are distant. Loading takes longer with more meshes. So
simulation clones load furniture as rigid parts, and collision checks load single links.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from pycram.models import store
from pycram.models.store import stored_tree
from recorder import geometry
from recorder.geometry import Pose

_INERTIA: Final = {"ixx": "1", "iyy": "1", "izz": "1", "ixy": "0", "ixz": "0", "iyz": "0"}
_CACHED_MODELS: Final = 128
_CACHED_LINKS: Final = 4096


@dataclass(frozen=True, slots=True)
class RigidPart:
    """Links that are connected by fixed joints, merged into one link."""

    frame: str  # name of the link whose frame is the frame of the part
    links: tuple[str, ...]  # names of the merged links with collision shapes
    path: Path  # canonical URDF of the part


@lru_cache(maxsize=_CACHED_MODELS)
def divided(path: Path) -> tuple[RigidPart, ...]:
    """Return the rigid parts of a canonical URDF that have collision shapes.

    Links with different friction or stiffness are different parts, because a link has only one friction.
    """
    elements = {link.get("name", ""): link for link in store.document(path).findall("link")}
    urdf = stored_tree(path)
    frames: dict[str, str] = {}
    parts: dict[tuple[str, bytes], list[str]] = {}
    for link in urdf.links:  # parents come before their children
        joint = urdf.parent_joint(link)
        frames[link] = frame = link if joint is None or joint.type != "fixed" else frames[joint.parent]
        element = elements[link]
        if element.find("collision") is not None:
            contact = b"".join(ET.tostring(each) for each in element.findall("contact"))
            parts.setdefault((frame, contact), []).append(link)
    poses = urdf.link_poses({})
    found = []
    for (frame, _), links in parts.items():
        placed = [(elements[link], geometry.multiply(geometry.invert(poses[frame]), poses[link])) for link in links]
        found.append(RigidPart(frame, tuple(links), _write(frame, placed)))
    return tuple(found)


@lru_cache(maxsize=_CACHED_LINKS)
def single_link(path: Path, link: str) -> Path:
    """Return the URDF of a model that consists of one link of a canonical URDF."""
    elements = store.document(path).findall("link")
    return _write(link, [(element, geometry.IDENTITY) for element in elements if element.get("name") == link])


def _write(name: str, links: Iterable[tuple[ET.Element, Pose]]) -> Path:
    """Store a model of one link that has the collision shapes of links of equal friction, at poses in the new link."""
    root = ET.Element("robot", name=name)
    merged = ET.SubElement(root, "link", name=name)
    inertial = ET.SubElement(merged, "inertial")  # the inertia doesn't matter, because the base of a part is fixed
    ET.SubElement(inertial, "mass", value="1")
    ET.SubElement(inertial, "inertia", attrib=_INERTIA)
    for link, pose in links:
        if not merged.findall("contact"):
            merged.extend(link.findall("contact"))
        merged.extend(_moved(collision, pose) for collision in link.findall("collision"))
    return store.write_urdf(f"{name}.urdf", ET.tostring(root))[0]


def _moved(collision: ET.Element, pose: Pose) -> ET.Element:
    """Return a <collision> element in another frame; ``pose`` is the pose of its link in that frame."""
    if pose == geometry.IDENTITY:
        return collision
    moved = copy.copy(collision)
    origin = moved.find("origin")
    xyz, rpy = ("0 0 0", "0 0 0") if origin is None else (origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0"))
    if origin is not None:
        moved.remove(origin)
    x, y, z = map(float, xyz.split())
    at, turn = geometry.multiply(pose, ((x, y, z), geometry.from_rpy(*map(float, rpy.split()))))
    attributes = {"xyz": " ".join(map(repr, at)), "rpy": " ".join(map(repr, geometry.to_rpy(turn)))}
    moved.append(ET.Element("origin", attributes))
    return moved
