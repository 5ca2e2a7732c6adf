"""Hints for names that don't exist: "did you mean ...?"."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_MAX_SUGGESTED: Final = 3
_MAX_LISTED: Final = 25  # the joints of a kitchen


def nearest(name: object, known: Iterable[str]) -> list[str]:
    """Return up to 3 known names that are similar to a given one, the most similar first; else such that contain it."""
    names, given = list(known), str(name)
    close = difflib.get_close_matches(given, names, _MAX_SUGGESTED)
    return close or [each for each in names if given and given.casefold() in each.casefold()][:_MAX_SUGGESTED]


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of a message that suggests the nearest known names: "; did you mean ...?"; "" without any."""
    near = nearest(name, known)
    return f"; did you mean {' or '.join(near)}?" if near else ""


def suggestion(name: object, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the nearest known ones, else all if they are few, else their number."""
    names = sorted(set(known))
    if near := did_you_mean(name, names):
        return near.removeprefix("; ")
    if len(names) > _MAX_LISTED:
        return f"there are {len(names)} of them, such as {', '.join(names[:_MAX_SUGGESTED])}"
    return f"there are {', '.join(names) or 'none'}"
