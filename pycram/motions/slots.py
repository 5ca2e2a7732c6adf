"""Slots of designators: (name, value) pairs, and the tables that check these pairs.

The slots of a designator never change, because lists and other containers are copied when they enter and leave it.
"""

from __future__ import annotations

import keyword
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias, TypeVar

import numpy as np

from pycram.foundation import checks
from pycram.foundation.errors import export
from pycram.foundation.failures import BadArgument, UsageError
from pycram.models.robots.description import Arm
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping.grasps import GRASPS
from pycram.scheduling.future import unwrap
from pycram.world.world import BulletWorld, Object
from recorder.errors import did_you_mean

if TYPE_CHECKING:
    from pycram.motions.designator import ResolvedDesignator

#: The form in which plans write slots, constraints and properties.
Description: TypeAlias = Iterable[tuple[str, object]] | Mapping[str, object]
Value: TypeAlias = Any  # any value of a slot
T = TypeVar("T")
Type = TypeVar("Type", bound="SlotTable")


class DesignatorError(UsageError):
    """A designator that can't be resolved: a slot is missing, unknown or wrong."""

    def __init__(self, problem: str, *, type: str = "", slot: str = "", value: object = None, takes: str = "") -> None:  # noqa: A002  the slot's name
        # the first line is for summaries; the last line is visible in a terminal after a long list
        super().__init__(f"{problem}\n{takes}\n{problem}" if takes else problem)
        self.type = type  # type of the designator; "" without a type
        self.slot = slot  # name of the wrong slot; "" without a slot
        self.value = value
        self.takes = takes  # text about the slots of that type


export("pycram.designator", DesignatorError)


def pairs(description: Description) -> tuple[tuple[str, Value], ...]:
    """Return the slots of a list of pairs or of a mapping, with copies of containers; else raise DesignatorError."""
    try:
        if isinstance(description, str):
            raise TypeError  # noqa: TRY301  without this check, a string of two letters would be a pair
        items = tuple(description.items() if isinstance(description, Mapping) else map(tuple, description))
        slots = tuple((name, own(value)) for name, value in items)
    except (TypeError, ValueError):
        slots = None
    if slots is None or not all(isinstance(name, str) for name, _ in slots):
        raise DesignatorError(
            "the description of a designator is a list of (name, value) pairs, such as "
            f"[('type', 'looking'), ('target', [1, 0, 1])]; not {description!r}",
            value=description,
        )
    return slots


def slot_name(argument: str) -> str:
    """Return the name of a keyword argument's slot: ``reachable_for`` is ``reachable-for``, ``in_`` is ``in``."""
    return argument.rstrip("_").replace("_", "-")


def slot_argument(name: str) -> str:
    """Return the keyword argument of a slot; the inverse of :func:`slot_name`."""
    argument = name.replace("-", "_")
    return f"{argument}_" if keyword.iskeyword(argument) else argument


class SolutionSlots(dict[str, Value]):
    """A solution. ``object_type`` finds the parameter ``object-type``, and the reverse; only one of them is listed."""

    def __missing__(self, key: str) -> Value:
        for name, value in self.items():
            if slot_name(str(name)) == slot_name(str(key)):
                return value
        raise KeyError(key)

    def __getattr__(self, name: str) -> Value:
        raise AttributeError(f'a solution is a dictionary: write solution["{name}"]', name=name, obj=self)

    def get(self, key: str, default: Value = None) -> Value:
        """Return a parameter, or the default for a missing parameter."""
        return self[key] if key in self else default  # noqa: SIM401  self.get() would call this method again

    def __contains__(self, key: object) -> bool:
        return super().__contains__(key) or slot_name(str(key)) in (slot_name(str(name)) for name in self)


def filled(type: str, **slots: object) -> list[tuple[str, object]]:  # noqa: A002  the slot's name
    """Return the description of a designator; slots that are None are left out."""
    return [("type", type), *((slot_name(key), value) for key, value in slots.items() if value is not None)]


def own(value: T) -> T:
    """Return a value with copies of its lists, dictionaries, sets and arrays; other objects aren't copied."""
    copied: T = _own(value, {})
    return copied


def _own(value: Value, known: dict[int, Value]) -> Value:
    if id(value) in known:  # a container may contain itself
        return known[id(value)]
    if type(value) is list:
        items: list[Value] = []
        known[id(value)] = items
        items.extend(_own(item, known) for item in value)
        return items
    if type(value) in (dict, SolutionSlots):
        table: dict[Value, Value] = {}
        known[id(value)] = table
        table.update((key, _own(item, known)) for key, item in value.items())
        return table
    if type(value) is tuple:
        return tuple(_own(item, known) for item in value)
    return value.copy() if type(value) in (set, np.ndarray) else value


