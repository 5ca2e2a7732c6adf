"""Tables of a TOML file, checked: KeyError where an entry is missing, BadArgument where it is unknown or impossible."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Callable

    from recorder.geometry import Pose

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


def pose(parent: Table, key: str) -> Pose:
    """Return a pose, given as a table with xyz in m and roll, pitch, yaw in rad, both zero by default."""
    offset = table(parent, key) if key in parent else {}
    only(offset, "xyz", "rpy")
    origin, no_turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    position = checks.vector(f"{key}.xyz", offset.get("xyz", origin))
    return position, geometry.from_rpy(*checks.vector(f"{key}.rpy", offset.get("rpy", no_turn)))


_CHECKS: Final[dict[object, Callable[[str, object], object]]] = {
    "str": checks.text,
    "float": checks.number,
}


def record(kind: type[T], table: Table) -> T:
    """Return a dataclass with the entries of a table, one for each of its fields, which are str or float."""
    fields: dict[str, Any] = {field.name: field.type for field in dataclasses.fields(kind)}  # type: ignore[arg-type]  # of dataclasses
    only(table, *fields)
    return kind(**{name: _CHECKS[type_name](name, table[name]) for name, type_name in fields.items()})
