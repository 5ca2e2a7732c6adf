"""Names of surfaces and containers: those of links, made readable."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_EMPTY: Final = frozenset({"link", "main", "surface", "area", "frame", "body", "base", "part"})  # that say nothing


def readable(link: str, model: str, dropped: Iterable[str] = ()) -> str:
    """Return the words of a link's name without such as say nothing, and without the name of the model.

    Args:
        link: the link's name.
        model: the name of the model.
        dropped: further words that say nothing.
    """
    every = [word.casefold() for word in _WORDS.findall(link)]
    own = [word.casefold() for word in _WORDS.findall(model)]
    if every[: len(own)] == own:
        every = every[len(own) :]
    empty = _EMPTY | set(dropped)
    said = [
        word
        for number, word in enumerate(every)
        if word not in empty and (word.isdecimal() or word not in every[:number])
    ]
    return " ".join(said) or " ".join(word for word in every if word not in dropped) or link


def distinct(names: Iterable[str]) -> list[str]:
    """Return names of which the first of equal ones stays, and others have a number, from 2 on."""
    taken: dict[str, int] = {}
    given = []
    for name in names:
        taken[name] = taken.get(name, 0) + 1
        given.append(name if taken[name] == 1 else f"{name} {taken[name]}")
    return given
