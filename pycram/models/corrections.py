"""Corrections of found furniture in a TOML file next to the URDF: ``kitchen.furniture.toml`` for ``kitchen.urdf``.

A table corrects the found surface or container with its name, or adds a surface or container with a new name
(``docs/guides/furniture.md``). Names of links and joints are checked when the model is loaded, and names of furniture
when the furniture is found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from pycram.foundation import checks
from pycram.foundation.failures import AssetError, BadArgument
from pycram.models.files import parse_toml
from pycram.models.surfaces import DOOR, DRAWER, Container, Furniture, Surface, closed_position, open_position
from recorder import geometry
from recorder.errors import did_you_mean, suggestion
from recorder.records.values import AssetFile
from recorder.urdf import Urdf

SUFFIX: Final = ".furniture.toml"
_SURFACES: Final = "surfaces"
_CONTAINERS: Final = "containers"
_CACHED: Final = 128
_NEW: Final = {_SURFACES: ("link", "position", "size or outline"), _CONTAINERS: ("joint", "kind")}


@dataclass(frozen=True)
class Corrections:
    """The checked entries of a TOML file."""

    source: str  # name of the file, for errors
    surfaces: Mapping[str, Mapping[str, Any]]  # entries of each surface by its name
    containers: Mapping[str, Mapping[str, Any]]  # entries of each container by its name


def asset(name: str, content: bytes) -> AssetFile:
    """Return a TOML file as an entry in the list of a model's files."""
    return AssetFile(name, content, "application/toml")


