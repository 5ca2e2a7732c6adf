"""Reasons for rejecting candidates. The record of a reason contains the name of the reason's type, and its fields."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Final

from pycram.foundation.failures import CollisionPair

_DIGITS: Final = 6  # number of decimals of recorded numbers; the numbers are only read by people
_MAX_PAIRS: Final = 3


@dataclass(frozen=True, slots=True)
class Rejection:
    """The reason for a rejection; its fields are facts. Plans may define subclasses."""

    _common: ClassVar[tuple[str, ...]] = ()  # names of the fields that all candidates of a group share

    def data(self) -> Mapping[str, object]:
        """Return the fields for a record."""
        return {each.name: short(getattr(self, each.name)) for each in fields(self)}

    def alike(self) -> Hashable:
        """Return the properties that all candidates of a group share, in addition to the type of their reason."""
        return tuple(getattr(self, name) for name in self._common)

    def group(self) -> Hashable:
        """Return the group of the reason; a record counts the reasons of a group together."""
        return type(self), self.alike()

    def miss(self) -> float:
        """Return how far the candidate is from acceptance; a record has the reason with the smallest value."""
        return 0.0


@dataclass(frozen=True, slots=True)
class Excluded(Rejection):
    """A fork forces another candidate."""


@dataclass(frozen=True, slots=True)
class OutOfReach(Rejection):
    """No posture reaches the target."""

    distance: float | None  # distance in m between the nearest posture and the target; None if unknown
    turn: float = 0.0  # angle in rad between the nearest posture and the target

    def miss(self) -> float:
        """Return the distance, plus the angle in rad as if the tool were 1 m long."""
        return math.inf if self.distance is None else self.distance + self.turn


@dataclass(frozen=True, slots=True)
class Touching(Rejection):
    """The robot would touch something."""

    pairs: Sequence[CollisionPair]  # the first pairs of links that would touch
    more: int = field(init=False)  # number of pairs that aren't in ``pairs``

    def __post_init__(self) -> None:
        object.__setattr__(self, "more", max(0, len(self.pairs) - _MAX_PAIRS))
        object.__setattr__(self, "pairs", tuple(self.pairs[:_MAX_PAIRS]))

    def alike(self) -> Hashable:
        """Return the touched links of objects."""
        return tuple((pair.body, pair.body_link) for pair in self.pairs)

    def miss(self) -> float:
        """Return the deepest overlap, m."""
        return max((pair.depth for pair in self.pairs), default=0.0)


@dataclass(frozen=True, slots=True)
class Misfit(Rejection):
    """The object doesn't fit between the fingers."""

    width: float | None  # width in m of the object between the fingers; None if there is nothing to grasp
    least: float  # width in m of the narrowest object that the fingers hold
    most: float  # width in m of the widest object that the fingers hold

    def miss(self) -> float:
        """Return how far the width is outside its limits, m."""
        return 0.0 if self.width is None else max(self.width - self.most, self.least - self.width)


@dataclass(frozen=True, slots=True)
class Uneven(Rejection):
    """The suction cup doesn't close on the object."""

    height: float | None  # unevenness in m of the surface below the cup; None without an object there

    def miss(self) -> float:
        """Return the height."""
        return self.height or 0.0


TAKEN: Final = "the place is taken, or leaves no room for a finger"
"""A reason of a :class:`NoRoom` that may disappear if objects are removed from the surface."""


@dataclass(frozen=True, slots=True)
class NoRoom(Rejection):
    """The place is taken, or has no support."""

    _common = ("reason",)
    reason: str  # the reason as text


@dataclass(frozen=True, slots=True)
class Slips(Rejection):
    """The closed fingers don't hold the object."""

    _common = ("sides",)
    sides: int  # number of sides of the object that the fingers would touch


@dataclass(frozen=True, slots=True)
class Contorted(Rejection):
    """The arm would have to change to another posture during the motion."""

    value: float  # position of the moving joint at which the posture would change, rad or m


@dataclass(frozen=True, slots=True)
class Unreached(Rejection):
    """The search for a path didn't reach the goal."""

    checks: int  # number of checked configurations
    distance: float  # distance between the goal and the nearest reached configuration: rad, or m for a base
    pairs: Sequence[CollisionPair] = ()  # links that were in the way most often

    def miss(self) -> float:
        """Return the distance."""
        return self.distance


@dataclass(frozen=True, slots=True)
class Unseen(Rejection):
    """The camera would see too little of the object."""

    share: float  # share of the object that is seen
    hidden_by: Sequence[str] = ()  # names of the objects that hide the candidate
    outside: float = 0.0  # share of the object outside of the picture
    #: For each hiding object with several links, the link that hides most.
    hiding_links: Mapping[str, str] = field(default_factory=dict, hash=False)

    def data(self) -> Mapping[str, object]:
        """Return the fields for a record, without empty optional fields."""
        optional = {"outside": self.outside, "hiding_links": self.hiding_links}
        return {"share": short(self.share), "hidden_by": short(self.hidden_by)} | {
            key: short(value) for key, value in optional.items() if value
        }

    def alike(self) -> Hashable:
        """Return the objects that hide the candidate."""
        return tuple(self.hidden_by)

    def miss(self) -> float:
        """Return the share of the object that the camera wouldn't see."""
        return 1.0 - self.share


@dataclass(frozen=True, slots=True)
class Inferior(Rejection):
    """Another candidate is better."""

    _common = ("by",)
    by: str  # name of the compared quantity
    value: float  # value of the compared quantity


@dataclass(frozen=True, slots=True)
class Untried(Rejection):
    """The candidate wasn't checked: another candidate is good, or all similar candidates fail."""


@dataclass(frozen=True, slots=True)
class Unfit(Rejection):
    """Any other reason for a rejection."""

    _common = ("reason",)
    reason: str  # the reason as text


def short(value: Any) -> object:
    """Return a value for a record, with rounded numbers and without empty fields."""
    if isinstance(value, float):
        return round(value, _DIGITS)
    if isinstance(value, CollisionPair):
        return {key: short(item) for key, item in value.__record__().items() if item != ""}
    return [short(item) for item in value] if isinstance(value, list | tuple) else value
