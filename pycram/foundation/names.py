"""Names: of functions in records, of exported classes in tracebacks, and of what a misspelt name may have meant."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from recorder.suggestions import nearest

if TYPE_CHECKING:
    from collections.abc import Iterable


def qualified_name(function: object) -> str:
    """Return module and qualified name of a callable, of the wrapped function if it is a partial."""
    while isinstance(function, partial):
        function = function.func
    named = function if hasattr(function, "__qualname__") else type(function)
    return f"{getattr(named, '__module__', '')}.{getattr(named, '__qualname__', '')}"


def nearest_names(name: object, known: Iterable[str]) -> list[str]:
    """Return up to 3 known names that are similar to a given one, the most similar first."""
    return nearest(str(name), known, 0.4)


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of an error message that suggests similar names: "; did you mean ...?", "" without any."""
    names = ", ".join(nearest_names(name, known))
    return f"; did you mean {names}?" if names else ""


def export(module: str, *classes: type) -> None:
    """Make classes print the module from which users import them, in tracebacks and in pickles."""
    for exported in classes:
        exported.__module__ = module
