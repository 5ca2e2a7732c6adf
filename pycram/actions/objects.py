"""Object designators: descriptions of objects, resolved by the robot's beliefs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Final

from pycram.foundation.failures import BadArgument, PerceptionError
from pycram.knowledge import beliefs
from pycram.motions.designator import ResolvedDesignator
from pycram.motions.slots import BODY, NAME, DesignatorError, Slot, SlotTable
from pycram.scheduling.future import unwrap
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.errors import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Unpack

    from pycram.actions.designator_slots import ObjectSlots
    from pycram.motions.designator import Designator, Resolver, Solution
    from pycram.motions.slots import Description


_SLOTS: Final = SlotTable(
    "object",
    (Slot("type", NAME, text='type of the object, such as "milk"'), Slot("name", NAME, text="name of the object")),
    one_of=("type", "name"),
    designator="an ObjectDesignator",
)


class ObjectDesignator(ResolvedDesignator):
    """An object, such as ``ObjectDesignator(type="milk")``, resolved by the robot's beliefs, the latest look first.

    Its solutions have ``object``, ``position`` and ``orientation``: the object, and its believed pose.
    """

    takes: ClassVar[SlotTable] = _SLOTS

    if TYPE_CHECKING:

        def __init__(
            self, description: Description = (), parent: Designator | None = None, **slots: Unpack[ObjectSlots]
        ) -> None: ...

    @staticmethod
    def _own_resolver() -> Resolver:
        return resolve

    def check(self) -> None:
        """Check its slots, and that the world has such an object.

        Raises:
            DesignatorError: A slot is unknown or wrong, or the world has no object like that.
        """
        _candidates(self)

    def values_for(self, slot: str, given: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:  # noqa: ARG002
        """Yield its possible objects."""
        for solution in self.solutions():
            yield {slot: solution["object"]}


def resolve(designator: ObjectDesignator) -> Iterator[Solution]:
    """Yield the beliefs about the objects of a designator, the latest first.

    Raises:
        DesignatorError: There are none in the world.
        PerceptionError: There is no belief about them.
    """
    candidates = _candidates(designator)
    known = [belief for belief in beliefs() if belief.object in candidates]
    if not known:
        reasons = {body.name: "was never seen" for body in candidates}
        raise PerceptionError(candidates[0].type, reasons)
    for belief in known:
        yield {"object": belief.object, "position": list(belief.position), "orientation": list(belief.orientation)}


def _candidates(designator: ObjectDesignator) -> list[Object]:
    """Return the objects of the world that a designator describes.

    Raises:
        DesignatorError: There are none.
    """
    given = {key: unwrap(value) for key, value in designator.description if value is not None}
    wanted = _SLOTS.checked(given)
    world = BulletWorld.current_robot().world
    found = world.objects
    for slot, value in wanted.items():
        known = sorted({str(getattr(body, slot)) for body in found if not body.is_robot})
        found = [body for body in found if getattr(body, slot) == value]
        if not found:
            problem = f"the world has no object of {slot} {value!r}; {suggestion(value, known)}"
            raise DesignatorError(problem, type="object", slot=slot, value=value, takes=f"it has: {', '.join(known)}")
    return found


def candidates_of(thing: Object | ObjectDesignator) -> list[Object]:
    """Return the given object, or the objects of one type that a designator describes."""
    if not isinstance(thing, ObjectDesignator):
        return [thing]
    found = _candidates(thing)
    return [body for body in found if body.type == found[0].type]


def object_of(thing: Object | ObjectDesignator) -> Object:
    """Return the given object, or the first solution of a designator.

    Raises:
        PerceptionError: There is no belief about it.
    """
    if not isinstance(thing, ObjectDesignator):
        return thing
    found: Object = thing.reference()["object"]
    return found


def thing(name: str, value: Any) -> Any:
    """Check an object of a plan: an Object of a world, an ObjectDesignator, or a type of objects."""
    if isinstance(value, Object):
        return BODY(name, value)
    designator = ObjectDesignator(type=value) if isinstance(value, str) else value
    if not isinstance(designator, ObjectDesignator):
        raise BadArgument(name, value, "an Object, an ObjectDesignator, or a type of objects")
    designator.check()
    return designator
