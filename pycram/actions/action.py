"""Actions: plain functions of the plan language that reach goals of a robot (CRAM).

``@action("fetching")`` makes a function perform the actions of this type, instead of an earlier function. The
function's signature and docstring define slots, defaults and units. The *choices* of an action yield values for the
open slots on demand, the best first.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import wraps
from typing import Any, Final, ParamSpec, Protocol, TypeAlias, TypeVar, cast

from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import candidates_of, thing
from pycram.foundation import checks, plugins
from pycram.foundation.errors import qualified_name
from pycram.foundation.failures import BadArgument
from pycram.motions.designator import Designator, ResolvedDesignator, Resolver, Solution
from pycram.motions.slots import (
    ARM,
    GRASP,
    ORIENTATION,
    POINT,
    POSITION,
    Check,
    DesignatorError,
    Slot,
    SlotTable,
    ValueKind,
    filled,
    given_slots,
    slot_name,
)
from pycram.world.object import Object
from recorder.errors import did_you_mean

P = ParamSpec("P")
Result_co = TypeVar("Result_co", covariant=True)
#: A function that yields values for the open slots of an action, given the action's slots.
Choices: TypeAlias = "Callable[..., Iterable[Mapping[str, Any]]]"


def _anything(name: str, value: Any) -> Any:  # noqa: ARG001  a check
    if isinstance(value, Designator):
        value.check()
    return value


def _is_surface(value: Any) -> bool:
    return isinstance(value, str | Object) or hasattr(value, "outline")


def _place(name: str, value: Any) -> Any:
    if _is_surface(value):
        value = LocationDesignator(on=value)
    if not isinstance(value, LocationDesignator):
        try:
            return POSITION(name, value)
        except BadArgument as error:
            known = f"{error.expected}, the name of a surface, or a LocationDesignator"
            raise BadArgument(name, value, known) from error
    value.check()
    return value


def _place_for_an_object(name: str, value: Any) -> Any:
    wanted = _place(name, value)
    if isinstance(wanted, LocationDesignator) and not (wanted.for_objects or wanted.prop_value("position")):
        known = "a place for an object: a position, or a designator with the slot on, in or position"
        raise BadArgument(name, value, known)
    return wanted


def _place_for_the_robot(name: str, value: Any) -> Any:
    wanted = LocationDesignator(on=value) if _is_surface(value) else _place(name, value)
    if isinstance(wanted, LocationDesignator) and wanted.for_objects:
        known = "a place where the robot can stand, such as LocationDesignator(near=...) or (reachable_for=...)"
        raise BadArgument(name, value, f"{known}; the given place is for an object")
    return wanted


def _portable(name: str, value: Any) -> Any:
    wanted = thing(name, value)
    if all(body.fixed for body in candidates_of(wanted)):
        raise BadArgument(name, value, "an object that a gripper can take, so no robot and no environment")
    return wanted


def _location(name: str, value: Any) -> Any:
    if not isinstance(value, LocationDesignator):
        raise BadArgument(name, value, "a LocationDesignator")
    value.check()
    return value


_ANYTHING: Final = ValueKind("Any value that the action accepts", _anything)
_LOCATION: Final = ValueKind("A LocationDesignator", _location, "LocationDesignator")
_FLAG: Final = ValueKind("True or False", checks.switch, "bool")
_BUDGET: Final = ValueKind("A whole number, 0 or more", checks.count, "int")
_THING: Final = "Object | ObjectDesignator | str"
_PLACE: Final = "LocationDesignator | Surface | Object | str | Sequence[float]"

portable: Final = ValueKind("An object that a gripper can take", _portable, _THING)
place_for_an_object: Final = ValueKind("A place where the robot can put the object", _place_for_an_object, _PLACE)
place_for_the_robot: Final = ValueKind(
    "A place where the robot can stand", _place_for_the_robot, "LocationDesignator | Sequence[float]"
)

looked_at: Final = ValueKind(
    "An Object, a LocationDesignator, a surface, or [x, y, z] in m, world frame",
    lambda name, value: POINT(name, value) if isinstance(value, Object) else _place(name, value),
    _PLACE,
)

_BY_SLOT: Final[Mapping[str, Check]] = {
    "object": ValueKind("An Object of a world, an ObjectDesignator, or a type of objects", thing, _THING),
    "target": ValueKind("A LocationDesignator, a surface, an Object, or [x, y, z] in m, world frame", _place, _PLACE),
    "place": _LOCATION,
    "put": _LOCATION,
    "clear": _FLAG,
    "close": _FLAG,
    "orientation": ORIENTATION,
    "arm": ARM,
    "grasp": GRASP,
}
_SPENT: Final = "number of tries that may fail, also in subactions; by default 20, or the rest of the outer budget"
_COMMON: Final = (
    Slot("budget", _BUDGET, text=_SPENT),
    Slot("projected", _FLAG, text="whether to try the best choices in projections first; False by default"),
)


@dataclass(frozen=True, kw_only=True)
class ActionType(SlotTable):
    """A type of actions."""

    function: Callable[..., Any]  # performs the action with values for all slots
    choices: Choices | None = None  # yields values of open slots; None if an action has no choices
    prepare: Callable[..., Any] | None = None  # called before ``choices``
    text: str = ""  # the first lines of the function's docstring

    @property
    def recorded_as(self) -> str:
        """Name of the function in records; names of PyCRAM's actions don't depend on their files."""
        if self.function.__module__.startswith(f"{__package__}."):
            return f"{__package__}.{self.function.__name__}.{self.function.__name__}"
        return qualified_name(self.function)

    def call(self, slots: Mapping[str, Any]) -> Any:
        """Perform the action with values for all slots, and return the result."""
        return self.function(**arguments(self.function, slots))


def arguments(function: Callable[..., Any], slots: Mapping[str, Any]) -> dict[str, Any]:
    """Return the slots that are parameters of a function, as keyword arguments."""
    names = {slot_name(name): name for name in inspect.signature(function).parameters}
    return {names[slot]: value for slot, value in slots.items() if slot in names}


class Action(Protocol[P, Result_co]):
    """A function that performs the actions of a type."""

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> Result_co:
        """Perform the action with values for all slots."""

    @staticmethod
    def designator(*args: P.args, **kwargs: P.kwargs) -> ActionDesignator:
        """Return a designator whose slots are the arguments of the function; None leaves a slot open."""


TYPES: Final[dict[str, ActionType]] = {}


def action(
    name: str,
    *,
    choices: Choices | None = None,
    prepare: Callable[..., Any] | None = None,
    checked: Mapping[str, Check] | None = None,
    one_of: Sequence[str] = (),
) -> Callable[[Callable[P, Result_co]], Action[P, Result_co]]:
    """Decorate a function that performs the actions of a type, instead of an earlier function.

    The function gets an attribute ``designator``: a function with the same parameters that returns a designator of the
    action, as in ``perform(tidying_up.designator(object=milk))``.

    Args:
        name: Type of the actions, such as "fetching".
        choices: A generator function that yields values of slots by name, the best first; the action tries them in
            order. The generator's parameters are names of slots; other slots keep the values that the plan gave.
        prepare: A function that is called before ``choices``, for example to search for an object; its parameters are
            names of slots. In a generator function, the code after the only ``yield`` runs after the action.
        checked: Checks of slots by name; PyCRAM knows the slots of its own actions.
        one_of: Slots of which exactly one is required.

    Raises:
        BadArgument: The name is invalid, or the function has positional-only or variable parameters.
    """
    checks.text("name", name)

    def register(function: Callable[P, Result_co]) -> Action[P, Result_co]:
        TYPES[name] = ActionType(
            name,
            (*_slots(function, checked or {}), *_COMMON),
            tuple(one_of),
            only_one=bool(one_of),
            function=function,
            choices=choices,
            prepare=prepare,
            text=(inspect.getdoc(function) or "").partition("\n\nArgs:")[0],
        )

        def designator(*args: P.args, **kwargs: P.kwargs) -> ActionDesignator:
            given = inspect.signature(function).bind_partial(*args).arguments
            return ActionDesignator(filled(name, **given, **kwargs))  # perform() checks the slots later

        with suppress(AttributeError):  # python forbids further attributes of bound methods
            cast("Any", function).designator = wraps(function)(designator)
        return cast("Action[P, Result_co]", function)

    return register


@contextmanager
def replaced(
    name: str, function: Callable[..., Any], *, choices: Choices | None = None
) -> Iterator[Callable[..., Any]]:
    """Let a function perform the actions of a type in the ``with`` block; raise BadArgument if it lacks slots."""
    before = TYPES.get(name)
    taken = {slot_name(parameter) for parameter in inspect.signature(function).parameters}
    lacks = [slot.name for slot in (before.slots if before else ()) if slot not in _COMMON and slot.name not in taken]
    if lacks:
        known = f"a function that takes all slots of {name}; it lacks {', '.join(lacks)}"
        raise BadArgument("function", qualified_name(function), known)
    action(name, choices=choices)(function)
    try:
        yield function
    finally:
        if before is None:
            del TYPES[name]
        else:
            TYPES[name] = before


def _slots(function: Callable[..., Any], checked: Mapping[str, Check]) -> Iterator[Slot]:
    texts = _texts(function)
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind not in (parameter.KEYWORD_ONLY, parameter.POSITIONAL_OR_KEYWORD):
            raise BadArgument("function", qualified_name(function), "a function that takes keyword arguments")
        slot = slot_name(parameter.name)
        check = checked.get(slot) or _BY_SLOT.get(slot, _ANYTHING)
        required = parameter.default is parameter.empty
        yield Slot(slot, check, required=required, text=texts.get(parameter.name, ""))


def _texts(function: Callable[..., Any]) -> dict[str, str]:
    """Return the texts about a function's parameters in its docstring."""
    _, _, section = (inspect.getdoc(function) or "").partition("Args:\n")
    found: dict[str, str] = {}
    name = ""
    for line in section.splitlines():
        if not line.startswith(" "):
            break
        if match := re.match(r"\s*(\w+): (.*)$", line):
            name = match[1]
            found[name] = match[2]
        elif name:
            found[name] += " " + line.strip()
    return {each: text.rstrip(".") for each, text in found.items()}


