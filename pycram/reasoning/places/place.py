"""Places, and what a robot is to reach from one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

from pycram.world.object import Object

if TYPE_CHECKING:
    from recorder.geometry import Quaternion, Vector


@dataclass(frozen=True, slots=True)
class Place:
    """Where a robot can stand, or an object.

    Attributes:
        position: of the robot's base, or of the object, in the world, m.
        orientation: of it, xyzw.
        arms: that reach from there, or to there; empty if that wasn't asked.
        score: of the maps, 0 to 1.
        surface: name of the surface that it is on; "" for the ground.
        grasps: by arm the side from which it takes the object that is to be reached, if one is.
    """

    position: Vector
    orientation: Quaternion
    arms: tuple[str, ...] = ()
    score: float = 1.0
    surface: str = ""
    grasps: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PutDown:
    """Something that an arm holds is to be put down.

    Attributes:
        position: xyz of the object, m.
        orientation: xyzw of the object; None for upright, turned as is natural.
        body: the object; None for whatever the arm holds.
    """

    position: Vector
    orientation: Quaternion | None = None
    body: Object | None = None


@dataclass(frozen=True, slots=True)
class Pull:
    """A drawer or door is to be opened or closed by its handle.

    Attributes:
        container: the furniture.
        joint: its joint.
        handle: the link of the handle.
        to: the joint's value then, rad or m.
    """

    container: Object
    joint: str
    handle: str
    to: float


#: An object that is to be taken; a position xyz that the tool is to get to; or one of the above.
Target: TypeAlias = Object | PutDown | Pull | Sequence[float]