def same(left: Value, right: Value) -> bool:
    """Return whether two values, which may be arrays, are equal."""
    arrays = isinstance(left, np.ndarray) or isinstance(right, np.ndarray)
    return bool(np.array_equal(left, right) if arrays else left == right)


#: A function that returns a slot's value in the form that process modules use, or raises BadArgument.
Check: TypeAlias = Callable[[str, Value], Value]


@dataclass(frozen=True, slots=True)
class ValueKind:
    """A kind of values of slots, with a function that checks them."""

    text: str  # the possible values, with units and frames
    check: Check
    python: str = "Any"  # Python type of the values, in the form of an annotation
    designator: str = ""  # class of designators that may replace a value of this kind in a motion

    def __call__(self, name: str, value: Value) -> Value:
        """Return the checked value of a slot."""
        return self.check(name, value)


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot of a type of designators."""

    name: str
    check: Check
    required: bool = False
    default: Callable[[dict[str, Value]], Value] | None = None  # infers a missing value from the slots that are given
    aliases: tuple[str, ...] = ()
    text: str = ""  # text about the possible values; by default :attr:`ValueKind.text`
    otherwise: str = ""  # the default, or the effect of leaving the slot out

    @property
    def values(self) -> str:
        """The possible values, with units and frames."""
        return self.text or (self.check.text if isinstance(self.check, ValueKind) else "")

    @property
    def python(self) -> str:
        """The Python type of the values, as an annotation."""
        return self.check.python if isinstance(self.check, ValueKind) else "Any"


@dataclass(frozen=True)
class SlotTable:
    """The slots of a type of designators."""

    type: str
    slots: tuple[Slot, ...]  # all slots except ``type``
    one_of: tuple[str, ...] = ()  # at least one of these slots is required
    only_one: bool = False  # whether exactly one of the slots in ``one_of`` is required
    designator: str = ""  # name of a class without a slot ``type``, such as "an ObjectDesignator"
    takes_designators: ClassVar[bool] = False  # whether designators may replace values (ValueKind.designator)

    def describe(self) -> str:
        """Return a text about the slots, for messages."""
        typed = [f"a {self.type} designator takes", f"  type (required): {self.type!r}"]
        lines = [f"{self.designator} takes"] if self.designator else typed
        for slot in self.slots:
            names = " or ".join((slot.name, *slot.aliases))
            lines.append(f"  {names} ({'required' if slot.required else 'optional'}): {slot.values}")
        if self.one_of:
            how = "exactly one" if self.only_one else "at least one"
            lines.append(f"  {how} of {', '.join(self.one_of)} is required")
        return "\n".join(lines)

    def error(self, problem: str, slot: str, value: Value = None) -> DesignatorError:
        """Return the error of a slot, with a text about all slots."""
        return DesignatorError(problem, type=self.type, slot=slot, value=value, takes=self.describe())

    def checked(self, given: Mapping[str, Value]) -> dict[str, Value]:
        """Return the checked values by slots; raise DesignatorError if a slot is missing, unknown or wrong."""
        names = {slot_name(name): slot for slot in self.slots for name in (slot.name, *slot.aliases)}
        checked: dict[str, Value] = {}
        for key, value in given.items():
            slot = names.get(slot_name(key))
            if slot is None:
                raise self.error(f"unknown slot {key}{did_you_mean(key, names)}", key, value)
            if slot.name in checked:
                raise self.error(f"slot {slot.name} is given twice", key, value)
            try:
                checked[slot.name] = slot.check(key, value)
            except BadArgument as error:
                kind = slot.check.designator if self.takes_designators and isinstance(slot.check, ValueKind) else ""
                named = " or ".join(f"{'an' if each[0] == 'O' else 'a'} {each}" for each in kind.split(" | ") if each)
                also = f", or {named}" if kind and kind not in error.expected else ""
                raise self.error(f"wrong value in slot {error}{also}", key, value) from error
        missing = [slot.name for slot in self.slots if slot.required and slot.name not in checked]
        if missing:
            raise self.error(f"missing slot {', '.join(missing)}", missing[0])
        present = [name for name in self.one_of if name in checked]
        if self.one_of and not present:
            raise self.error(f"missing slot {' or '.join(self.one_of)}", self.one_of[0])
        if self.only_one and len(present) > 1:
            raise self.error(f"slots {' and '.join(present)} exclude each other", self.one_of[0])
        return checked


def given_slots(
    designator: ResolvedDesignator, types: Mapping[str, Type], kind: str = ""
) -> tuple[Type, dict[str, Value]]:
    """Return the table of a designator's type, and the other slots that aren't None; wait for futures.

    Raise DesignatorError for an unknown type, or for a repeated slot; ``kind`` is a word for its message, such as
    "action ".
    """
    given: dict[str, Value] = {}
    for name, value in designator.description:
        key = slot_name(name)
        if key in given:
            raise DesignatorError(f"slot {key} is given twice", type=designator.type, slot=key, value=unwrap(value))
        if value is not None:
            given[key] = unwrap(value)
    wanted = given.pop("type", None)
    if not isinstance(wanted, str) or wanted not in types:
        unknown = f"has the unknown type {wanted!r}{did_you_mean(wanted, types)}"
        problem = f"the {kind}designator {'has no slot type' if wanted is None else unknown}"
        raise DesignatorError(
            problem, type=str(wanted or ""), slot="type", value=wanted, takes=f"types: {', '.join(types)}"
        )
    return types[wanted], given


def arm_names() -> tuple[str, ...]:
    """Return the names of the current robot's arms; "left" and "right" if its arms are unknown."""
    return tuple(_arms()) or ("left", "right")


