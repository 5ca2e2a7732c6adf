"""Checks of arguments before anything changes: numbers, positions, orientations, colours, names.

Each function gets the name of a parameter and the parameter's value. The functions return plain Python values that
don't share memory with the caller's arrays, and raise BadArgument for an impossible value.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Set as AbstractSet
from typing import SupportsFloat, TypeAlias, cast

import numpy as np

from pycram.foundation.failures import BadArgument
from recorder import geometry
from recorder.geometry import Pose, Quaternion, Vector

Table: TypeAlias = dict[str, object]

_MAX_COUNT = 2**53  # JSON has no larger exact whole numbers
_MAX_COORDINATE = 1e6  # largest coordinate in m; at larger coordinates the engine can't resolve millimetres
_UNIT_TOLERANCE = 1e-9  # a quaternion is normalised if its length differs from 1 by more than this


def number(argument: str, value: object) -> float:
    """Return a finite number."""
    if isinstance(value, bool | str | bytes):
        raise BadArgument(argument, value, "a number")
    try:
        result = float(cast("SupportsFloat", value))
    except (TypeError, ValueError, OverflowError) as error:
        raise BadArgument(argument, value, "a number") from error
    if not math.isfinite(result):
        raise BadArgument(argument, value, "a finite number")
    return result


def in_range(argument: str, value: object, low: float, high: float = math.inf) -> float:
    """Return a finite number from ``low`` to ``high``, both included."""
    result = number(argument, value)
    if not low <= result <= high:
        raise BadArgument(argument, value, f"a number from {low:g} {'up' if high == math.inf else f'to {high:g}'}")
    return result


def count(argument: str, value: object, least: int = 0) -> int:
    """Return a whole number from ``least`` to 2**53 - 1, the largest number that JSON holds exactly."""
    result = number(argument, value)
    if result != int(result) or not least <= result < _MAX_COUNT:
        raise BadArgument(argument, value, f"a whole number from {least} up")
    return int(result)


def switch(argument: str, value: object) -> bool:
    """Return True or False; the numbers 1 and 0 are also accepted."""
    if isinstance(value, bool | int | np.bool_ | np.integer) and value in (0, 1):
        return bool(value)
    raise BadArgument(argument, value, "True or False")


def vector(argument: str, value: object) -> Vector:
    """Return three finite coordinates."""
    x, y, z = _numbers(argument, value, 3, "3 finite numbers x, y, z")
    if max(abs(x), abs(y), abs(z)) > _MAX_COORDINATE:
        raise BadArgument(argument, value, f"coordinates within {_MAX_COORDINATE:g}")
    return x, y, z


def quaternion(argument: str, value: object) -> Quaternion:
    """Return 4 numbers x, y, z, w as a unit quaternion; numbers with a length of 1 aren't changed."""
    expected = "4 finite numbers x, y, z, w that aren't all zero"
    x, y, z, w = _numbers(argument, value, 4, expected)
    length = math.hypot(x, y, z, w)
    if not math.isfinite(length) or length < _UNIT_TOLERANCE:
        raise BadArgument(argument, value, expected)
    if abs(length - 1) > _UNIT_TOLERANCE:
        x, y, z, w = x / length, y / length, z / length, w / length
    return x, y, z, w


def color(argument: str, value: object) -> tuple[float, float, float, float]:
    """Return an RGBA colour with components from 0 to 1."""
    expected = "4 numbers r, g, b, a from 0 to 1"
    r, g, b, a = _numbers(argument, value, 4, expected)
    if min(r, g, b, a) < 0 or max(r, g, b, a) > 1:
        raise BadArgument(argument, value, expected)
    return r, g, b, a


def text(argument: str, value: object) -> str:
    """Return a non-empty string without lone surrogates, which files can't hold."""
    if not isinstance(value, str) or not value.strip() or any("\ud800" <= letter <= "\udfff" for letter in value):
        raise BadArgument(argument, value, "a string that isn't empty")
    return value


def one_of(argument: str, value: object, options: Collection[str]) -> str:
    """Return a text if it is one of the options."""
    for option in options:
        if option == value:
            return option
    raise BadArgument(argument, value, f"one of {', '.join(options)}")


def texts(argument: str, value: object) -> tuple[str, ...]:
    """Return a list of texts."""
    if not isinstance(value, list):
        raise BadArgument(argument, value, "a list of names")
    return tuple(text(argument, item) for item in value)


def table(parent: Table, key: str) -> Table:
    """Return a TOML table that is within another table."""
    value = parent[key]
    if not isinstance(value, dict):
        raise BadArgument(key, value, "a table")
    return value


def only(table: Table, *keys: str) -> None:
    """Reject a TOML table that has keys other than ``keys``."""
    for key in table:
        if key not in keys:
            raise BadArgument(key, table[key], f"only {', '.join(keys)} here")


def pose_entry(parent: Table, key: str) -> Pose:
    """Return a pose from a TOML table with "xyz" in m and "rpy" (roll, pitch, yaw) in rad; both are zero by default."""
    offset = table(parent, key) if key in parent else {}
    only(offset, "xyz", "rpy")
    position = vector(f"{key}.xyz", offset.get("xyz", (0.0, 0.0, 0.0)))
    return position, geometry.from_rpy(*vector(f"{key}.rpy", offset.get("rpy", (0.0, 0.0, 0.0))))


def _numbers(argument: str, value: object, length: int, expected: str) -> tuple[float, ...]:
    if isinstance(value, str | bytes | AbstractSet | Mapping) or not isinstance(value, Iterable | np.ndarray):
        raise BadArgument(argument, value, expected)
    items = list(itertools.islice(value, length + 1))
    if len(items) != length:
        raise BadArgument(argument, value, expected)
    try:
        return tuple(number(argument, item) for item in items)
    except BadArgument as error:
        raise BadArgument(argument, value, expected) from error
