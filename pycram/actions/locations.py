"""Location designators: places as plans describe them, for the robot to stand at, or for an object to be put down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pycram.motions import slot_checks
from pycram.motions.designator import ResolvedDesignator
from pycram.motions.motion_types import Slot, checked_slots
from pycram.scheduling.future import unwrap

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pycram.motions.designator import Resolver
    from pycram.motions.solutions import Solution


class _Slots:
    """The slots of location designators."""

    type = "location"
    slots: Final = (
        Slot("position", slot_checks.position, text="[x, y, z] in m, world frame: a place that is known"),
        Slot("orientation", slot_checks.orientation, text="a quaternion [x, y, z, w], world frame, there"),
    )
    one_of: Final = ("position",)
    only_one = False

    @staticmethod
    def describe() -> str:
        """Describe them, for messages."""
        return "\n".join(["a LocationDesignator takes", *(f"  {slot.describe()}" for slot in _Slots.slots)])


class LocationDesignator(ResolvedDesignator):
    """A place: for the robot to stand at, or for an object to be put down.

    Its solutions have ``position`` and, where it matters, ``orientation``, in the world frame.
    """

    @staticmethod
    def _own_resolver() -> Resolver:
        return resolve

    def check(self) -> None:
        """Check its slots."""
        _checked(self)

    def values_for(self, slot: str, given: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:  # noqa: ARG002
        """Yield the places that it may stand for, with the orientations there."""
        for solution in self.solutions():
            orientation = solution.get("orientation")
            yield {slot: solution["position"]} | ({"orientation": orientation} if orientation is not None else {})


def _checked(designator: LocationDesignator) -> dict[str, Any]:
    given = {key: unwrap(value) for key, value in designator.description if value is not None}
    return checked_slots(_Slots(), given)


def resolve(designator: LocationDesignator) -> Iterator[Solution]:
    """Yield the places that a designator describes, the best first."""
    slots = _checked(designator)
    yield slots
