"""Slots of designators: (name, value) pairs that don't change once a designator is made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias, TypeVar

import numpy as np

from pycram.foundation.failures import UsageError
from pycram.foundation.names import export

#: Slots as plans write them; also constraints and properties.
Description: TypeAlias = Iterable[tuple[str, object]] | Mapping[str, object]
#: Whatever the plan put into a slot, or made a designator stand for.
Value: TypeAlias = Any
T = TypeVar("T")


class DesignatorError(UsageError):
    """A designator that can't be resolved: a slot is missing, unknown or wrong.

    Attributes:
        type: The designator's type, "" if it has none.
        slot: Name of the slot, "" for none.
        value: Its value.
        takes: Description of the slots of that type.
    """

    def __init__(self, problem: str, *, type: str = "", slot: str = "", value: object = None, takes: str = "") -> None:  # noqa: A002  the slot's name
        super().__init__(f"{problem}\n{takes}" if takes else problem)
        self.type = type
        self.slot = slot
        self.value = value
        self.takes = takes


export("pycram.designator", DesignatorError)


def pairs(description: Description) -> tuple[tuple[str, Value], ...]:
    """Return a description's slots, with copies of its containers.

    Raises:
        DesignatorError: It isn't a list of pairs.
    """
    try:
        if isinstance(description, str):
            raise TypeError  # noqa: TRY301  pairs of letters, by chance
        items = tuple(description.items() if isinstance(description, Mapping) else map(tuple, description))
        slots = tuple((name, own(value)) for name, value in items)
    except (TypeError, ValueError):
        slots = None
    if slots is None or not all(isinstance(name, str) for name, _ in slots):
        raise DesignatorError(
            "a designator is described by a list of (name, value) pairs, such as "
            f"[('type', 'looking'), ('target', [1, 0, 1])]; not by {description!r}",
            value=description,
        )
    return slots


def slot_name(argument: str) -> str:
    """Return the slot that a keyword argument names: ``reachable_for`` is ``reachable-for``, ``in_`` is ``in``."""
    return argument.rstrip("_").replace("_", "-")


def own(value: T) -> T:
    """Return a value with copies of its lists, dictionaries, sets and arrays; other objects in it stay the same."""
    copied: T = _own(value, {})
    return copied


def _own(value: Value, known: dict[int, Value]) -> Value:
    if id(value) in known:  # a container that holds itself
        return known[id(value)]
    if type(value) is list:
        items: list[Value] = []
        known[id(value)] = items
        items.extend(_own(item, known) for item in value)
        return items
    if type(value) is dict:
        table: dict[Value, Value] = {}
        known[id(value)] = table
        table.update((key, _own(item, known)) for key, item in value.items())
        return table
    if type(value) is tuple:
        return tuple(_own(item, known) for item in value)
    return value.copy() if type(value) in (set, np.ndarray) else value


def same(left: Value, right: Value) -> bool:
    """Whether two values are equal, arrays too."""
    arrays = isinstance(left, np.ndarray) or isinstance(right, np.ndarray)
    return bool(np.array_equal(left, right) if arrays else left == right)
