"""Finding the surfaces and containers of a model in its shapes and joints.

A level face (:mod:`pycram.models.level_faces`) is a surface if the face is accessible from above or from a side, or if
a joint gives access. A drawer is a part with a horizontal prismatic joint, and with a surface or a handle. A door is a
moving part that blocks access to a surface when closed: all rays from the surface end nearby, and most hit the door.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from pycram.models.corrections import SUFFIX, correct, read
from pycram.models.level_faces import THINGS, Face, Piece, faces, first_met, pieces
from pycram.models.load import Model
from pycram.models.store import stored_tree
from pycram.models.surfaces import DOOR, DRAWER, Container, Furniture, Surface, closed_position, open_position
from recorder import geometry
from recorder.geometry import Pose, Quaternion
from recorder.urdf import Urdf, UrdfJoint

_HIGHEST: Final = 1.8  # height in m above the model's lowest point; higher surfaces are out of reach and sight
_GROUND: Final = 10.0  # minimum area in m^2 of a floor
_NARROW: Final = 0.2  # maximum width in m of the top of a wall
_UPRIGHT: Final = 4.0  # minimum ratio of height to width of a wall
_RAYS: Final = 24  # number of horizontal directions
_NEAR: Final = 0.6  # maximum distance in m between a surface's outline and a part that hides the surface
_HEIGHTS: Final = (0.3, 0.6, 0.9)  # heights of rays above a surface, as shares of ``_HAND``
_HAND: Final = 0.2  # free height in m that a hand needs
_LEVEL: Final = 0.5  # maximum |z| of the unit axis of a horizontal joint
_TRAVEL: Final = (0.05, 2.0)  # range in m of the travel of a drawer
_HANDLE: Final = ("handle", "knob", "grip", "pull")  # words in the names of handles
_ANGLES: Final = np.arange(_RAYS) * 2 * math.pi / _RAYS
_DIRECTIONS: Final = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(_RAYS)])
_UP: Final = np.array([0.0, 0.0, 1.0])
_CACHED_MODELS: Final = 128
_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_EMPTY: Final = frozenset({"link", "main", "surface", "area", "frame", "body", "base", "part"})  # words without meaning


def furniture_of(model: Model) -> Furniture:
    """Return the surfaces and containers of a model, with the corrections in the TOML file next to it."""
    beside = next((file for file in model.files if file.name.endswith(SUFFIX)), None)
    return _furniture(model.path, beside.content if beside else b"", beside.name if beside else "")


@lru_cache(maxsize=_CACHED_MODELS)
def _furniture(path: Path, corrections: bytes, source: str) -> Furniture:
    urdf = stored_tree(path)
    found = find_furniture(path, urdf)
    return correct(found, read(corrections.decode(), source), urdf) if corrections else found


def find_furniture(path: Path, urdf: Urdf) -> Furniture:
    """Return the surfaces and containers of a canonical URDF, without corrections."""
    poses = urdf.link_poses({name: closed_position(urdf.joints[name]) for name in urdf.movable})
    every = pieces(path, poses)
    floor = min((float(piece.low[2]) for piece in every), default=0.0)
    return _Search(urdf, poses, every, [face for face in faces(every) if _is_usable(face, floor, every)]).furniture()


@lru_cache(maxsize=_CACHED_MODELS)
def tops_of(path: Path, orientation: Quaternion) -> tuple[Surface, ...]:
    """Return the surfaces on top of a free object with closed joints, such as a plate, a tray or a box.

    ``orientation`` is xyzw of the object in the world; the top of an object that lies on its side is another face.
    """
    urdf = stored_tree(path)
    turned = (0.0, 0.0, 0.0), orientation
    closed = urdf.link_poses({name: closed_position(urdf.joints[name]) for name in urdf.movable})
    poses = {link: geometry.multiply(turned, pose) for link, pose in closed.items()}
    every = pieces(path, poses)
    found = [face for face in faces(every, THINGS) if face.clearance == math.inf] if every else []
    names = distinct("top" for _ in found)
    return tuple(surface_of(name, face, poses) for name, face in zip(names, found, strict=True))


def _is_usable(face: Face, floor: float, every: Sequence[Piece]) -> bool:
    """Return whether a face is a surface: not a floor, nor the top of a wall, nor out of reach."""
    if face.area > _GROUND or face.middle[2] - floor > _HIGHEST:
        return False
    width = float(np.ptp(face.outline, axis=0).min())
    below = [float(piece.low[2]) for piece in every if piece.link == face.link and piece.high[2] >= face.middle[2]]
    upright = bool(below) and face.middle[2] - min(below) > _UPRIGHT * width
    return not (width < _NARROW and upright and face.clearance == math.inf)


class _Search:
    """The search for accessible faces of a model, and for the joints that give access.

    ``poses`` are the poses of the links in the root link, with closed joints; ``offered`` are all level faces.
    """

    def __init__(self, urdf: Urdf, poses: Mapping[str, Pose], every: Sequence[Piece], offered: Sequence[Face]) -> None:
        self._urdf, self._poses, self._every, self._offered = urdf, poses, every, offered
        self._movers: dict[str, UrdfJoint | None] = {}  # the nearest movable joint above each link in the URDF's tree
        for link in urdf.links:
            joint = urdf.parent_joint(link)
            if joint is None or joint.movable:
                self._movers[link] = joint
            else:
                self._movers[link] = self._movers[joint.parent]

    def furniture(self) -> Furniture:
        drawers = {joint.name for face in self._offered if (joint := self._drawer(face.link)) is not None}
        kept: list[tuple[Face, str]] = []  # faces, each with the joint that gives access; "" without such a joint
        for face in self._offered:
            drawer = self._drawer(face.link)
            opened = drawer.name if drawer is not None else self._opened_by(face, drawers)
            if opened is not None:
                kept.append((face, opened))
        doors = {opened for _, opened in kept} - drawers - {""}
        for number, (face, opened) in enumerate(kept):
            mover = self._movers[face.link]
            if not opened and mover is not None and mover.name in doors:  # a rack on the inner side of a door
                kept[number] = face, mover.name
        solid = {
            name
            for name, joint in self._urdf.joints.items()
            if joint.movable and name not in doors and self._drawer(joint.child) and self._handle(joint)
        }
        return self._named(kept, drawers | solid)

    def _drawer(self, link: str) -> UrdfJoint | None:
        """Return the joint that moves a link like a drawer; None if there is no such joint."""
        joint = self._movers[link]
        if joint is None or joint.type != "prismatic" or not _TRAVEL[0] <= joint.upper - joint.lower <= _TRAVEL[1]:
            return None
        return joint if abs(geometry.rotate(self._poses[joint.child][1], joint.axis)[2]) < _LEVEL else None

    def _opened_by(self, face: Face, drawers: set[str]) -> str | None:
        """Return the joint of the door that hides a face; "" for a visible face, None if no joint gives access."""
        if face.clearance == math.inf:
            return ""
        reach = float(np.linalg.norm(face.outline, axis=1).max()) + _NEAR
        low, high = face.middle[:2] - reach, face.middle[:2] + reach
        near = [
            piece
            for piece in self._every
            if piece.high[2] > face.middle[2] and (piece.high[:2] > low).all() and (piece.low[:2] < high).all()
        ]
        heights = [share * min(face.clearance, _HAND) for share in _HEIGHTS]
        origins = np.vstack([np.tile(face.middle + height * _UP, (_RAYS, 1)) for height in heights] + [face.middle])
        first, distances = first_met(near, origins, np.vstack([_DIRECTIONS] * len(heights) + [_UP]))
        far = distances > reach
        if far[-1] or far[:-1].reshape(len(heights), _RAYS).all(axis=0).any():
            return ""
        movers = [self._movers[near[number].link] for number in first[~far]]
        doors = Counter(joint.name for joint in movers if joint is not None and joint.name not in drawers)
        hinged = [name for name, _ in doors.most_common() if math.isfinite(self._urdf.joints[name].upper)]
        return hinged[0] if hinged else None

    def _named(self, kept: Sequence[tuple[Face, str]], drawers: set[str]) -> Furniture:
        opening = {opened for _, opened in kept if opened} | drawers
        joints = [name for name in self._urdf.joints if name in opening]
        names = [
            readable(self._urdf.joints[name].child, self._urdf.name, () if name in drawers else ("door",))
            for name in joints
        ]
        by_joint = dict(zip(joints, distinct(names), strict=True))
        # numbers in names follow this order: from low to high in a container, otherwise by size
        order = sorted(range(len(kept)), key=lambda number: 0.0 if kept[number][1] else -kept[number][0].area)
        links = (readable(kept[number][0].link, self._urdf.name) for number in order)
        named = dict(zip(order, distinct(links), strict=True))
        surfaces = [
            surface_of(named[number], face, self._poses, by_joint.get(opened, ""))
            for number, (face, opened) in enumerate(kept)
        ]
        containers = {}
        for opener, name in by_joint.items():
            joint, kind = self._urdf.joints[opener], DRAWER if opener in drawers else DOOR
            inside = tuple(surface.name for surface in surfaces if surface.container == name)
            ends = closed_position(joint), open_position(joint)
            containers[name] = Container(name, kind, joint.child, joint.name, self._handle(joint), *ends, inside)
        by_name = {surface.name: surface for surface in surfaces}
        return Furniture(MappingProxyType(by_name), MappingProxyType(containers))

    def _handle(self, joint: UrdfJoint) -> str:
        """Return the link that a joint moves and that is named like a handle; "" if there is no such link."""
        moved = [link for link, mover in self._movers.items() if mover is joint and link != joint.child]
        return next((link for word in _HANDLE for link in moved if word in link.casefold()), "")


def surface_of(name: str, face: Face, poses: Mapping[str, Pose], container: str = "") -> Surface:
    """Convert a face to a surface of its link."""
    x, y, z = face.middle.tolist()
    pose = (x, y, z), geometry.from_rpy(0.0, 0.0, face.yaw)
    position, orientation = geometry.multiply(geometry.invert(poses[face.link]), pose)
    outline = tuple((float(a), float(b)) for a, b in face.outline)
    return Surface(name, face.link, position, orientation, outline, face.clearance, container)


def readable(link: str, model: str, dropped: Iterable[str] = ()) -> str:
    """Return the words of a link's name without the model's name, meaningless words and ``dropped`` words."""
    every = [word.casefold() for word in _WORDS.findall(link)]
    own = [word.casefold() for word in _WORDS.findall(model)]
    if every[: len(own)] == own:
        every = every[len(own) :]
    empty = _EMPTY | set(dropped)
    said = [
        word
        for number, word in enumerate(every)
        if word not in empty and (word.isdecimal() or word not in every[:number])
    ]
    return " ".join(said) or " ".join(word for word in every if word not in dropped) or link


def distinct(names: Iterable[str]) -> list[str]:
    """Return unique names: the second and further occurrences of a name get a number from 2."""
    taken: dict[str, int] = {}
    given = []
    for name in names:
        taken[name] = taken.get(name, 0) + 1
        given.append(name if taken[name] == 1 else f"{name} {taken[name]}")
    return given
