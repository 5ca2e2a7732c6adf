"""Hints for names that don't exist: "did you mean ...?"."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_MAX_SUGGESTED: Final = 3
_MAX_LISTED: Final = 10


def nearest(name: str, known: Iterable[str]) -> list[str]:
    """Return the known names that are spelt most like a name, the nearest first; none if no one is like it."""
    return difflib.get_close_matches(name, list(known), _MAX_SUGGESTED)


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the nearest known ones, else all if they are few, else their number."""
    names = sorted(set(known))
    near = nearest(name, names)
    if near:
        return f"did you mean {' or '.join(near)}?"
    if len(names) > _MAX_LISTED:
        return f"there are {len(names)} of them, such as {', '.join(names[:_MAX_SUGGESTED])}"
    return f"there are {', '.join(names) or 'none'}"
