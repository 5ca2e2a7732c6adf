"""Overlaps: objects that are inside of each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from recorder import records

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object

DEEP: Final = 5e-3
"""Depth in m above which an overlap is an error; the solver lets resting objects overlap a little."""


class Overlapping(UserWarning):
    """An object was loaded inside of other objects; a simulation would throw them apart or jam them."""


def overlaps(body: Object) -> list[records.Overlap]:
    """Return the deepest overlap of an object with each other object, except between two fixed objects."""
    found = []
    for other in body.world.objects:
        if other is body or (body.fixed and other.fixed):
            continue
        deepest = body.world.engine.deepest(body.handle, other.handle)
        if deepest is not None and deepest.distance < -DEEP:
            links = {"link": deepest.link_a, "body": other.name, "body_link": deepest.link_b}
            found.append(records.Overlap(**links, depth=-deepest.distance))
    return found


def warning(body: str, found: Sequence[records.Overlap]) -> str:
    """Return the message of the warning that an object was loaded inside of other objects."""
    others = ", ".join(f"{overlap.depth * 1e3:.0f} mm inside of {overlap.body}" for overlap in found)
    return f"{body} is {others}; world.settle() lifts free objects apart before it simulates"
