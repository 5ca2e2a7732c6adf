"""Why a candidate is rejected: typed, with what is known of it; records have the type's name and the fields."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.collision_pair import CollisionPair

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
    """No posture gets there.

    Attributes:
        distance: m that the nearest stays away; None if that isn't known.
        turn: rad by which it is turned from there.
    """

    distance: float | None
    turn: float = 0.0

    def miss(self) -> float:
        """Return the distance, and the angle as if the tool were a metre long."""
        return math.inf if self.distance is None else self.distance + self.turn


@dataclass(frozen=True, slots=True)
class Touching(Rejection):
    """Something would be touched.

    Attributes:
        pairs: the links that would meet, the first few.
        more: how many other pairs there are.
    """

    pairs: Sequence[CollisionPair]
    more: int = field(init=False)

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
    """It doesn't fit between the fingers.

    Attributes:
        width: m between its sides there; None if there is nothing to take.
        least: m of the narrowest that the fingers hold.
        most: m of the widest.
    """

    width: float | None
    least: float
    most: float

    def miss(self) -> float:
        """Return by how much, m."""
        return 0.0 if self.width is None else max(self.width - self.most, self.least - self.width)


@dataclass(frozen=True, slots=True)
class Uneven(Rejection):
    """A suction cup doesn't close on it.

    Attributes:
        height: m between the highest and the lowest point below the cup; None if there is nothing to take.
    """

    height: float | None

    def miss(self) -> float:
        """Return the height."""
        return self.height or 0.0


@dataclass(frozen=True, slots=True)
class NoRoom(Rejection):
    """It can't stand there: something is there already, or nothing is below.

    Attributes:
        reason: which of them, in words.
    """

    reason: str

    def alike(self) -> Hashable:
        """Return the reason."""
        return self.reason


@dataclass(frozen=True, slots=True)
class Slips(Rejection):
    """The closed fingers don't hold it.

    Attributes:
        sides: on how many sides they would touch it.
    """

    sides: int

    def alike(self) -> Hashable:
        """Return the sides."""
        return self.sides


@dataclass(frozen=True, slots=True)
class Contorted(Rejection):
    """The arm would have to change its posture on the way.

    Attributes:
        value: of the joint that is moved, rad or m, from which on.
    """

    value: float


@dataclass(frozen=True, slots=True)
class Unreached(Rejection):
    """A search for a path didn't get there.

    Attributes:
        checks: configurations that were checked.
        distance: from the goal to the nearest configuration that was reached: rad, or m of a base.
        pairs: the links that were in the way most often.
    """

    checks: int
    distance: float
    pairs: Sequence[CollisionPair] = ()

    def miss(self) -> float:
        """Return the distance."""
        return self.distance


@dataclass(frozen=True, slots=True)
class Unseen(Rejection):
    """Too little of it is seen.

    Attributes:
        share: of it that is seen.
        hidden_by: names of what is before it.
    """

    share: float
    hidden_by: Sequence[str] = ()

    def alike(self) -> Hashable:
        """Return what hides it."""
        return tuple(self.hidden_by)

    def miss(self) -> float:
        """Return the share that isn't seen."""
        return 1.0 - self.share


@dataclass(frozen=True, slots=True)
class Inferior(Rejection):
    """It would do, but another one is better.

    Attributes:
        by: in which quantity.
        value: of it.
    """

    by: str
    value: float

    def alike(self) -> Hashable:
        """Return the quantity."""
        return self.by


@dataclass(frozen=True, slots=True)
class Untried(Rejection):
    """It was not looked at: another one does, or nothing else would."""


@dataclass(frozen=True, slots=True)
class Unfit(Rejection):
    """Any other reason.

    Attributes:
        reason: in words.
    """

    reason: str

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
