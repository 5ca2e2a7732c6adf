"""Why a candidate is rejected: typed, with what is known of it; records have the type's name and the fields."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.failures import CollisionPair

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

_DIGITS: Final = 6  # decimals: these numbers explain, nothing is computed from them
_MAX_PAIRS: Final = 3


@dataclass(frozen=True, slots=True)
class Rejection:
    """Why something won't do. Subclasses, also users', have what is known as fields."""

    def data(self) -> Mapping[str, object]:
        """Return its fields as records carry them."""
        return {each.name: short(getattr(self, each.name)) for each in fields(self)}

    def alike(self) -> Hashable:
        """Return what candidates that are recorded together have in common, beside the type."""
        return ()

    def miss(self) -> float:
        """Return how much is missing: of those alike, the one that misses least is recorded."""
        return 0.0


@dataclass(frozen=True, slots=True)
class OutOfReach(Rejection):
    """No posture gets there."""

    distance: float | None  # m that the nearest stays away; None if that isn't known
    turn: float = 0.0  # rad by which it is turned from there

    def miss(self) -> float:
        """Return the distance, and the angle as if the tool were a metre long."""
        return math.inf if self.distance is None else self.distance + self.turn


@dataclass(frozen=True, slots=True)
class Touching(Rejection):
    """Something would be touched."""

    pairs: Sequence[CollisionPair]  # the links that would meet, the first few
    more: int = field(init=False)  # how many other pairs there are

    def __post_init__(self) -> None:
        object.__setattr__(self, "more", max(0, len(self.pairs) - _MAX_PAIRS))
        object.__setattr__(self, "pairs", tuple(self.pairs[:_MAX_PAIRS]))

    def alike(self) -> Hashable:
        """Return which links of which objects."""
        return tuple((pair.body, pair.body_link) for pair in self.pairs)

    def miss(self) -> float:
        """Return the deepest overlap, m."""
        return max((pair.depth for pair in self.pairs), default=0.0)


@dataclass(frozen=True, slots=True)
class Misfit(Rejection):
    """It doesn't fit between the fingers."""

    width: float | None  # m between its sides there; None if there is nothing to take
    least: float  # m of the narrowest that the fingers hold
    most: float  # m of the widest

    def miss(self) -> float:
        """Return by how much, m."""
        return 0.0 if self.width is None else max(self.width - self.most, self.least - self.width)


@dataclass(frozen=True, slots=True)
class Uneven(Rejection):
    """A suction cup doesn't close on it."""

    height: float | None  # m between the highest and the lowest point below the cup; None if there is nothing to take

    def miss(self) -> float:
        """Return the height."""
        return self.height or 0.0


@dataclass(frozen=True, slots=True)
class NoRoom(Rejection):
    """It can't stand there: something is there already, or nothing is below."""

    reason: str  # which of them, in words

    def alike(self) -> Hashable:
        """Return the reason."""
        return self.reason


@dataclass(frozen=True, slots=True)
class Slips(Rejection):
    """The closed fingers don't hold it."""

    sides: int  # on how many sides they would touch it

    def alike(self) -> Hashable:
        """Return the sides."""
        return self.sides


@dataclass(frozen=True, slots=True)
class Contorted(Rejection):
    """The arm would have to change its posture on the way."""

    value: float  # of the joint that is moved, rad or m, from which on


@dataclass(frozen=True, slots=True)
class Unreached(Rejection):
    """A search for a path didn't get there."""

    checks: int  # configurations that were checked
    distance: float  # from the goal to the nearest configuration that was reached: rad, or m of a base
    pairs: Sequence[CollisionPair] = ()  # the links that were in the way most often

    def miss(self) -> float:
        """Return the distance."""
        return self.distance


@dataclass(frozen=True, slots=True)
class Unseen(Rejection):
    """Too little of it is seen."""

    share: float  # of it that is seen
    hidden_by: Sequence[str] = ()  # names of what is before it

    def alike(self) -> Hashable:
        """Return what hides it."""
        return tuple(self.hidden_by)

    def miss(self) -> float:
        """Return the share that isn't seen."""
        return 1.0 - self.share


@dataclass(frozen=True, slots=True)
class Inferior(Rejection):
    """It would do, but another one is better."""

    by: str  # in which quantity
    value: float  # of it

    def alike(self) -> Hashable:
        """Return the quantity."""
        return self.by


@dataclass(frozen=True, slots=True)
class Untried(Rejection):
    """It was not looked at: another one does, or nothing else would."""


@dataclass(frozen=True, slots=True)
class Unfit(Rejection):
    """Any other reason."""

    reason: str  # in words

    def alike(self) -> Hashable:
        """Return the reason."""
        return self.reason


def short(value: Any) -> object:
    """Return a value for a record with numbers that are no longer than needed, and nothing that is empty."""
    if isinstance(value, float):
        return round(value, _DIGITS)
    if isinstance(value, CollisionPair):
        return {key: short(item) for key, item in value.__record__().items() if item != ""}
    if isinstance(value, list | tuple):
        return [short(item) for item in value]
    return value
