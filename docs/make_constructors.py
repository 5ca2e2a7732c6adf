"""Write the typed constructors of motion and action designators: ``python -m docs.make_constructors pycram``.

The parameters, types and texts come from the slots that check designators, so type checkers reject unknown slots.
"""

from __future__ import annotations

import inspect
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Final

from docs.make_reference import demands
from pycram.actions.action import TYPES as ACTIONS
from pycram.motions.modules import default_modules
from pycram.motions.motion_types import TYPES as MOTIONS
from pycram.motions.slots import ValueKind, slot_argument

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pycram.motions.motion_types import MotionType
    from pycram.motions.slots import Slot, SlotTable

    Parameter = tuple[str, str, str, bool]  # name, type, text, and whether the parameter is required

_WIDTH: Final = 120

_MOTIONS: Final = '''\
"""Typed constructors of motion designators: ``perform(pick_up(object=milk, arm="left"))``.

Written by ``make reference`` from the slots of the motions; don't edit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

from pycram.motions.designator import MotionDesignator
from pycram.motions.slots import filled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pycram.actions import LocationDesignator, ObjectDesignator
    from pycram.reasoning.grasping.grasps import GraspSide
    from pycram.world.object import Object
'''
_ACTIONS: Final = '''\
"""Typed constructors of action designators: ``perform(transporting(object=milk, target="island"))``.

Written by ``make reference`` from the slots of the actions; don't edit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

from pycram.actions.action import ActionDesignator
from pycram.motions.slots import filled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.actions import LocationDesignator, ObjectDesignator
    from pycram.models.surfaces import Container, Surface
    from pycram.reasoning.grasping.grasps import GraspSide
    from pycram.world.object import Object
'''


def motion_designators() -> str:
    """Return the source of ``pycram.motion_designators``."""
    modules = default_modules()
    parts = [_MOTIONS]
    for motion in MOTIONS.values():
        text = (inspect.getdoc(modules[motion.cmd]) or "").partition("\n")[0]
        if motion.per_arm:
            parts.append(_arms(motion, text))
        else:
            parts.append(_designator("MotionDesignator", motion, text, _parameters(motion.slots, motion=True)))
    return "\n\n".join(parts)


def action_designators() -> str:
    """Return the source of ``pycram.action_designators``."""
    parts = [_ACTIONS]
    for _, action in sorted(ACTIONS.items()):
        if action.function.__module__.startswith("pycram.actions."):
            parts.append(_designator("ActionDesignator", action, action.text, _parameters(action.slots)))
    return "\n\n".join(parts)


def _designator(kind: str, table: SlotTable, text: str, parameters: Sequence[Parameter]) -> str:
    """Return the constructor of a type; slots that exclude each other have an overload each."""
    text = "\n\n".join([text, *(each.strip().replace("`", "``") for each in demands(table))])
    parts = []
    for name in table.one_of if table.only_one else ():
        given = [each if each[0] not in table.one_of else (each[0], "None", "", False) for each in parameters]
        (chosen,) = ((argument, python, "", True) for argument, python, *_ in parameters if argument == name)
        head = _head(kind, table.type, [chosen, *(each for each in given if each[0] != name)])
        parts.append("\n".join(["@overload", *head[:-1], f"{head[-1]} ...", ""]))
    return "\n\n".join([*parts, _function(kind, table.type, text, parameters)])


def _arms(motion: MotionType, text: str) -> str:
    """Return the constructor of a motion that has a slot for each arm of the robot."""
    (slot,) = motion.slots
    each = f"Mapping[str, {slot.python}]"
    parameters = [
        (
            "arms",
            each,
            f"For each name of an arm: {slot.values[0].lower()}{slot.values[1:]}. Other arms don't move",
            True,
        )
    ]
    given = f'**{{f"{slot.name.replace("NAME", "{arm}")}": value for arm, value in arms.items()}}'
    return _function("MotionDesignator", motion.type, text, parameters, given)


def _parameters(slots: Iterable[Slot], *, motion: bool = False) -> list[Parameter]:
    """Return the parameters for slots; required parameters come first."""
    found = []
    for slot in slots:
        python = slot.python
        if motion and isinstance(slot.check, ValueKind) and slot.check.designator:
            python += f" | {slot.check.designator}"
        otherwise = f"; by default {slot.otherwise[0].lower()}{slot.otherwise[1:]}" if slot.otherwise else ""
        text = f"{slot.values[0].upper()}{slot.values[1:]}{otherwise}"
        found.append((slot_argument(slot.name), python, text, slot.required))
    return sorted(found, key=lambda each: not each[3])


def _head(kind: str, name: str, parameters: Sequence[Parameter]) -> list[str]:
    """Return the lines of a constructor from ``def`` to the colon."""
    lines = [f"def {slot_argument(name)}(", "    *,"]
    for argument, python, _, required in parameters:
        optional = python if python == "None" else f"{python} | None"
        lines.append(f"    {argument}: {python}," if required else f"    {argument}: {optional} = None,")
    return [*lines, f") -> {kind}:"]


def _function(kind: str, name: str, text: str, parameters: Sequence[Parameter], given: str = "**locals()") -> str:
    first, _, more = text.partition("\n")
    lines = [*_head(kind, name, parameters), f'    """{first}']
    lines += [f"    {line}".rstrip() for line in more.splitlines()]
    lines += ["", "    Args:"]
    for argument, _, described, _ in parameters:
        line = f"{argument}: {' '.join(described.split())}."
        lines += textwrap.wrap(line, _WIDTH, initial_indent=" " * 8, subsequent_indent=" " * 12)
    call = f'    return {kind}(filled("{name}", {given}))'
    return "\n".join([*lines, '    """', call, ""])


MODULES: Final = {
    "motion_designators.py": motion_designators,
    "action_designators.py": action_designators,
}
"""Functions that return the sources of modules, by the modules' files in ``pycram``."""


def main(folder: str) -> None:
    """Write the modules into a folder."""
    for name, source in MODULES.items():
        Path(folder, name).write_text(source(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
