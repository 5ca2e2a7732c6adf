"""Write docs/reference/designators.md, the reference of motions and actions: ``python -m docs.make_reference``.

The page contains the data by which designators are checked, and docstrings, so it is always correct.
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pycram
from pycram.actions import ActionFailed, LocationDesignator, ObjectDesignator
from pycram.actions.action import TYPES as ACTIONS
from pycram.foundation.failures import NoPlace, PlanFailure
from pycram.motions.modules import default_modules
from pycram.motions.motion_types import TYPES as MOTIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from pycram.motions.motion_types import MotionType
    from pycram.motions.process_module import ProcessModule
    from pycram.motions.slots import Slot, SlotTable

_HEAD: Final = """\
# Reference: motions and actions

This page lists all motions and actions, with their slots, values, units, defaults and failures. `make reference` writes
the page from the code that checks and executes designators. Lengths are in m, angles in rad, poses in the world frame;
quaternions are [x, y, z, w]. You may leave out an optional slot, or set it to None.
"""
_ACTIONS: Final = """\
`perform(transporting(object=milk, target="island"))` executes an action. The action chooses values for empty
slots. If one choice fails, the action tries the next choice. `pycram.action_designators` has a typed constructor for
each action; the constructor returns `ActionDesignator(type=..., ...)`. In keyword arguments, write `_` instead of the
`-` in a slot's name, as in `reachable_for=`. Append `_` to a name that is a Python keyword, as in `in_=`. If PyCRAM
finds no object or no place (`NoPlace`), the action fails before anything moves. Every action also has these slots:
"""
_MOTIONS: Final = """\
`perform(moving(target=[1, 0, 0]))` executes a motion. `pycram.motion_designators` has a typed constructor for each
motion; the constructor returns `MotionDesignator(type=..., ...)`. The value of a slot may also be a designator of an
object or a place. In the environment `continuous`, motions take simulated time, and can fail in more ways.
"""
_ARMS: Final = "For each arm of the robot, `NAME-arm` is a slot with the arm's name, such as `left-arm`."


def reference() -> str:
    """Return the page, as Markdown."""
    types = [each for _, each in sorted(ACTIONS.items())]
    common = [slot for slot in types[0].slots if all(slot in each.slots for each in types)]
    modules = default_modules()
    failures: set[type[PlanFailure]] = {ActionFailed, NoPlace}
    parts = [_HEAD, "## Actions\n", _ACTIONS, _table(common)]
    for each in types:
        fails = (
            "The action tries several arms, grasps or places. If none of them succeeds, it fails with `ActionFailed`."
            if each.choices
            else "If a motion or action within this action fails, this action fails with the same failure."
        )
        slots = _table(slot for slot in each.slots if slot not in common)
        parts += [f"### {each.type}\n", f"{each.text}\n", slots, *demands(each), f"{fails}\n"]
    parts += ["## Objects and places\n"]
    for kind in (ObjectDesignator, LocationDesignator):
        text = inspect.getdoc(kind) or ""
        parts += [f"### {kind.__name__}\n", f"{text}\n", _table(kind.takes.slots), *demands(kind.takes)]
    parts += ["## Motions\n", _MOTIONS]
    for motion in MOTIONS.values():
        module = modules[motion.cmd]
        failures |= {*module.failures, *module.failures_in_time}
        parts.append(_motion(motion, module))
    # Failures are recorded under their public module, which isn't the file that defines them.
    source = "".join(file.read_text(encoding="utf-8") for file in Path(pycram.__file__).parent.rglob("*.py"))
    parts += ["## Failures\n", *(_failure(kind, source) for kind in sorted(failures, key=lambda kind: kind.__name__))]
    return "\n".join(parts).replace("``", "`")  # the docstrings are reStructuredText


def _motion(motion: MotionType, module: ProcessModule) -> str:
    parts = [f"### {motion.type}\n", f"{inspect.getdoc(module) or ''}\n", _table(motion.slots), *demands(motion)]
    if any("NAME" in slot.name for slot in motion.slots):
        parts.append(f"{_ARMS}\n")
    parts.append(f"The motion can fail with {_names(module.failures)}.")
    if module.failures_in_time:
        parts[-1] += f" In simulated time, the motion can also fail with {_names(module.failures_in_time)}."
    return "\n".join([*parts, ""])


def demands(kind: SlotTable) -> Iterator[str]:
    """Yield sentences about the slots of which a designator requires at least or exactly one."""
    if len(kind.one_of) > 1:
        names = " or ".join(f"`{name}`" for name in kind.one_of)
        yield f"{'Exactly' if kind.only_one else 'At least'} one of {names} is required.\n"


def _table(slots: Iterable[Slot]) -> str:
    rows = ["| Slot | Value | Default |", "|---|---|---|"]
    for slot in slots:
        names = " or ".join(f"`{name}`" for name in (slot.name, *slot.aliases))
        # the text about a slot's values already contains the default
        found = re.fullmatch(r"(.*); (?:by default (.*)|(.*) by default(.*))", slot.values, re.DOTALL)
        values, default = (found[1], found[2] or found[3] + found[4]) if found else (slot.values, "")
        missing = "required" if slot.required else slot.otherwise or default
        rows.append(f"| {names} | {_cell(values)} | {_cell(missing)} |")
    return "\n".join([*rows, ""])


def _cell(text: str) -> str:
    text = re.sub(r"\s+", " ", text).replace("|", "\\|")
    return text[:1].upper() + text[1:]


def _line(text: str) -> str:
    """Return a docstring's sentence as one line without its full stop."""
    line = re.sub(r"\s+", " ", text)
    return line if line.endswith("...") else line.removesuffix(".")


def _names(failures: Iterable[type[PlanFailure]]) -> str:
    return ", ".join(f"`{kind.__name__}`" for kind in failures)


def _failure(kind: type[PlanFailure], source: str) -> str:
    """Return the entry of a failure: its docstring, and its fields with the comments after them."""
    text = re.sub(r":class:`(\w+)`", r"`\1`", _line(inspect.getdoc(kind) or ""))
    body = re.search(rf"^class {kind.__name__}\b.*?(?=^\S)", source, re.DOTALL | re.MULTILINE)
    fields = re.findall(r"^ {4}(?: {4}self\.)?([a-z]\w*)(?:: | = ).*?  # (.*)$", body[0] if body else "", re.MULTILINE)
    described = "".join(f"\n    - `{name}`: {_line(meaning)}" for name, meaning in fields)
    base = kind.__mro__[1]
    more = "" if base is PlanFailure else f", a kind of `{base.__name__}`"
    return f"- **{kind.__name__}**{more}: {text}.{described}"


def main(arguments: Sequence[str]) -> None:
    """Write the page to a file, or print it."""
    if arguments:
        Path(arguments[0]).write_text(reference(), encoding="utf-8")
    else:
        sys.stdout.write(reference())


if __name__ == "__main__":
    main(sys.argv[1:])
