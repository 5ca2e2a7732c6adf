"""Collision pairs: which link meets which, as failures and records name it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

_MAX_LISTED: Final = 3  # pairs that fit into a message


@dataclass(frozen=True, slots=True)
class CollisionPair:
    """A link of a robot, or of what it holds, and the link that it meets.

    Attributes:
        mover: name of the object that moves: the robot, or what it holds.
        link: the mover's link; "" if it has only one.
        body: name of the object that it meets; the robot itself, if it meets a link of its own.
        body_link: that object's link; "" if it has only one.
        depth: of the overlap, m.
        gripper: name of the arm whose gripper holds the mover; "" for the robot's own links.
    """

    mover: str
    link: str
    body: str
    body_link: str
    depth: float = 0.0
    gripper: str = ""

    def __record__(self) -> object:
        """Return its fields, as records have it."""
        return asdict(self)

    def phrase(self, verb: str = "would touch") -> str:
        """Return it in words: "milk in the left gripper would touch sink_area_surface of kitchen"."""
        mover = f"{self.mover} in the {self.gripper} gripper" if self.gripper else self.link or self.mover
        if self.body == self.mover:
            return f"its own {mover} {verb} {self.body_link}"
        met = f"{self.body_link} of {self.body}" if self.body_link else self.body
        return f"{mover} {verb} {met}"


def phrases(pairs: Sequence[CollisionPair], verb: str = "would touch") -> str:
    """Return pairs in words, the first few."""
    listed = ", ".join(pair.phrase(verb) for pair in pairs[:_MAX_LISTED])
    return f"{listed}, and {len(pairs) - _MAX_LISTED} more" if len(pairs) > _MAX_LISTED else listed
