"""Bodies in the engine, with their states and contacts; they map names of the URDF to PyBullet's ids and indices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from recorder.geometry import Pose, Vector

_SUPPORT_SLOPE: Final = 0.5  # minimum z of a contact's unit normal; a surface steeper than 60 degrees supports nothing


@dataclass(frozen=True, slots=True)
class MovableJoint:
    """A movable joint of a body."""

    name: str
    index: int  # PyBullet's index
    kind: str  # "revolute" (also continuous) or "prismatic"
    lower: float  # limit in rad or m, -inf if continuous
    upper: float  # limit in rad or m, inf if continuous
    link: str  # the child link


@dataclass(frozen=True, slots=True, eq=False)
class LoadedBody:
    """A body in the engine."""

    id: int  # PyBullet's id, which may be reused after the body's removal
    links: Mapping[str, int]  # indices of links by name; the base link has -1
    joints: Mapping[str, MovableJoint]  # movable joints by name
    offset: Pose | None  # pose of the base's centre of mass in the base link's frame; None if both are equal
    indices: tuple[int, ...]  # indices of the movable joints, in order
    gain: float  # share of the error of a joint's position that its motor corrects in a simulated step
    forces: Mapping[str, float]  # largest forces of the motors by joint, N m or N
    targets: dict[str, float] = field(default_factory=dict)  # positions that the motors hold, by joint


class Snapshot(NamedTuple):
    """The state of a body at one moment."""

    pose: Pose  # pose of the base link in the world: position in m, orientation xyzw
    velocity: tuple[float, ...]  # linear (m/s) and angular (rad/s) velocity of the base's centre of mass, 6 values
    positions: tuple[float, ...]  # positions of the movable joints in order, rad or m
    velocities: tuple[float, ...]  # velocities of the movable joints in order, rad/s or m/s


class ClosestPoint(NamedTuple):
    """The point at which two links are nearest to each other."""

    link_a: str  # link of the first body
    link_b: str  # link of the second body
    position: Vector  # point on the second body, world frame, m
    normal: Vector  # unit vector from the second body to the first body
    distance: float  # distance in m; negative if the links overlap
    force: float  # force in N along the normal in the last step; 0 without a step

    @property
    def carries(self) -> bool:
        """Whether the second body rests on the first body at this point."""
        return self.normal[2] < -_SUPPORT_SLOPE


class Contact(NamedTuple):
    """A point where a body touched another body in the last step."""

    link: int  # index of the body's link
    other: int  # id of the other body
    other_link: int  # index of the other body's link
    position: Vector  # point on the other body, world frame, m
    normal: Vector  # unit vector from the other body to this body
    force: float  # force along the normal, N
