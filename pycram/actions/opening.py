"""Opening drawers and doors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pycram.actions.action import action
from pycram.actions.containers import CHECKS, access_of, choices, move

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

_WIDE: Final = {True: 0.4, False: 1.2}  # m of what slides, as what is at its back is to be reached; rad of what turns
_SHARES: Final = (1.0, 0.75, 0.5)  # of that, that are tried


def _choices(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    distance: float | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Iterator[Mapping[str, Any]]:
    access = access_of(container, joint, handle)
    wide = min(access.open - access.closed, _WIDE[access.body.urdf.joint(access.joint).type == "prismatic"])
    widths = [share * wide for share in _SHARES] if distance is None else [distance]
    yield from choices(access, arm, [access.closed + width for width in widths], place, orientation)


@action("opening", choices=_choices, checked=CHECKS)
def opening(
    container: Any,
    joint: str | None = None,
    handle: str | None = None,
    arm: str | None = None,
    distance: float | None = None,
    place: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> str:
    """Opens a drawer or door by its handle, from a place from which an arm holds it all the way; returns the arm.

    Args:
        container: A container of furniture, its name, or the furniture itself with joint and handle.
        joint: Name of its joint, where the furniture itself is given.
        handle: Link of its handle, where the furniture itself is given.
        arm: Name of the arm; by default any that reaches.
        distance: How wide, in m, or rad of what turns; by default up to 0.4 m or 1.2 rad, or down to half as wide.
        place: Where the robot stands, [x, y, z] of its base in m; by default where the handle can be held all the way.
        orientation: A quaternion [x, y, z, w] of the robot's base there.
    """
    assert arm is not None and distance is not None and place is not None and orientation is not None  # noqa: S101, PT018  chosen
    move(access_of(container, joint, handle), arm, distance, place, orientation)
    return arm
