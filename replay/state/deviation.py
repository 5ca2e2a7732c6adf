"""Deviations: where two things that should be the same are not, and by how much."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.state.json_data import Plain


@dataclass(frozen=True, slots=True)
class Deviation:
    """A difference.

    Attributes:
        field: where, as ``effect.bodies[milk].position[0]``.
        recorded: what the recording says; None if it says nothing.
        found: what is found; None for nothing.
    """

    field: str
    recorded: Plain
    found: Plain

    @property
    def size(self) -> float:
        """By how much numbers differ, in their unit; infinite for what aren't numbers."""
        if isinstance(self.recorded, int | float) and isinstance(self.found, int | float):
            size = abs(self.recorded - self.found)
            return math.inf if math.isnan(size) else size
        return math.inf

    def __str__(self) -> str:
        told = f"{self.field}: recorded {_short(self.recorded)}, found {_short(self.found)}"
        return told + (f" (they differ by {self.size:.3g})" if math.isfinite(self.size) else "")


def first_deviation(recorded: Plain, found: Plain, field: str = "") -> Deviation | None:
    """The first place in which two values of plain data differ; None if they are the same.

    Args:
        recorded: what the recording says.
        found: what is found.
        field: name of the whole.
    """
    return next(_deviations(recorded, found, field), None)


def _deviations(recorded: Plain, found: Plain, field: str) -> Iterator[Deviation]:
    if isinstance(recorded, dict) and isinstance(found, dict):
        for key in [*recorded, *(key for key in found if key not in recorded)]:
            yield from _deviations(recorded.get(key), found.get(key), f"{field}.{key}" if field else key)
    elif isinstance(recorded, list) and isinstance(found, list):
        for index, (one, other) in enumerate(zip(recorded, found, strict=False)):
            yield from _deviations(one, other, f"{field}[{_name(one) or index}]")
        if len(recorded) != len(found):
            yield Deviation(f"number of {field}", len(recorded), len(found))
    elif recorded != found or type(recorded) is not type(found):
        yield Deviation(field, recorded, found)


def _name(item: Plain) -> str:
    """What an item of a list is called, if it has a name."""
    return str(item["body"]) if isinstance(item, dict) and "body" in item else ""


def _short(value: Plain) -> str:
    if value is None:
        return "nothing"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
