"""Actions: what a robot can be asked to do without saying how, as plain functions of the plan language (CRAM).

``@action("fetching")`` makes a function the action of that type; one that was registered before is replaced. Slots,
defaults and units are those of its signature and docstring. What it leaves open, its *choices* say: they yield values
for slots, the best first, each found when it is needed.
"""

from __future__ import annotations

import inspect
import re
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias, TypeVar

from pycram.actions import checks
from pycram.foundation.checks import text
from pycram.foundation.failures import BadArgument
from pycram.foundation.names import qualified_name
from pycram.motions.designator import ResolvedDesignator
from pycram.motions.motion_types import Slot, checked_slots, described, given_slots
from pycram.motions.slots import DesignatorError, slot_name
from recorder.suggestions import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from contextlib import AbstractContextManager

    from pycram.motions.designator import Resolver
    from pycram.motions.slot_checks import Check
    from pycram.motions.solutions import Solution

Function = TypeVar("Function", bound="Callable[..., Any]")
#: Called with an action's slots; yields values for those that are open, or others instead.
Choices: TypeAlias = "Callable[..., Iterable[Mapping[str, Any]]]"

_COMMON: Final = (
    Slot(
        "budget",
        checks.budget,
        text="how many tries may fail, with those of the actions that it is made of; 20 by default, or what is left of "
        "the budget around it",
    ),
    Slot("projected", checks.flag, text="whether the best choices are imagined first; False by default"),
)
_ARGUMENT: Final = re.compile(r"^\s*(\w+): (.*)$")


@dataclass(frozen=True, slots=True)
class ActionType:
    """A type of actions.

    Attributes:
        type: Its name.
        function: What does it, with everything chosen.
        slots: Its slots beside ``type``.
        choices: What finds the open ones; None if there is nothing to choose.
        prepare: What is done before they are found; None for nothing.
        text: What it does, the first lines of the function's docstring.
    """

    type: str
    function: Callable[..., Any]
    slots: tuple[Slot, ...]
    choices: Choices | None = None
    prepare: Callable[..., Any] | None = None
    text: str = ""
    one_of: ClassVar[tuple[str, ...]] = ()
    only_one: ClassVar[bool] = False

    def describe(self) -> str:
        """Describe its slots, for messages."""
        return described(self)

    def call(self, slots: Mapping[str, Any]) -> Any:
        """Do it, with everything chosen, and return the function's result."""
        return self.function(**arguments(self.function, slots))


def arguments(function: Callable[..., Any], slots: Mapping[str, Any]) -> dict[str, Any]:
    """Return slots as the keyword arguments of a function that has them as its parameters; others are left out."""
    names = {slot_name(name): name for name in inspect.signature(function).parameters}
    return {names[slot]: value for slot, value in slots.items() if slot in names}


TYPES: Final[dict[str, ActionType]] = {}


def action(
    name: str,
    *,
    choices: Choices | None = None,
    prepare: Callable[..., Any] | None = None,
    checked: Mapping[str, Check] | None = None,
) -> Callable[[Function], Function]:
    """Decorate a function that does the actions of a type, instead of what did them before.

    Args:
        name: The type, as "fetching".
        choices: A generator function that is called with the slots, as the function is, of which it takes those that it
            has as parameters. It yields values of slots by name, the best first; those that a try gets.
        prepare: What the robot does before choices are found, as looking for the object; called as these are. What a
            generator function does after its only ``yield`` comes when the action has been done, or has failed there.
        checked: Checks of slots that PyCRAM's own actions don't have, by name.

    Raises:
        BadArgument: The name is none, or the function has parameters that slots can't be.
    """
    text("name", name)

    def register(function: Function) -> Function:
        TYPES[name] = _type(name, function, choices, prepare, checked or {})
        return function

    return register


@contextmanager
def replaced(
    name: str, function: Callable[..., Any], *, choices: Choices | None = None
) -> Iterator[Callable[..., Any]]:
    """Have a function do the actions of a type in the ``with`` block.

    Raises:
        BadArgument: The function doesn't take all slots of the action that it replaces, which others may give it.
    """
    before = TYPES.get(name)
    taken = {slot_name(parameter) for parameter in inspect.signature(function).parameters}
    lacks = [slot.name for slot in (before.slots if before else ()) if slot not in _COMMON and slot.name not in taken]
    if lacks:
        known = f"a function that takes the slots of {name}, also {', '.join(lacks)}"
        raise BadArgument("function", qualified_name(function), known)
    action(name, choices=choices)(function)
    try:
        yield function
    finally:
        if before is None:
            del TYPES[name]
        else:
            TYPES[name] = before


