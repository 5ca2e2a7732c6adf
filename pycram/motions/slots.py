"""Slots of designators: (name, value) pairs that don't change once a designator is made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

import numpy as np

from pycram.foundation.failures import BadArgument, UsageError
from pycram.foundation.names import export
from pycram.scheduling.future import unwrap
from recorder.errors import did_you_mean

if TYPE_CHECKING:
    from pycram.motions.slot_checks import Check

#: Slots as plans write them; also constraints and properties.
Description: TypeAlias = Iterable[tuple[str, object]] | Mapping[str, object]
#: Whatever the plan put into a slot, or made a designator stand for.
Value: TypeAlias = Any
T = TypeVar("T")
Type = TypeVar("Type", bound="Slotted")


class DesignatorError(UsageError):
    """A designator that can't be resolved: a slot is missing, unknown or wrong.

    Attributes:
        type: The designator's type, "" if it has none.
        slot: Name of the slot, "" for none.
        value: Its value.
        takes: Description of the slots of that type.
    """

    def __init__(self, problem: str, *, type: str = "", slot: str = "", value: object = None, takes: str = "") -> None:  # noqa: A002  the slot's name
        super().__init__(f"{problem}\n{takes}" if takes else problem)
        self.type = type
        self.slot = slot
        self.value = value
        self.takes = takes


export("pycram.designator", DesignatorError)


def pairs(description: Description) -> tuple[tuple[str, Value], ...]:
    """Return a description's slots, with copies of its containers.

    Raises:
        DesignatorError: It isn't a list of pairs.
    """
    try:
        if isinstance(description, str):
            raise TypeError  # noqa: TRY301  pairs of letters, by chance
        items = tuple(description.items() if isinstance(description, Mapping) else map(tuple, description))
        slots = tuple((name, own(value)) for name, value in items)
    except (TypeError, ValueError):
        slots = None
    if slots is None or not all(isinstance(name, str) for name, _ in slots):
        raise DesignatorError(
            "a designator is described by a list of (name, value) pairs, such as "
            f"[('type', 'looking'), ('target', [1, 0, 1])]; not by {description!r}",
            value=description,
        )
    return slots


def slot_name(argument: str) -> str:
    """Return the slot that a keyword argument names: ``reachable_for`` is ``reachable-for``, ``in_`` is ``in``."""
    return argument.rstrip("_").replace("_", "-")


def own(value: T) -> T:
    """Return a value with copies of its lists, dictionaries, sets and arrays; other objects in it stay the same."""
    copied: T = _own(value, {})
    return copied


def _own(value: Value, known: dict[int, Value]) -> Value:
    if id(value) in known:  # a container that holds itself
        return known[id(value)]
    if type(value) is list:
        items: list[Value] = []
        known[id(value)] = items
        items.extend(_own(item, known) for item in value)
        return items
    if type(value) is dict:
        table: dict[Value, Value] = {}
        known[id(value)] = table
        table.update((key, _own(item, known)) for key, item in value.items())
        return table
    if type(value) is tuple:
        return tuple(_own(item, known) for item in value)
    return value.copy() if type(value) in (set, np.ndarray) else value


def same(left: Value, right: Value) -> bool:
    """Whether two values are equal, arrays too."""
    arrays = isinstance(left, np.ndarray) or isinstance(right, np.ndarray)
    return bool(np.array_equal(left, right) if arrays else left == right)


class Described(Protocol):
    """A designator, as this module uses it."""

    @property
    def type(self) -> str:
        """Its slot ``type``; empty if that isn't a string."""

    @property
    def description(self) -> Iterable[tuple[str, Value]]:
        """Its slots."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot of a motion type.

    Attributes:
        check: Check of its value.
        default: Infers a missing value from the given ones, and says in its docstring which; None leaves it out of the
            solution.
        otherwise: What is done then.
        aliases: Other names for it.
        text: What it is; that of the check by default.
    """

    name: str
    check: Check
    required: bool = False
    default: Callable[[dict[str, Value]], Value] | None = None
    aliases: tuple[str, ...] = ()
    text: str = ""
    otherwise: str = ""

    def describe(self) -> str:
        """Describe it, for messages."""
        names = " or ".join((self.name, *self.aliases))
        need = "required" if self.required else "optional"
        return f"{names} ({need}): {self.values}"

    @property
    def values(self) -> str:
        """What it may hold, with units and frames."""
        return self.text or (self.check.__doc__ or "").strip().rstrip(".")

    @property
    def missing(self) -> str:
        """What is meant where it is left out; empty if that isn't said."""
        return self.otherwise or ((self.default and self.default.__doc__) or "").strip().rstrip(".")


