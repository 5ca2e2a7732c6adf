"""Bodies in the engine: PyBullet's ids and indices by the names of their URDF."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import Pose, Vector


@dataclass(frozen=True, slots=True)
class Joint:
    """A movable joint.

    Attributes:
        name: its name.
        index: PyBullet's.
        kind: "revolute" (also continuous) or "prismatic".
        lower: lower limit in rad or m, -inf if continuous.
        upper: upper limit in rad or m, inf if continuous.
        link: the link that it moves.
    """

    name: str
    index: int
    kind: str
    lower: float
    upper: float
    link: str


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A loaded body.

    Attributes:
        id: PyBullet's; reused after removal.
        links: link index by name, the base is -1.
        joints: movable joints by name.
        offset: pose of the base's centre of mass in the base link's frame; None if they coincide.
        indices: indices of the movable joints, in order.
        gain: share of a joint's error that its motor corrects in a step.
        forces: N m or N with which motors hold joints at most, by name.
        targets: positions that the motors of its joints keep, by name.
    """

    id: int
    links: Mapping[str, int]
    joints: Mapping[str, Joint]
    offset: Pose | None
    indices: tuple[int, ...]
    gain: float
    forces: Mapping[str, float]
    targets: dict[str, float] = field(default_factory=dict)


class Snapshot(NamedTuple):
    """State of a body at one moment.

    Attributes:
        pose: Of the base link in the world: position in m, orientation xyzw.
        velocity: Linear (m/s) and angular (rad/s) velocity of the base's centre of mass: 6 numbers.
        positions: Of the movable joints in order, rad or m.
        velocities: Of the movable joints in order, rad/s or m/s.
    """

    pose: Pose
    velocity: tuple[float, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]


_SUPPORT_SLOPE: Final = 0.5  # of a unit normal that points up: steeper than 60 degrees supports nothing to speak of


class ClosestPoint(NamedTuple):
    """Where two links are nearest.

    Attributes:
        link_a: Link of the first body.
        link_b: Link of the second.
        position: On the second, world frame, m.
        normal: Unit vector from b to a.
        distance: In m, negative inside.
        force: In N along the normal, of the last step; 0 where nothing was stepped.
    """

    link_a: str
    link_b: str
    position: Vector
    normal: Vector
    distance: float
    force: float

    @property
    def carries(self) -> bool:
        """Whether the second body rests on the first there."""
        return self.normal[2] < -_SUPPORT_SLOPE


class Contact(NamedTuple):
    """Where a body touched another in the last step.

    Attributes:
        link: Index of its link.
        other: Id of the other body.
        other_link: Index of the other's link.
        position: On the other, world frame, m.
        normal: Unit vector from the other to it.
        force: In N along the normal.
    """

    link: int
    other: int
    other_link: int
    position: Vector
    normal: Vector
    force: float
