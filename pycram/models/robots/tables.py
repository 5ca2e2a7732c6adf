"""Tables of a TOML file, checked: KeyError where an entry is missing, BadArgument where it is unknown or impossible."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

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


def texts(key: str, value: object) -> tuple[str, ...]:
    """Return a list of names."""
    if not isinstance(value, list):
        raise BadArgument(key, value, "a list of names")
    return tuple(checks.text(key, item) for item in value)


_CHECKS: Final[dict[object, Callable[[str, object], object]]] = {
    "str": checks.text,
    "float": checks.number,
    "tuple[str, ...]": texts,
}


def record(kind: type[T], table: Table, **ranges: tuple[float, float]) -> T:
    """Return a dataclass with the entries of a table.

    Args:
        kind: The dataclass; its fields are of the types str, float and tuple[str, ...], or have a range.
        table: The table; it has an entry for each field and no others.
        ranges: Lowest and highest value of numeric fields.
    """
    fields: dict[str, Any] = {field.name: field.type for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    only(table, *fields)
    values: dict[str, Any] = {}
    for name, type_name in fields.items():
        if name in ranges:
            number = checks.in_range(name, table[name], *ranges[name])
            values[name] = int(number) if type_name == "int" else number
        else:
            values[name] = _CHECKS[type_name](name, table[name])
    return kind(**values)
