"""What became of the places that a query considered, in words: of a robot, or of an object that is put down."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from recorder.records.values import argument_values

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records.log_pb2 import Candidate, Query

TAKEN: Final = "taken"
NOT_TRIED: Final = "not tried"
_OUT_OF_REACH: Final = "is out of reach|are out of reach"
_NO_GRASP: Final = "offers no grasp|offer no grasp"
_FATES: Final = {
    "": NOT_TRIED,
    "Untried": NOT_TRIED,
    "OutOfReach": _OUT_OF_REACH,
    "Unreached": _OUT_OF_REACH,
    "Contorted": _OUT_OF_REACH,
    "Unseen": "doesn't see it|don't see it",
    "Inferior": "is worse|are worse",
    "Slips": _NO_GRASP,
    "Misfit": _NO_GRASP,
    "Uneven": _NO_GRASP,
}
"""What becomes of a place for a reason, by its type; of one place, and of several."""
_MAX_LETTERS: Final = 80
_MAX_FATES: Final = 4  # in a line


def fates(query: Query) -> Iterator[str]:
    """Yield what became of each place that a query considered, in their order: in a word or two."""
    names = [_fate(candidate) for candidate in query.candidates]
    if query.HasField("chosen") and 0 <= query.chosen < len(names):
        names[query.chosen] = TAKEN
    for spot in query.grid.spots:
        yield names[spot.candidate] if 0 <= spot.candidate < len(names) else NOT_TRIED


def fates_text(query: Query) -> str:
    """Return what became of the places, those alike as one; empty for a query that considered none.

    As in "of 60 places 41 collide with the kitchen, 17 are out of reach, 1 was taken".
    """
    counts = Counter(fates(query))
    if not counts:
        return ""
    taken, untried = counts.pop(TAKEN, 0), counts.pop(NOT_TRIED, 0)
    parts = [_counted(count, fate) for fate, count in counts.most_common(_MAX_FATES)]
    rest = counts.total() - sum(count for _, count in counts.most_common(_MAX_FATES))
    parts += [f"{rest} won't do for other reasons"] if rest else []
    parts += [f"{taken} {'was' if taken == 1 else 'were'} taken"] if taken else ["none was taken"]
    parts += [f"{untried} {'was' if untried == 1 else 'were'} not tried"] if untried else []
    total = len(query.grid.spots)
    return f"of {total} {'place' if total == 1 else 'places'} {', '.join(parts)}"


def _counted(count: int, fate: str) -> str:
    one, _, other = fate.partition("|")
    return f"{count} {one if count == 1 or not other else other}"


def _fate(candidate: Candidate) -> str:
    """Return why a place won't do; of one place, and of several, where the words differ."""
    data, reason = argument_values(candidate.data), candidate.reason
    if reason == "Touching":
        return "collides with {0}|collide with {0}".replace("{0}", _touched(data))
    text = data.get("reason")
    why = f": {text}" if isinstance(text, str) and len(text) <= _MAX_LETTERS else ""
    if reason == "NoRoom":
        return f"has no room{why}|have no room{why}"
    return _FATES.get(reason, "won't do" + (why or f": {reason}"))


def _touched(data: dict[str, Any]) -> str:
    """Return what would be touched: of several things the first, which is the deepest."""
    pairs = data.get("pairs")
    first = pairs[0] if isinstance(pairs, list) and pairs and isinstance(pairs[0], dict) else {}
    return str(first.get("body") or "something")
