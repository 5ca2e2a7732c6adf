"""Where bodies are nearest, and where they touched in the last step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from recorder.geometry import Vector

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
