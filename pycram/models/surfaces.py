"""What furniture is to who works with it: surfaces that things stand on, and containers that are opened."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import Pose, Quaternion, Vector
    from recorder.urdf import Joint

DRAWER: Final = "drawer"
DOOR: Final = "door"


@dataclass(frozen=True, slots=True)
class Surface:
    """Where things can stand: on a counter, in a drawer, on a shelf."""

    name: str  # unique in its furniture
    link: str  # that it is on
    position: Vector  # of its middle, in the link's frame, m
    orientation: Quaternion  # in the link's frame, xyzw; z points up when the furniture stands as loaded
    outline: tuple[tuple[float, float], ...]  # corners of a convex polygon, counter-clockwise, x and y in that frame, m
    clearance: float  # free height above it while everything is closed, m; infinite if it is open above
    container: str = ""  # name of the container that it is in; "" if in none

    @property
    def pose(self) -> Pose:
        """Position and orientation in the link's frame."""
        return self.position, self.orientation

    @property
    def size(self) -> tuple[float, float]:
        """Extents of its outline along its own x and y, m."""
        x, y = zip(*self.outline, strict=True)
        return max(x) - min(x), max(y) - min(y)


@dataclass(frozen=True, slots=True)
class Container:
    """A drawer, a fridge, a cupboard: what is opened to get at what is inside."""

    name: str  # unique in its furniture
    kind: str  # "drawer", whose inside moves along, or "door", behind which it stays
    link: str  # the part that moves
    joint: str  # its joint
    handle: str  # link of its handle; "" if it has none
    closed: float  # position of the joint when it is closed, rad or m
    open: float  # position of the joint when it is open as far as it goes, rad or m
    surfaces: tuple[str, ...]  # names of the surfaces in it


@dataclass(frozen=True, slots=True)
class Furniture:
    """Surfaces and containers of a model by name."""

    surfaces: Mapping[str, Surface] = field(default_factory=lambda: MappingProxyType({}))
    containers: Mapping[str, Container] = field(default_factory=lambda: MappingProxyType({}))


NONE: Final = Furniture()
"""Of what is no furniture."""


def closed_position(joint: Joint) -> float:
    """Return where a door or drawer is closed, rad or m: at 0, or as near as its limits let it."""
    return min(max(joint.lower, 0.0), joint.upper)


def open_position(joint: Joint) -> float:
    """Return where a door or drawer is open, rad or m: at the limit of its joint that is farther from closed."""
    closed = closed_position(joint)
    return max((joint.lower, joint.upper), key=lambda position: abs(position - closed))