class Slotted(Protocol):
    """A type of designators, with its slots; see :class:`MotionType`."""

    @property
    def type(self) -> str:
        """Its name."""

    @property
    def slots(self) -> tuple[Slot, ...]:
        """Its slots beside ``type``."""

    @property
    def one_of(self) -> tuple[str, ...]:
        """Slots of which at least one is required."""

    @property
    def only_one(self) -> bool:
        """Whether exactly one is."""

    def describe(self) -> str:
        """Describe its slots, for messages."""


def given_slots(designator: Described, types: Mapping[str, Type], kind: str = "") -> tuple[Type, dict[str, Value]]:
    """Return a designator's type, and its other slots with values other than None, waiting for futures.

    Args:
        designator: The designator.
        types: The types that there are, by name.
        kind: Of what, for messages.

    Raises:
        DesignatorError: Its type is none of these, or a slot is given twice.
    """
    given: dict[str, Value] = {}
    for key, value in designator.description:
        if key in given:
            raise DesignatorError(f"slot {key} is given twice", type=designator.type, slot=key, value=unwrap(value))
        if value is not None:
            given[key] = unwrap(value)
    name = given.pop("type", None)
    if not isinstance(name, str) or name not in types:
        unknown = f"has the unknown type {name!r}{did_you_mean(name, types)}"
        problem = f"the {kind}designator {'has no slot type' if name is None else unknown}"
        raise DesignatorError(
            problem, type=str(name or ""), slot="type", value=name, takes=f"types: {', '.join(types)}"
        )
    return types[name], given


def described(kind: Slotted, name: str = "") -> str:
    """Return a description of a type's slots, for messages; of designators with a type of their own by their name."""
    lines = [f"{name} takes"] if name else [f"a {kind.type} designator takes", f"  type (required): {kind.type!r}"]
    lines += [f"  {slot.describe()}" for slot in kind.slots]
    if kind.one_of:
        how = "exactly one" if kind.only_one else "at least one"
        lines.append(f"  {how} of {', '.join(kind.one_of)} has to be there")
    return "\n".join(lines)


def checked_slots(motion: Slotted, given: Mapping[str, Value]) -> dict[str, Value]:
    """Return the checked values of slots, by the slots' names.

    Raises:
        DesignatorError: A slot is missing, unknown or wrong.
    """
    names = {name: slot for slot in motion.slots for name in (slot.name, *slot.aliases)}
    takes = motion.describe()
    checked: dict[str, Value] = {}
    for key, value in given.items():
        slot = names.get(key)
        if slot is None:
            problem = f"unknown slot {key}{did_you_mean(key, names)}"
            raise DesignatorError(problem, type=motion.type, slot=key, value=value, takes=takes)
        if slot.name in checked:
            problem = f"slot {slot.name} is given twice"
            raise DesignatorError(problem, type=motion.type, slot=key, value=value, takes=takes)
        try:
            checked[slot.name] = slot.check(key, value)
        except BadArgument as error:
            problem = f"wrong value in slot {error}"
            raise DesignatorError(problem, type=motion.type, slot=key, value=value, takes=takes) from error
    missing = [slot.name for slot in motion.slots if slot.required and slot.name not in checked]
    if missing:
        raise DesignatorError(f"missing slot {', '.join(missing)}", type=motion.type, slot=missing[0], takes=takes)
    present = [name for name in motion.one_of if name in checked]
    if motion.one_of and (not present or (motion.only_one and len(present) > 1)):
        problem = (
            f"slots {' and '.join(present)} exclude each other"
            if present
            else f"missing slot {' or '.join(motion.one_of)}"
        )
        raise DesignatorError(problem, type=motion.type, slot=motion.one_of[0], takes=takes)
    return checked
