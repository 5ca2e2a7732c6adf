"""The most frequent reason against the places of a search, and a remedy. A remedy is suggested only if it can help."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.reasoning.rejections import TAKEN, NoRoom, OutOfReach, Touching, Unseen
from recorder.records.text import rejection_text

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Sequence

    from pycram.reasoning.rejections import Rejection
    from pycram.world.object import Object

#: Reasons and remedies, by the constraint that excludes a whole surface.
_SURFACE: Final = {
    "clearance": "the object is higher than the free height above the surface; name another surface",
    "edge": "the surface is too small for the object; name a larger surface",
    "room": "the surface is full; take objects off it, or name another surface",
}


class Reasons:
    """The reasons against the places of a search, by constraint."""

    def __init__(self) -> None:
        self._found: dict[str, dict[Hashable, tuple[int, Rejection]]] = {}
        self._maps = ""  # why the maps left no place, with the remedy

    def add(self, constraint: str, reason: Rejection) -> None:
        """Count a reason; of similar reasons, the one with the smallest miss is kept."""
        group = self._found.setdefault(constraint, {})
        count, nearest = group.get(reason.group(), (0, reason))
        group[reason.group()] = count + 1, min(nearest, reason, key=lambda each: each.miss())

    def excluded_by_maps(self, constraint: str, *, alone: bool) -> None:
        """Store the constraint that excluded all places of the maps; ``alone``: other constraints left places."""
        self._maps = _SURFACE.get(constraint, "")
        if not self._maps and alone and constraint.startswith(("near", "away-from", "side")):
            self._maps = f"there are places without {constraint}: change it or leave it out"

    def text(self, constraint: str, objects: Sequence[Object], *, drives: bool) -> str:
        """Return the most frequent reason of a constraint and a remedy; "" if neither is known.

        Args:
            constraint: The constraint that excluded the last places.
            objects: The objects of the world.
            drives: Whether the robot can drive; if not, the target must move.
        """
        group = self._found.get(constraint)
        if group is None:
            return self._maps
        _, reason = max(group.values(), key=lambda each: each[0])
        words = _words(reason)
        others = [each for each in objects if constraint != f"reach {each.name}"]
        remedy = _remedy(reason, others, drives=drives)
        return f"most often: {words}{remedy and '; ' + remedy}" if words else ""


def _words(reason: Rejection) -> str:
    if isinstance(reason, OutOfReach):
        return (
            "the target is out of reach"
            if reason.distance is None
            else f"the target is out of reach by {_centimetres(reason)} cm or more"
        )
    return rejection_text(type(reason).__name__, reason.data())


def _remedy(reason: Rejection, objects: Sequence[Object], *, drives: bool) -> str:
    if isinstance(reason, Touching):
        return aside((pair.body for pair in reason.pairs if pair.body != pair.mover), objects)
    if isinstance(reason, Unseen):
        return aside(reason.hidden_by, objects)
    if isinstance(reason, OutOfReach) and reason.distance and not drives:
        return f"the base is fixed: bring the target at least {_centimetres(reason)} cm closer"
    if isinstance(reason, NoRoom) and reason.reason == TAKEN:
        return "take objects off the surface, or name another surface"
    return ""


def aside(names: Iterable[str], objects: Iterable[Object]) -> str:
    """Return the advice to move objects aside; "" without objects, or if an object can't be moved."""
    wanted = list(dict.fromkeys(names))
    movable = {each.name for each in objects if not each.fixed and not each.is_robot}
    return f"move {' and '.join(wanted)} aside" if wanted and movable.issuperset(wanted) else ""


def _centimetres(reason: OutOfReach) -> int:
    return math.ceil((reason.distance or 0.0) * 100)
