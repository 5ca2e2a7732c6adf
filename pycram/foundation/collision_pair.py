"""Collision pairs: which link meets which, as failures and records name it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

from recorder.records.text import pair_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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

    def __record__(self) -> Mapping[str, object]:
        """Return its fields, as records have it."""
        return asdict(self)

    def __str__(self) -> str:
        return pair_text(asdict(self))


def phrases(pairs: Sequence[CollisionPair]) -> str:
    """Return pairs in words, the first few."""
    listed = ", ".join(map(str, pairs[:_MAX_LISTED]))
    return f"{listed}, and {len(pairs) - _MAX_LISTED} more" if len(pairs) > _MAX_LISTED else listed
