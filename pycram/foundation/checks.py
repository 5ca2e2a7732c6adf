"""Checks of what users give, before anything changes: numbers, positions, orientations, colours.

Each returns plain floats, so that nothing of the caller's arrays is kept or aliased.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from typing import TYPE_CHECKING, SupportsFloat, cast

import numpy as np

from pycram.foundation.failures import BadArgument

if TYPE_CHECKING:
    from recorder.geometry import Quaternion, Vector

_MOST = 2**53
_FARTHEST = 1e6  # m; beyond it the engine's arithmetic has no millimetres left


def number(argument: str, value: object) -> float:
    """A finite number.

    Args:
        argument: what it is, for the error.
        value: what was given.

    Raises:
        BadArgument: it isn't one.
    """
    if isinstance(value, bool | str | bytes):
        raise BadArgument(argument, value, "a number")
    try:
        result = float(cast("SupportsFloat", value))
    except (TypeError, ValueError, OverflowError) as error:
        raise BadArgument(argument, value, "a number") from error
    if not math.isfinite(result):
        raise BadArgument(argument, value, "a finite number")
    return result


def at_least(argument: str, value: object, least: float) -> float:
    """A finite number that isn't too small.

    Args:
        argument: what it is, for the error.
        value: what was given.
        least: the smallest that will do.

    Raises:
        BadArgument: it isn't one.
    """
    result = number(argument, value)
    if result < least:
        raise BadArgument(argument, value, f"a number from {least:g} up")
    return result


def count(argument: str, value: object) -> int:
    """A whole number from 0 up.

    Args:
        argument: what it is, for the error.
        value: what was given.

    Raises:
        BadArgument: it isn't one, or more than records can hold.
    """
    result = number(argument, value)
    if result != int(result) or not 0 <= result < _MOST:
        raise BadArgument(argument, value, "a whole number from 0 up")
    return int(result)


def switch(argument: str, value: object) -> bool:
    """On or off.

    Args:
        argument: what it is, for the error.
        value: True or False, also as 1 or 0.

    Raises:
        BadArgument: it is neither.
    """
    if isinstance(value, bool | int | np.bool_ | np.integer) and value in (0, 1):
        return bool(value)
    raise BadArgument(argument, value, "True or False")


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


def vector(argument: str, value: object) -> Vector:
    """Three finite numbers.

    Args:
        argument: what it is, for the error.
        value: list, tuple or array of 3.

    Raises:
        BadArgument: it isn't that.
    """
    x, y, z = _numbers(argument, value, 3, "3 finite numbers x, y, z")
    if max(abs(x), abs(y), abs(z)) > _FARTHEST:
        raise BadArgument(argument, value, f"coordinates within {_FARTHEST:g}")
    return x, y, z


def quaternion(argument: str, value: object) -> Quaternion:
    """A rotation.

    Args:
        argument: what it is, for the error.
        value: 4 numbers x, y, z, w that aren't all zero.

    Returns:
        The unit quaternion; one that is a unit already (to 1e-9) keeps its bits.

    Raises:
        BadArgument: it isn't that.
    """
    expected = "4 finite numbers x, y, z, w that aren't all zero"
    x, y, z, w = _numbers(argument, value, 4, expected)
    length = math.hypot(x, y, z, w)
    if not math.isfinite(length) or length < 1e-9:
        raise BadArgument(argument, value, expected)
    if abs(length - 1) > 1e-9:
        x, y, z, w = x / length, y / length, z / length, w / length
    return x, y, z, w


def color(argument: str, value: object) -> tuple[float, float, float, float]:
    """A colour.

    Args:
        argument: what it is, for the error.
        value: RGBA, each 0..1.

    Raises:
        BadArgument: it isn't that.
    """
    expected = "4 numbers r, g, b, a from 0 to 1"
    r, g, b, a = _numbers(argument, value, 4, expected)
    if min(r, g, b, a) < 0 or max(r, g, b, a) > 1:
        raise BadArgument(argument, value, expected)
    return r, g, b, a


def text(argument: str, value: object) -> str:
    """A name.

    Args:
        argument: what it is, for the error.
        value: a string that isn't empty.

    Raises:
        BadArgument: it isn't that, or has characters that no file can hold (lone surrogates).
    """
    if not isinstance(value, str) or not value.strip() or any("\ud800" <= letter <= "\udfff" for letter in value):
        raise BadArgument(argument, value, "a string that isn't empty")
    return value
