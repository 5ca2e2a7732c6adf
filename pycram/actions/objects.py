"""Object designators: descriptions of objects; the robot's beliefs resolve them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final

from pycram.foundation.failures import BadArgument, PerceptionError
from pycram.knowledge import beliefs
from pycram.motions.designator import Designator, ResolvedDesignator, Resolver, Solution
from pycram.motions.slots import BODY, NAME, Description, DesignatorError, Slot, SlotTable
from pycram.scheduling.future import unwrap
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.errors import suggestion

_SLOTS: Final = SlotTable(
    "object",
    (Slot("type", NAME, text='type of the object, such as "milk"'), Slot("name", NAME, text="name of the object")),
    one_of=("type", "name"),
    designator="an ObjectDesignator",
)


class ObjectDesignator(ResolvedDesignator):
    """An object about which the robot has a belief, such as ``ObjectDesignator(type="milk")``.

    Solutions have ``object``, and the believed ``position`` and ``orientation`` of this object. The solution with the
    robot's latest belief comes first.
    """

    takes: ClassVar[SlotTable] = _SLOTS

    if TYPE_CHECKING:

        def __init__(
            self,
            description: Description = (),
            parent: Designator | None = None,
            *,
            type: str | None = None,  # noqa: A002  the slot's name
            name: str | None = None,
        ) -> None: ...

    @staticmethod
    def _own_resolver() -> Resolver:
        return resolve

    def check(self) -> None:
        """Raise DesignatorError if a slot is unknown or wrong, or if the world has no such object."""
        _candidates(self)

    def values_for(self, slot: str, given: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:  # noqa: ARG002
        """Yield the possible objects."""
        for solution in self.solutions():
            yield {slot: solution["object"]}


def resolve(designator: ObjectDesignator) -> Iterator[Solution]:
    """Yield the beliefs about the objects of a designator, the latest first; raise PerceptionError without a belief."""
    candidates = _candidates(designator)
    known = [belief for belief in beliefs() if belief.object in candidates]
    if not known:
        raise PerceptionError(candidates[0].type, {body.name: "was never seen" for body in candidates})
    for belief in known:
        yield {"object": belief.object, "position": list(belief.position), "orientation": list(belief.orientation)}


def _candidates(designator: ObjectDesignator) -> list[Object]:
    """Return the objects of the world that a designator describes; raise DesignatorError without such an object."""
    wanted = _SLOTS.checked({key: unwrap(value) for key, value in designator.description if value is not None})
    found = BulletWorld.current_robot().world.objects
    for slot, value in wanted.items():
        known = sorted({str(getattr(body, slot)) for body in found if not body.is_robot})
        found = [body for body in found if getattr(body, slot) == value]
        if not found:
            problem = f"the world has no object of {slot} {value!r}; {suggestion(value, known)}"
            takes = f"the world has: {', '.join(known)}"
            raise DesignatorError(problem, type="object", slot=slot, value=value, takes=takes)
    return found


def candidates_of(thing: Object | ObjectDesignator) -> list[Object]:
    """Return the given object, or the objects of the type that a designator describes."""
    if not isinstance(thing, ObjectDesignator):
        return [thing]
    found = _candidates(thing)
    return [body for body in found if body.type == found[0].type]


def object_of(thing: Object | ObjectDesignator) -> Object:
    """Return the given object, or the first solution of a designator; raise PerceptionError without a belief."""
    if not isinstance(thing, ObjectDesignator):
        return thing
    found: Object = thing.reference()["object"]
    return found


def thing(name: str, value: Any) -> Any:
    """Return a checked Object or ObjectDesignator; a type of objects becomes an ObjectDesignator."""
    if isinstance(value, Object):
        return BODY(name, value)
    designator = ObjectDesignator(type=value) if isinstance(value, str) else value
    if not isinstance(designator, ObjectDesignator):
        raise BadArgument(name, value, "an Object, an ObjectDesignator, or a type of objects")
    designator.check()
    return designator