def default_arm() -> str:
    """Return the default arm: the only arm, or "left" as in the thesis; raise BadArgument if there is none."""
    arms = arm_names()
    return "left" if len(arms) > 1 and "left" in arms else only_arm()


def only_arm() -> str:
    """Return the only arm of a robot; raise BadArgument for a robot with several arms."""
    arms = arm_names()
    if len(arms) != 1:
        raise BadArgument("arm", None, f"one of {', '.join(arms)}, because the robot has several arms")
    return arms[0]


def _arms() -> Mapping[str, Arm]:
    world = BulletWorld.current_bullet_world
    robot = world.robot if world is not None else None
    return robot.description.arms if robot is not None and robot.description is not None else {}


def _body(name: str, value: Value) -> Value:
    world = BulletWorld.current_bullet_world
    if not isinstance(value, Object):
        raise BadArgument(name, value, "an Object of a world")
    if world is not None and value.world is not world:
        raise BadArgument(name, value, f"an Object of the current world {world.name}, not of {value.world.name}")
    return value


def _position(name: str, value: Value) -> Value:
    if isinstance(value, Object):
        raise BadArgument(name, value, _AT_AN_OBJECT)
    return list(checks.vector(name, value))


def _point(name: str, value: Value) -> Value:
    return list(center(_body(name, value)) if isinstance(value, Object) else checks.vector(name, value))


def _posture(name: str, value: Value) -> Value:
    described = _arms().get(name.removesuffix("-arm"))
    if isinstance(value, str):
        if described is not None and checks.text(name, value) not in described.poses:
            raise BadArgument(name, value, f"one of {', '.join(described.poses)}, or a list of joint values")
        return value
    if isinstance(value, Mapping) or not isinstance(value, Iterable | np.ndarray):
        raise BadArgument(name, value, '"park", or a list with a value for each joint of the arm')
    values = [checks.number(name, item) for item in value]
    if described is not None and len(values) != len(described.joints):
        raise BadArgument(name, value, f"{len(described.joints)} joint values, for {', '.join(described.joints)}")
    return values


_AT_AN_OBJECT: Final = (
    "[x, y, z] in m, or a place at the object: LocationDesignator(reachable_for=...) for the robot, "
    "LocationDesignator(on=...) for another object"
)
POSITION: Final = ValueKind("[x, y, z] in m, world frame", _position, "Sequence[float]", "LocationDesignator")
POINT: Final = ValueKind(
    "[x, y, z] in m, world frame, or an Object: the middle of its bounds now",
    _point,
    "Sequence[float] | Object",
    "LocationDesignator | ObjectDesignator",
)
ORIENTATION: Final = ValueKind(
    "A quaternion [x, y, z, w], world frame",
    lambda name, value: list(checks.quaternion(name, value)),
    "Sequence[float]",
)
NAME: Final = ValueKind("A name", checks.text, "str")
BODY: Final = ValueKind("An Object of a world", _body, "Object", "ObjectDesignator")
OBJECT_TYPE: Final = ValueKind(
    "A type of objects, or an object of that type",
    lambda name, value: checks.text(name, getattr(value, "type", value)),
    "str | Object",
    "ObjectDesignator",
)
ARM: Final = ValueKind(
    'The name of an arm: "left" or "right" on the PR2',
    lambda name, value: checks.one_of(name, checks.text(name, value), arm_names()),
    "str",
)
GRASP: Final = ValueKind(
    'The side from which the gripper approaches: "front", "top", "left" or "right"',
    lambda name, value: checks.one_of(name, value, GRASPS),
    "GraspSide",
)
DISTANCE: Final = ValueKind(
    "A distance in m, or the angle of a door in rad; 0 or more",
    lambda name, value: checks.in_range(name, value, 0.0),
    "float",
)
SWITCH: Final = ValueKind("True or False", checks.switch, "bool")
POSTURE: Final = ValueKind(
    'A named posture such as "park", or a list of joint values in rad', _posture, "str | Sequence[float]"
)
