"""Furniture as data: surfaces on which objects stand, and containers that a robot can open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from recorder.geometry import Pose, Quaternion, Vector
from recorder.urdf import UrdfJoint

DRAWER: Final = "drawer"
DOOR: Final = "door"


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface on which objects can stand, such as a counter, a shelf or the bottom of a drawer."""

    name: str  # name, unique in the furniture
    link: str
    position: Vector  # middle of the surface in the frame of the link, m
    orientation: Quaternion  # xyzw in the frame of the link; z points up if the furniture stands upright
    outline: tuple[tuple[float, float], ...]  # counter-clockwise corners x, y of a convex polygon, m
    clearance: float  # free height in m with closed containers; infinite if the surface is open above
    container: str = ""  # name of the container around the surface; "" without a container

    @property
    def pose(self) -> Pose:
        """Position and orientation in the frame of the link."""
        return self.position, self.orientation

    @property
    def size(self) -> tuple[float, float]:
        """Extents of the outline along x and y, m."""
        x, y = zip(*self.outline, strict=True)
        return max(x) - min(x), max(y) - min(y)


@dataclass(frozen=True, slots=True)
class Container:
    """A part of furniture that a robot opens to reach the objects inside, such as a drawer, a fridge or a cupboard."""

    name: str  # name, unique in the furniture
    kind: str  # "drawer" if the contents move with the part, else "door"
    link: str  # the moving part
    joint: str  # the joint that moves the part
    handle: str  # link of the handle; "" without a handle
    closed: float  # joint position when closed, rad or m
    open: float  # joint position when fully open, rad or m
    surfaces: tuple[str, ...]  # names of the surfaces inside


@dataclass(frozen=True, slots=True)
class Furniture:
    """Surfaces and containers of a model by their names."""

    surfaces: Mapping[str, Surface] = field(default_factory=lambda: MappingProxyType({}))
    containers: Mapping[str, Container] = field(default_factory=lambda: MappingProxyType({}))


NONE: Final = Furniture()  # the furniture of a model without surfaces and containers


def closed_position(joint: UrdfJoint) -> float:
    """Return the joint position of a closed door or drawer, rad or m: the position nearest to 0 within the limits."""
    return min(max(joint.lower, 0.0), joint.upper)


def open_position(joint: UrdfJoint) -> float:
    """Return the joint position of an open door or drawer, rad or m: the limit farther from the closed position."""
    closed = closed_position(joint)
    return max((joint.lower, joint.upper), key=lambda position: abs(position - closed))
