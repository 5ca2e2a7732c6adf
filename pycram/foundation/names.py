"""Names of functions in records, and of exported classes in tracebacks."""

from __future__ import annotations

from functools import partial

from recorder.records import escaped


def qualified_name(function: object) -> str:
    """Return module and qualified name of a callable; for a partial, those of the wrapped function."""
    while isinstance(function, partial):
        function = function.func
    named = function if hasattr(function, "__qualname__") else type(function)
    return escaped(f"{getattr(named, '__module__', '')}.{getattr(named, '__qualname__', '')}")


def export(module: str, *classes: type) -> None:
    """Set the module from which users import classes, for tracebacks and pickles."""
    for exported in classes:
        exported.__module__ = module
