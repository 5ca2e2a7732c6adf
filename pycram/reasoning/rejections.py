"""Reasons for rejecting candidates, as types with fields. A record has the type's name and the fields."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import CollisionPair

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

_DIGITS: Final = 6  # decimals; these numbers are only read, not used in computations
_MAX_PAIRS: Final = 3


@dataclass(frozen=True, slots=True)
class Rejection:
    """The reason for a rejection. Subclasses, also in users' code, have the known facts as fields."""

    def data(self) -> Mapping[str, object]:
        """Return the fields for a record."""
        return {each.name: short(getattr(self, each.name)) for each in fields(self)}

    def alike(self) -> Hashable:
        """Return the property that candidates of one group share, besides the type of their reason."""
        return ()

    def group(self) -> Hashable:
        """Return the group of the reason: equal for reasons that are counted together."""
        return type(self), self.alike()

    def miss(self) -> float:
        """Return the size of the miss; a group's record has the reason with the smallest miss."""
        return 0.0


@dataclass(frozen=True, slots=True)
class Excluded(Rejection):
    """A fork forces another candidate."""


@dataclass(frozen=True, slots=True)
class OutOfReach(Rejection):
    """No posture reaches the target."""

    distance: float | None  # m between the nearest posture and the target; None if unknown
    turn: float = 0.0  # rad between the nearest posture and the target

    def miss(self) -> float:
        """Return the distance plus the angle, for a tool of 1 m."""
        return math.inf if self.distance is None else self.distance + self.turn


@dataclass(frozen=True, slots=True)
class Touching(Rejection):
    """A collision."""

    pairs: Sequence[CollisionPair]  # the first few pairs of links that would touch
    more: int = field(init=False)  # number of other pairs

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

    width: float | None  # width of the object between the fingers, m; None if there is nothing to grasp
    least: float  # width of the narrowest object that the fingers hold, m
    most: float  # width of the widest object that the fingers hold, m

    def miss(self) -> float:
        """Return the difference between the width and the limits, m."""
        return 0.0 if self.width is None else max(self.width - self.most, self.least - self.width)


@dataclass(frozen=True, slots=True)
class Uneven(Rejection):
    """The suction cup doesn't close on the object."""

    height: float | None  # m between the highest and the lowest point below the cup; None if there is nothing to grasp

    def miss(self) -> float:
        """Return the height."""
        return self.height or 0.0


TAKEN: Final = "the place is taken, or leaves no room for a finger"
"""Reason of a :class:`NoRoom` that disappears if objects are taken off the surface."""


@dataclass(frozen=True, slots=True)
class NoRoom(Rejection):
    """The place is taken, or has no support."""

    reason: str  # in words

    def alike(self) -> Hashable:
        """Return the reason."""
        return self.reason


@dataclass(frozen=True, slots=True)
class Slips(Rejection):
    """The closed fingers don't hold the object."""

    sides: int  # sides of the object that the fingers would touch

    def alike(self) -> Hashable:
        """Return the number of sides."""
        return self.sides


@dataclass(frozen=True, slots=True)
class Contorted(Rejection):
    """The arm would have to change its posture during the motion."""

    value: float  # value of the moving joint at which the posture would change, rad or m


@dataclass(frozen=True, slots=True)
class Unreached(Rejection):
    """The search for a path didn't reach the goal."""

    checks: int  # number of checked configurations
    distance: float  # between the goal and the nearest reached configuration: rad, or m for a base
    pairs: Sequence[CollisionPair] = ()  # links that would touch most often

    def miss(self) -> float:
        """Return the distance."""
        return self.distance


@dataclass(frozen=True, slots=True)
class Unseen(Rejection):
    """Too little of the object is seen."""

    share: float  # share of the object that is seen
    hidden_by: Sequence[str] = ()  # names of the objects before it
    outside: float = 0.0  # share of the object outside of the picture
    hiding_links: Mapping[str, str] = field(
        default_factory=dict, hash=False
    )  # the link of an object before it that hides most

    def data(self) -> Mapping[str, object]:
        """Return the fields for a record, without those that add nothing."""
        optional = {"outside": self.outside, "hiding_links": self.hiding_links}
        return {"share": short(self.share), "hidden_by": short(self.hidden_by)} | {
            key: short(value) for key, value in optional.items() if value
        }

    def alike(self) -> Hashable:
        """Return the objects before it."""
        return tuple(self.hidden_by)

    def miss(self) -> float:
        """Return the share that isn't seen."""
        return 1.0 - self.share


@dataclass(frozen=True, slots=True)
class Inferior(Rejection):
    """The candidate is good, but another one is better."""

    by: str  # name of the quantity
    value: float  # value of the quantity

    def alike(self) -> Hashable:
        """Return the name of the quantity."""
        return self.by


@dataclass(frozen=True, slots=True)
class Untried(Rejection):
    """The candidate wasn't checked: another one is good, or all similar ones fail."""


@dataclass(frozen=True, slots=True)
class Unfit(Rejection):
    """Any other reason."""

    reason: str  # in words

    def alike(self) -> Hashable:
        """Return the reason."""
        return self.reason


def short(value: Any) -> object:
    """Return a value for a record with rounded numbers, and without empty fields."""
    if isinstance(value, float):
        return round(value, _DIGITS)
    if isinstance(value, CollisionPair):
        return {key: short(item) for key, item in value.__record__().items() if item != ""}
    if isinstance(value, list | tuple):
        return [short(item) for item in value]
    return value
