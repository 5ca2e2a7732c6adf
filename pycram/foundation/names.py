"""Names: of functions in records, and of exported classes in tracebacks."""

from __future__ import annotations

from functools import partial

from recorder.records import escaped


def qualified_name(function: object) -> str:
    """Return module and qualified name of a callable, of the wrapped function if it is a partial."""
    while isinstance(function, partial):
        function = function.func
    named = function if hasattr(function, "__qualname__") else type(function)
    return escaped(f"{getattr(named, '__module__', '')}.{getattr(named, '__qualname__', '')}")


def export(module: str, *classes: type) -> None:
    """Make classes print the module from which users import them, in tracebacks and in pickles."""
    for exported in classes:
        exported.__module__ = module
