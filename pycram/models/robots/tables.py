"""Entries of TOML tables, checked: KeyError where one is missing, BadArgument where it isn't of its kind."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias, TypeVar

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")
Table: TypeAlias = dict[str, object]


def only(table: Table, *keys: str) -> None:
    """Refuse entries other than these."""
    for key in table:
        if key not in keys:
            raise BadArgument(key, table[key], f"only {', '.join(keys)} here")


def table(parent: Table, key: str) -> Table:
    """Return a table within a table."""
    value = parent[key]
    if not isinstance(value, dict):
        raise BadArgument(key, value, "a table")
    return value


def optional(parent: Table, key: str, read: Callable[[Table], T]) -> T | None:
    """Return what a function reads from a table within a table; None without one."""
    return read(table(parent, key)) if key in parent else None


def text(table: Table, key: str) -> str:
    """Return a string that isn't empty."""
    return checks.text(key, table[key])


def texts(table: Table, key: str) -> tuple[str, ...]:
    """Return a list of names."""
    value = table[key]
    if not isinstance(value, list):
        raise BadArgument(key, value, "a list of names")
    return tuple(checks.text(key, item) for item in value)


def number(table: Table, key: str) -> float:
    """Return a finite number."""
    return checks.number(key, table[key])


def between(table: Table, key: str, low: float, high: float) -> float:
    """Return a number from low to high."""
    return checks.in_range(key, table[key], low, high)
