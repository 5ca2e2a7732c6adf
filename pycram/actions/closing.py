"""Closing drawers and doors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pycram.actions.action import action
from pycram.actions.containers import CHECKS, access_of, choices, move

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence


def _choices(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Iterator[Mapping[str, Any]]:
    access = access_of(container, joint, handle)
    for choice in choices(access, arm, [access.closed], place, orientation):
        yield {slot: value for slot, value in choice.items() if slot != "distance"}


@action("closing", choices=_choices, checked=CHECKS)
def closing(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> None:
    """Closes a drawer or door by its handle, from a place from which an arm holds it all the way.

    Args:
        container: A container of furniture, its name, or the furniture itself with joint and handle.
        joint: Name of its joint, where the furniture itself is given.
        handle: Link of its handle, where the furniture itself is given.
        arm: Name of the arm; by default any that reaches.
        place: Where the robot stands, [x, y, z] of its base in m; by default where the handle can be held all the way.
        orientation: A quaternion [x, y, z, w] of the robot's base there.
    """
    assert arm is not None and place is not None and orientation is not None  # noqa: S101, PT018  chosen
    move(access_of(container, joint, handle), arm, 0.0, place, orientation)