class ActionDesignator(ResolvedDesignator):
    """An action, such as ``ActionDesignator(type="transporting", object=..., target=...)`` (thesis 3.5.1).

    ``help(pycram.action_designators)`` lists PyCRAM's types of actions and their slots.

    A solution has the given slots, and values for the open slots; the best solution comes first. The action itself
    resolves designators in its slots, because the action may have to search for an object first. If a plan adds a
    resolver, the resolver's solutions name the type of the action in ``action``.
    """

    performed_by = "pycram.actions.perform"

    @staticmethod
    def _own_resolver() -> Resolver:
        return resolve

    def check(self) -> None:
        """Check the slots as far as possible without a search."""
        _checked(self)


def _checked(designator: ActionDesignator) -> tuple[ActionType, dict[str, Any]]:
    if isinstance(designator.type, str) and designator.type not in TYPES:
        plugins.load(plugins.ACTIONS, designator.type)
    kind, given = given_slots(designator, TYPES, "action ")
    return kind, kind.checked(given)


def prepared(designator: ActionDesignator) -> AbstractContextManager[None]:
    """Call an action's ``prepare``; the rest of a generator function runs after the ``with`` block."""
    try:
        kind, given = _checked(designator)
    except DesignatorError:  # a resolver of the plan may know slots that the action doesn't know
        return nullcontext()
    if kind.prepare is None:
        return nullcontext()
    values = arguments(kind.prepare, given)
    if inspect.isgeneratorfunction(kind.prepare):
        return contextmanager(kind.prepare)(**values)
    kind.prepare(**values)
    return nullcontext()