def _type(
    name: str,
    function: Callable[..., Any],
    choices: Choices | None,
    prepare: Callable[..., Any] | None,
    checked: Mapping[str, Check],
) -> ActionType:
    texts = _texts(function)
    slots = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind not in (parameter.KEYWORD_ONLY, parameter.POSITIONAL_OR_KEYWORD):
            raise BadArgument("function", qualified_name(function), "a function whose parameters have names")
        slot = slot_name(parameter.name)
        required = parameter.default is parameter.empty
        check = checked.get(slot) or checks.BY_SLOT.get(slot, checks.anything)
        slots.append(Slot(slot, check, required=required, text=texts.get(parameter.name, "")))
    doc = inspect.getdoc(function) or ""
    return ActionType(name, function, (*slots, *_COMMON), choices, prepare, doc.partition("\n\nArgs:")[0])


def _texts(function: Callable[..., Any]) -> dict[str, str]:
    """Return what a function's docstring says of its parameters."""
    _, _, section = (inspect.getdoc(function) or "").partition("Args:\n")
    found: dict[str, str] = {}
    name = ""
    for line in section.splitlines():
        if not line.startswith(" "):
            break
        if match := _ARGUMENT.match(line):
            name = match[1]
            found[name] = match[2]
        elif name:
            found[name] += " " + line.strip()
    return {each: text.rstrip(".") for each, text in found.items()}


class ActionDesignator(ResolvedDesignator):
    """Something to be done, as ``ActionDesignator(type="transporting", object=..., target=...)`` (thesis 3.5.1).

    Its solutions are its slots with all that is open chosen, the best choice first. The designators among its slots are
    not resolved by it but by the action, which may have to look for an object first. A resolver's solutions have the
    type of what is done in ``action``.
    """

    performed_by = "pycram.actions.perform"

    @staticmethod
    def _own_resolver() -> Resolver:
        return resolve

    def check(self) -> None:
        """Check its slots as far as that needs no search."""
        checked_type(self)


def checked_type(designator: ActionDesignator) -> tuple[ActionType, dict[str, Any]]:
    """Return a designator's type and its checked slots.

    Raises:
        DesignatorError: Its type is unknown, or a slot is missing, unknown or wrong.
    """
    kind, given = given_slots(designator, TYPES, "action ")
    return kind, checked_slots(kind, given)


def prepared(designator: ActionDesignator) -> AbstractContextManager[None]:
    """Do what is done before the choices of an action are found; after the ``with`` block, what is done in the end."""
    try:
        kind, slots = checked_type(designator)
    except DesignatorError:  # only a resolver of the plan's own may know it
        return nullcontext()
    if kind.prepare is None:
        return nullcontext()
    if inspect.isgeneratorfunction(kind.prepare):
        return contextmanager(kind.prepare)(**arguments(kind.prepare, slots))
    kind.prepare(**arguments(kind.prepare, slots))
    return nullcontext()


def resolve(designator: ActionDesignator) -> Iterator[Solution]:
    """Yield the solutions of an action designator: one for each choice."""
    kind, slots = checked_type(designator)
    whole = {slot: value for slot, value in slots.items() if slot not in ("budget", "projected")}
    if kind.choices is None:
        yield {"action": kind.type, **whole}
        return
    for choice in kind.choices(**arguments(kind.choices, whole)):
        yield {"action": kind.type, **whole, **choice}


def type_of(solution: Solution) -> ActionType:
    """Return the type that a solution is to be done by.

    Raises:
        DesignatorError: There is none, or it has no such slots.
    """
    name = solution.get("action")
    if not isinstance(name, str) or name not in TYPES:
        problem = f"the solution has the unknown action {name!r}{did_you_mean(name, TYPES)}"
        raise DesignatorError(problem, slot="action", value=name, takes=f"actions: {', '.join(TYPES)}")
    kind = TYPES[name]
    names = [slot.name for slot in kind.slots]
    for slot, value in solution.items():
        if slot != "action" and slot not in names:
            problem = f"a choice has the unknown slot {slot}{did_you_mean(slot, names)}"
            raise DesignatorError(problem, type=name, slot=slot, value=value, takes=kind.describe())
    return kind
