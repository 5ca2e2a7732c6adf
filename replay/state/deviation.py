"""Deviations of actual from recorded values, with their field and size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Plain


@dataclass(frozen=True, slots=True)
class Deviation:
    """A difference.

    Attributes:
        field: where, as ``effect.bodies[milk].position[0]``.
        recorded: the recorded value; None if there is none.
        found: the actual value; None if there is none.
    """

    field: str
    recorded: Plain
    found: Plain

    @property
    def size(self) -> float:
        """The difference of numbers, in their unit; infinite for other values."""
        if isinstance(self.recorded, int | float) and isinstance(self.found, int | float):
            size = abs(self.recorded - self.found)
            return math.inf if math.isnan(size) else size
        return math.inf

    def __str__(self) -> str:
        text = f"{self.field}: recorded {_short(self.recorded)}, found {_short(self.found)}"
        return text + (f" (they differ by {self.size:.3g})" if math.isfinite(self.size) else "")


def first_deviation(recorded: Plain, actual: Plain, field: str = "") -> Deviation | None:
    """Return the first deviation between two values of JSON data; None if they are equal."""
    return next(_deviations(recorded, actual, field), None)


def _deviations(recorded: Plain, actual: Plain, field: str) -> Iterator[Deviation]:
    if isinstance(recorded, dict) and isinstance(actual, dict):
        for key in [*recorded, *(key for key in actual if key not in recorded)]:
            yield from _deviations(recorded.get(key), actual.get(key), f"{field}.{key}" if field else key)
    elif isinstance(recorded, list) and isinstance(actual, list):
        for index, (a, b) in enumerate(zip(recorded, actual, strict=False)):
            yield from _deviations(a, b, f"{field}[{_name(a) or index}]")
        if len(recorded) != len(actual):
            yield Deviation(f"number of {field}", len(recorded), len(actual))
    elif recorded != actual or type(recorded) is not type(actual):
        yield Deviation(field, recorded, actual)


def _name(item: Plain) -> str:
    """Return the name of the body that an item of a list is about; "" if there is none."""
    return str(item["body"]) if isinstance(item, dict) and "body" in item else ""


def _short(value: Plain) -> str:
    if value is None:
        return "nothing"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