def resolve(designator: ActionDesignator) -> Iterator[Solution]:
    """Yield the solutions of an action designator, one for each choice."""
    kind, given = _checked(designator)
    whole = {slot: value for slot, value in given.items() if slot not in ("budget", "projected")}
    for choice in _open_choices(kind, whole):
        yield {"action": kind.type, **whole, **choice}


def _open_choices(kind: ActionType, given: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the choices of an action, without values for given slots that aren't parameters of ``choices``."""
    if kind.choices is None:
        yield {}
        return
    known = {slot_name(name) for name in inspect.signature(kind.choices).parameters}
    nothing_left = False
    for choice in kind.choices(**arguments(kind.choices, given)):
        left = {slot: value for slot, value in choice.items() if slot in known or slot not in given}
        if left or not choice or not nothing_left:  # choices that only repeat given slots don't differ
            yield left
        nothing_left |= bool(choice) and not left


def type_of(solution: Solution) -> ActionType:
    """Return the type of a solution's action; raise DesignatorError for an unknown type or an unknown slot."""
    name = solution.get("action")
    if not isinstance(name, str) or name not in TYPES:
        problem = f"the solution has the unknown action {name!r}{did_you_mean(name, TYPES)}"
        raise DesignatorError(problem, slot="action", value=name, takes=f"actions: {', '.join(sorted(TYPES))}")
    kind = TYPES[name]
    names = [slot.name for slot in kind.slots]
    for slot, value in solution.items():
        if slot != "action" and slot not in names:
            raise kind.error(f"a choice has the unknown slot {slot}{did_you_mean(slot, names)}", slot, value)
    return kind