def _polygon(argument: str, value: object) -> tuple[tuple[float, float], ...]:
    points: list[tuple[float, float]] = []
    for point in value if isinstance(value, list) else ():
        x, y, _ = checks.vector(argument, [*point, 0.0] if isinstance(point, list) else point)
        points.append((x, y))
    turns = [
        (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        for a, b, c in zip(points, points[1:] + points[:1], points[2:] + points[:2], strict=True)
    ]
    if len(points) < 3 or min(turns) <= 0:
        raise BadArgument(argument, value, "three or more corners [x, y] of a convex polygon, counter-clockwise")
    return tuple(points)


def _rectangle(argument: str, value: object) -> tuple[tuple[float, float], ...]:
    x, y, _ = checks.vector(argument, [*value, 0.0] if isinstance(value, list) else value)
    if min(x, y) <= 0:
        raise BadArgument(argument, value, "two lengths [x, y] above 0 m")
    a, b = x / 2, y / 2
    return (-a, -b), (a, -b), (a, b), (-a, b)


def _optional_text(argument: str, value: object) -> str:
    return "" if value == "" else checks.text(argument, value)


ENTRIES: Final[Mapping[str, Mapping[str, Callable[[str, object], Any]]]] = {
    _SURFACES: {
        "name": checks.text,
        "remove": checks.switch,
        "link": checks.text,
        "position": checks.vector,
        "orientation": checks.quaternion,
        "size": _rectangle,
        "outline": _polygon,
        "clearance": lambda name, value: math.inf if value == math.inf else checks.in_range(name, value, 0.0),
        "container": _optional_text,
    },
    _CONTAINERS: {
        "name": checks.text,
        "remove": checks.switch,
        "kind": lambda name, value: checks.one_of(name, value, (DRAWER, DOOR)),
        "joint": checks.text,
        "handle": _optional_text,
        "closed": checks.number,
        "open": checks.number,
    },
}


@lru_cache(maxsize=_CACHED)
def read(text: str, source: str | Path) -> Corrections:
    """Return the corrections of a TOML text; raise an AssetError for an unknown or impossible entry."""
    tables = parse_toml(text, source)
    for key in tables:
        if key not in ENTRIES:
            raise AssetError(source, f"{key}: unknown entry; known entries are {' and '.join(ENTRIES)}")
    checked = {}
    for kind in ENTRIES:
        things = tables.get(kind, {})
        if not isinstance(things, dict):
            raise AssetError(source, f"{kind}: takes tables, such as [{kind}.island]")
        checked[kind] = {name: _checked(source, kind, name, said) for name, said in things.items()}
    return Corrections(str(source), checked[_SURFACES], checked[_CONTAINERS])


def _checked(source: str | Path, kind: str, name: str, said: object) -> Mapping[str, Any]:
    where, entries = f"{kind}.{name!r}", ENTRIES[kind]
    if not name or not isinstance(said, dict):
        raise AssetError(source, f"{where}: expected a table with a name, not {said!r}")
    for key in said:
        if key not in entries:
            raise AssetError(source, f"{where}.{key}: unknown entry; {suggestion(key, entries)}")
    if "size" in said and "outline" in said:
        raise AssetError(source, f"{where}: give either size or outline, not both")
    try:
        return MappingProxyType({key: entries[key](key, value) for key, value in said.items()})
    except BadArgument as error:
        raise AssetError(source, f"{where}: {error}") from error


def check(corrections: Corrections, urdf: Urdf) -> None:
    """Raise an AssetError if corrections name a link or movable joint that a URDF doesn't have."""
    for name, said in corrections.surfaces.items():
        _known(corrections, f"{_SURFACES}.{name!r}", "link", said.get("link"), urdf.links)
    for name, said in corrections.containers.items():
        where = f"{_CONTAINERS}.{name!r}"
        _known(corrections, where, "joint", said.get("joint"), urdf.movable)
        _known(corrections, where, "handle", said.get("handle") or None, urdf.links)


def _known(corrections: Corrections, where: str, key: str, value: str | None, known: Sequence[str]) -> None:
    if value is not None and value not in known:
        what = "movable joint" if key == "joint" else "link"
        raise AssetError(corrections.source, f"{where}.{key}: no {what} {value!r}; {suggestion(value, known)}")


def correct(found: Furniture, corrections: Corrections, urdf: Urdf) -> Furniture:
    """Return the corrected furniture; raise an AssetError for corrections of unknown furniture, or for equal names."""
    return _Correction(corrections, urdf).apply(found)


class _Correction:
    def __init__(self, corrections: Corrections, urdf: Urdf) -> None:
        self._said, self._urdf = corrections, urdf
        self._poses = urdf.link_poses({name: closed_position(urdf.joints[name]) for name in urdf.movable})

    def apply(self, found: Furniture) -> Furniture:
        containers: dict[str, Container] = {}
        names = {"": ""}  # corrected names of containers by their found names
        for key, container in self._things(_CONTAINERS, found.containers, self._said.containers):
            said = self._said.containers.get(key, {})
            corrected = self._container(said, container, said.get("name", key))
            names[key] = corrected.name
            self._add(_CONTAINERS, containers, corrected)
        surfaces: dict[str, Surface] = {}
        for key, surface in self._things(_SURFACES, found.surfaces, self._said.surfaces):
            said = self._said.surfaces.get(key, {})
            inside = said.get("container", names.get(surface.container, "") if surface else "")
            if inside not in {"", *containers}:
                raise self._error(_SURFACES, key, f"no container {inside!r}; {suggestion(inside, containers)}")
            self._add(_SURFACES, surfaces, self._surface(said, surface, said.get("name", key), inside))
        for name, container in containers.items():
            inside_it = tuple(surface.name for surface in surfaces.values() if surface.container == name)
            containers[name] = replace(container, surfaces=inside_it)
        return Furniture(MappingProxyType(surfaces), MappingProxyType(containers))

    def _things(self, kind: str, found: Mapping[str, Any], said: Mapping[str, Mapping[str, Any]]) -> list[Any]:
        """Return pairs of a name and a surface or container; None for an added thing. Removed things are left out."""
        for key, entries in said.items():
            needed = [part for part in _NEW[kind] if not any(name in entries for name in part.split(" or "))]
            if key not in found and (needed or "remove" in entries):
                hint = did_you_mean(key, found)
                takes = f"a new {kind[:-1]} takes {', '.join(_NEW[kind])}"
                raise self._error(kind, key, f"no {kind[:-1]} of that name was found{hint}; {takes}")
        every = {**found, **dict.fromkeys(key for key in said if key not in found)}
        return [(key, thing) for key, thing in every.items() if not said.get(key, {}).get("remove", False)]

    def _add(self, kind: str, things: dict[str, Any], thing: Surface | Container) -> None:
        if thing.name in things:
            raise self._error(kind, thing.name, f"two {kind} have that name")
        things[thing.name] = thing

    def _surface(self, said: Mapping[str, Any], found: Surface | None, name: str, container: str) -> Surface:
        given = {key: said[key] for key in ("link", "position", "orientation", "outline", "clearance") if key in said}
        if "size" in said:
            given["outline"] = said["size"]
        if found is None:
            upright = geometry.conjugate(self._poses[said["link"]][1])
            found = Surface(name, said["link"], said["position"], upright, (), math.inf)
        return replace(found, name=name, container=container, **given)

    def _container(self, said: Mapping[str, Any], found: Container | None, name: str) -> Container:
        joint = self._urdf.joints[said.get("joint") or (found.joint if found else "")]
        same = found is not None and found.joint == joint.name
        closed = said.get("closed", found.closed if found and same else closed_position(joint))
        wide = said.get("open", found.open if found and same else open_position(joint))
        for key, value in (("closed", closed), ("open", wide)):
            if not joint.lower <= value <= joint.upper or not math.isfinite(value):
                reason = f"{key} is {value:g}, outside the limits of {joint.name}, {joint.lower:g} to {joint.upper:g}"
                raise self._error(_CONTAINERS, name, reason)
        kind = said.get("kind") or (found.kind if found else "")
        handle = said.get("handle", found.handle if found and same else "")
        return Container(name, kind, joint.child, joint.name, handle, closed, wide, ())

    def _error(self, kind: str, name: str, reason: str) -> AssetError:
        return AssetError(self._said.source, f"{kind}.{name!r}: {reason}")
