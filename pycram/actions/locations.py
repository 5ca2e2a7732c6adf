"""Location designators: descriptions of places where the robot stands, or where the robot puts down an object."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias

from pycram.actions.objects import ObjectDesignator, object_of, thing
from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoPlace, UnknownName
from pycram.models.surfaces import Container, Surface
from pycram.motions.designator import Designator, ResolvedDesignator, Resolver, Solution
from pycram.motions.slots import ARM, ORIENTATION, POSITION, Description, Slot, SlotTable, ValueKind, slot_name
from pycram.reasoning.places import FoundPlace, PutDown, free_places, standing_places
from pycram.reasoning.places.free import SIDES, Side
from pycram.scheduling.future import unwrap
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.errors import suggestion

if TYPE_CHECKING:
    On: TypeAlias = Surface | Object | str
    Thing: TypeAlias = Object | ObjectDesignator | str

Surfaces: TypeAlias = "list[tuple[Object, Surface]]"  # pairs of furniture and a surface
_THING: Final = "Object | ObjectDesignator | str"
_ON: Final = "Surface | Object | str"
_IN: Final = "Container | Object | str"
_POINT: Final = f"{_THING} | Sequence[float]"


def _surfaces(name: str, value: Any) -> Surfaces:
    values = value if isinstance(value, list | tuple) else [value]
    found = [each for one in values for each in _surfaces_of(name, one)]
    if not found:
        raise BadArgument(name, value, "surfaces, or objects with a level top of at least 4 cm x 4 cm")
    return found


def _surfaces_of(name: str, value: Any) -> Surfaces:
    known = [(body, surface) for body in _furniture() for surface in body.surfaces.values()]
    if isinstance(value, Object):
        whole = [(body, surface) for body, surface in known if body is value and not surface.container]
        return whole or [(value, surface) for surface in value.tops]
    if isinstance(value, str):
        named = [(body, surface) for body, surface in known if surface.name == value]
        whole = [(body, surface) for body, surface in known if body.name == value and not surface.container]
        things = [(body, surface) for body in _furniture() if body.name == value for surface in body.tops]
        if not named and not whole and not things:
            names = [*(surface.name for _, surface in known), *(body.name for body in _furniture())]
            raise UnknownName("surface", value, "the world", names)
        return named or whole or things
    owned = [(body, surface) for body, surface in known if surface == value]
    if not owned:
        raise BadArgument(name, value, "a surface of an object in this world, its name, or an object with surfaces")
    return owned


def _inside(name: str, value: Any) -> Surfaces:
    known = [(body, container) for body in _furniture() for container in body.containers.values()]
    if isinstance(value, Object):
        chosen = [(body, container) for body, container in known if body is value]
    else:
        chosen = [(body, container) for body, container in known if value in (container.name, container)]
    if not chosen and isinstance(value, str):
        raise UnknownName("container", value, "the world", (container.name for _, container in known))
    found = [(body, body.surfaces[surface]) for body, container in chosen for surface in container.surfaces]
    if not found:
        raise BadArgument(name, value, "a container with surfaces, its name, or an object with containers")
    return found


def _furniture() -> list[Object]:
    return [body for body in BulletWorld.current_robot().world.objects if not body.is_robot]


def _near(name: str, value: Any) -> Any:
    if isinstance(value, Object | ObjectDesignator | str):
        return thing(name, value)
    return list(checks.vector(name, (*value, 0.0) if hasattr(value, "__len__") and len(value) == 2 else value))


def _side(name: str, value: Any) -> Any:
    side, of = value if isinstance(value, list | tuple) and len(value) == 2 else (value, None)
    if side not in SIDES:
        raise BadArgument(name, value, f"one of {', '.join(SIDES)}, or a pair (side, object)")
    return side if of is None else (side, thing(name, of))


def _reachable(name: str, value: Any) -> Any:
    if isinstance(value, Object | ObjectDesignator | str):
        return thing(name, value)
    return value if isinstance(value, PutDown) else POSITION(name, value)


_SLOTS: Final = SlotTable(
    "location",
    (
        Slot("position", POSITION, text="A known place: [x, y, z] in m, world frame"),
        Slot("orientation", ORIENTATION, text="Orientation at the place: a quaternion [x, y, z, w], world frame"),
        Slot(
            "on",
            ValueKind("", _surfaces, f"{_ON} | Sequence[{_ON}]"),
            text="A surface, its name, furniture (all its surfaces outside containers), an object such as a "
            "plate (its top), or a list of these",
        ),
        Slot("in", ValueKind("", _inside, _IN), text="A container, its name, or an object with containers"),
        Slot("for", ValueKind("", thing, _THING), text="the object to put down; by default the object of the action"),
        Slot(
            "near",
            ValueKind("", _near, _POINT),
            text="[x, y] or [x, y, z] in m, world frame, or an object; nearer is better, up to 1 m (the robot: 1.5 m)",
        ),
        Slot(
            "side",
            ValueKind("", _side, f"Side | tuple[Side, {_THING}]"),
            text='Side of the surface, or (side, object), seen from the robot: "front", "back", "left" or "right"',
        ),
        Slot(
            "reachable-for",
            ValueKind("", _reachable, f"{_POINT} | PutDown"),
            text="For a place of the robot, the target within reach: an object, or [x, y, z] in m; for a place "
            "of an object, the robot that must reach the place",
        ),
        Slot(
            "visible-for",
            ValueKind("", thing, _THING),
            text="the object that the robot's camera must see from the place",
        ),
        Slot(
            "away-from", ValueKind("", _near, _POINT), text="an object or a point, at least 0.4 m away from the place"
        ),
        Slot("arm", ARM, text="the arm that must reach the target; by default any arm"),
    ),
    one_of=("position", "on", "in", "near", "reachable-for", "visible-for"),
    designator="a LocationDesignator",
)
_AWAY: Final = 0.4  # minimum distance in m between a place and the point of the slot ``away_from``
_MAX_NEAR: Final = 20  # number of successive places too near to that point after which the search ends
_EXCLUDING: Final = (("on", "in"), ("position", "on"), ("position", "in"), ("on", "visible-for"), ("in", "visible-for"))


class LocationDesignator(ResolvedDesignator):
    """A place for an object, with the slot ``on`` or ``in``; without these slots, a place where the robot stands.

    Examples: ``LocationDesignator(on="island", near=[-0.8, 1])``, ``LocationDesignator(reachable_for=milk)``. Solutions
    have ``position`` and ``orientation`` in the world frame, and the ``arms`` that reach the place. The search yields
    places on demand, the best first.
    """

    takes: ClassVar[SlotTable] = _SLOTS

    if TYPE_CHECKING:

        def __init__(
            self,
            description: Description = (),
            parent: Designator | None = None,
            *,
            position: Sequence[float] | None = None,
            orientation: Sequence[float] | None = None,
            on: On | Sequence[On] | None = None,
            in_: Container | Object | str | None = None,
            for_: Thing | None = None,
            near: Thing | Sequence[float] | None = None,
            side: Side | tuple[Side, Thing] | None = None,
            reachable_for: Thing | Sequence[float] | PutDown | None = None,
            visible_for: Thing | None = None,
            away_from: Thing | Sequence[float] | None = None,
            arm: str | None = None,
        ) -> None: ...

    @staticmethod
    def _own_resolver() -> Resolver:
        return resolve

    def check(self) -> None:
        """Check that the surfaces and objects exist, and that no slot excludes another slot."""
        _checked(self)

    @property
    def for_objects(self) -> bool:
        """Whether the designator describes a place for an object."""
        return any(slot_name(name) in ("on", "in") for name, _ in self._slots)

    def middle(self) -> list[float]:
        """Return the middle of the largest surface of a place for an object, xyz in m in the world."""
        body, surface = max(self.surfaces(), key=lambda each: math.prod(each[1].size))
        return list(body.surface_pose(surface)[0])

    def surfaces(self) -> Surfaces:
        """Return the surfaces of a place for an object, with their furniture."""
        slots = _checked(self)
        found: Surfaces = slots.get("on") or slots["in"]
        return found

    def values_for(self, slot: str, given: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
        """Yield the possible places, and the orientations at these places."""
        body = given.get("object")
        needs_body = self.for_objects and self.prop_value("for") is None and body is not None
        for solution in (self.copy([("for", body)]) if needs_body else self).solutions():
            orientation = solution.get("orientation")
            yield {slot: solution["position"]} | ({"orientation": orientation} if orientation is not None else {})


def _checked(designator: LocationDesignator) -> dict[str, Any]:
    given = {key: unwrap(value) for key, value in designator.description if value is not None}
    checked = _SLOTS.checked(given)
    for one, other in _EXCLUDING:
        if one in checked and other in checked:
            raise _SLOTS.error(f"slots {one} and {other} exclude each other", other, given[other])
    return checked


def resolve(designator: LocationDesignator) -> Iterator[Solution]:
    """Yield the places that a designator describes, the best first; raise NoPlace without a place."""
    slots = _checked(designator)
    if "position" in slots:
        yield {"position": slots["position"], "orientation": slots.get("orientation"), "arms": ()}
        return
    for place in _objects_places(slots) if designator.for_objects else _robots_places(slots):
        yield {
            "position": list(place.position),
            "orientation": list(place.orientation),
            "arms": list(place.arms),
            "surface": place.surface,
        }


def _objects_places(slots: Mapping[str, Any]) -> Iterator[FoundPlace]:
    if "for" not in slots:
        known = sorted({body.type for body in _furniture() if not body.is_environment})
        raise _SLOTS.error(f"missing slot for: the object to put down; {suggestion('', known)}", "for")
    side, near = slots.get("side"), slots.get("near")
    robot = slots.get("reachable-for")
    return free_places(
        object_of(slots["for"]),
        on=slots.get("on") or slots["in"],
        near=_point(near),
        side=side if side is None or isinstance(side, str) else (side[0], object_of(side[1])),
        orientation=slots.get("orientation"),
        reachable_for=None if robot is None else object_of(robot),
        arms=None if "arm" not in slots else (slots["arm"],),
        away=_point(slots.get("away-from")),
    )


def _robots_places(slots: Mapping[str, Any]) -> Iterator[FoundPlace]:
    target = slots.get("reachable-for")
    seen = slots.get("visible-for")
    robot, away = BulletWorld.current_robot(), _point(slots.get("away-from"))
    places = standing_places(
        robot,
        reach=() if target is None else (object_of(target),),
        arms=None if "arm" not in slots else (slots["arm"],),
        see=None if seen is None else object_of(seen),
        near=_point(slots.get("near")),
    )
    return places if away is None else _far_from(away, places, robot)


def _far_from(point: Sequence[float], places: Iterator[FoundPlace], robot: Object) -> Iterator[FoundPlace]:
    near = 0
    for place in places:
        if math.dist(place.position[:2], point[:2]) >= _AWAY:
            near = 0
            yield place
        elif (near := near + 1) == _MAX_NEAR:
            break
    if near:
        raise NoPlace(f"{robot.name} to stand", {"away-from": near}, "away-from")


def _point(near: Any) -> Any:
    """Return a point unchanged; for an object, return its position."""
    return object_of(near).get_position() if isinstance(near, Object | ObjectDesignator) else near
