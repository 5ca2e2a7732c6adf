"""Hints for names that don't exist: "did you mean ...?"."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_MAX_SUGGESTED: Final = 3
_MAX_LISTED: Final = 10


def nearest(name: str, known: Iterable[str], similarity: float = 0.6) -> list[str]:
    """Return up to 3 known names that are at least that similar (0 to 1) to a name, the most similar first."""
    return difflib.get_close_matches(name, list(known), _MAX_SUGGESTED, similarity)


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the nearest known ones, else all if they are few, else their number."""
    names = sorted(set(known))
    near = nearest(name, names)
    if near:
        return f"did you mean {' or '.join(near)}?"
    if len(names) > _MAX_LISTED:
        return f"there are {len(names)} of them, such as {', '.join(names[:_MAX_SUGGESTED])}"
    return f"there are {', '.join(names) or 'none'}"
