"""``blame``: what last changed a body or a joint, and why, up to the plan's line."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import takewhile
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Keyframe
from replay.cli.console import print_json, print_text
from replay.explain import wording
from replay.explain.blame import commanded
from replay.explain.step_names import HINT
from replay.state.json_data import record_data

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from recorder.geometry import Pose
    from replay.explain.blame import Blame, Carried
    from replay.explain.causes import Causes
    from replay.explain.source import Line
    from replay.recording import Recording


_CallStack: TypeAlias = "tuple[Line, ...]"  # outermost first
_MIN_TURN: Final = math.radians(0.05)  # smaller ones are not mentioned


def add(parser: argparse.ArgumentParser) -> None:
    """Add the object, the step and the world."""
    parser.add_argument("object", metavar="OBJECT[.JOINT]", help="the object, or one of its joints")
    parser.add_argument("--at", metavar="STEP", help=f"until this step: {HINT}")
    parser.add_argument("--world", metavar="NAME", help="in this world (default: the one opened last that has it)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the change and its causes."""
    found = log.blame(options.object, options.at, options.world)
    if options.json:
        print_json(facts(found))
    else:
        print_text("\n".join(lines(found)))
    return 0


def facts(found: Blame) -> dict[str, object]:
    """Return the change as JSON data."""
    return {
        "world": found.world,
        "other_worlds": found.other_worlds,
        "without": found.default_world,
        "object": found.body,
        "joint": found.joint,
        "how": found.how,
        "before": found.before,
        "after": found.after,
        "distance": found.distance if math.isfinite(found.distance) else None,
        "angle": found.angle,
        "record": record_data(found.record),
        "causes": _causes(found.causes),
        "carried": [
            {
                "carrier": carried.held.carrier,
                "carrier_link": carried.held.carrier_link,
                "body": carried.held.body,
                "step": carried.step,
                "causes": _causes(carried.causes) if carried.causes is not None else None,
            }
            for carried in found.carried
        ],
        "earlier": facts(found.earlier) if found.earlier is not None else None,
    }


def _causes(found: Causes) -> dict[str, object]:
    return {
        "tasks": [
            {
                "id": cause.task,
                "kind": cause.kind,
                "name": cause.name,
                "parameters": cause.parameters,
                "step": cause.step,
                "line": cause.line and line_facts(cause.line),
                "callers": [line_facts(line) for line in cause.callers],
            }
            for cause in found.tasks
        ],
        "line": found.line and line_facts(found.line),
        "callers": [line_facts(line) for line in found.call_stack[:-1]],
    }


def line_facts(line: Line) -> dict[str, object]:
    """Return a line of the plan as JSON data."""
    return {"file": line.file, "line": line.number, "function": line.function, "text": line.text}


def lines(found: Blame) -> Iterator[str]:
    """Yield the change as text."""
    yield from _lines(found, [], is_earlier=False)


def _lines(found: Blame, printed: list[_CallStack], *, is_earlier: bool) -> Iterator[str]:
    yield _headline(found)
    yield f"  step {found.record.seq}: {wording.line(found.record)}"
    yield from _because(found.causes, "  ", printed)
    for carried in found.carried:
        yield from _held(carried, printed)
    if found.other_worlds and not is_earlier:
        yield f"  ({found.body} is in {wording.names(found.other_worlds)} too: --world chooses one)"
    if found.default_world and not is_earlier:
        yield f"  ({found.default_world}, the world opened last, has no {found.body}: --world chooses one)"
    if found.earlier is not None:
        yield ""
        yield "Before that:"
        yield from _lines(found.earlier, printed, is_earlier=True)


def _headline(found: Blame) -> str:
    name = f"{found.body}.{found.joint}" if found.joint else found.body
    name += f" in {found.world}" if found.other_worlds or found.default_world else ""
    if found.after is None:
        return f"{name} was removed" + (f" from {_value(found.before)}" if found.before is not None else "")
    where = _value(found.after)
    if isinstance(found.record, Keyframe):
        return f"{name} was at {where} already when the recording began"
    if found.how == "load":
        return f"{name} has been at {where} since it was loaded"
    by = {
        "command": "was moved",
        "carried": f"was carried by {found.carried[-1].held.carrier}" if found.carried else "was carried",
        "along": f"moved along with {commanded(found.record)}",
        "physics": "moved in simulation",
        "reset": "moved when the world was reset",
    }
    if isinstance(found.before, float) and isinstance(found.after, float):
        before, after = wording.apart(found.before, found.after)
        return f"{name} {by[found.how]}: from {before} to {after}"
    return f"{name} {by[found.how]}: {_size(found)} to {where}"


def _value(value: Pose | float) -> str:
    return wording.number(value) if isinstance(value, float) else wording.vector(value[0])


def _size(found: Blame) -> str:
    turned = f"turned by {wording.degrees(found.angle)}"
    if found.angle and not found.distance:
        return f"{turned}, not moved away,"
    return f"by {wording.length(found.distance)}" + (f", {turned}," if found.angle >= _MIN_TURN else "")


def _because(found: Causes, indent: str, printed: list[_CallStack]) -> Iterator[str]:
    for cause in found.tasks:
        yield f"{indent}in {wording.task(cause.kind, cause.name, cause.parameters)}  [step {cause.step}]"
    if not found.tasks:
        yield f"{indent}by the plan itself"
    yield from (f"{indent}{line}" for line in _call_stack(found.call_stack, printed))


def _call_stack(stack: _CallStack, printed: list[_CallStack]) -> Iterator[str]:
    """Yield the lines of a call stack, innermost first, down to those that were printed with another one."""
    alike = (takewhile(lambda pair: pair[0] == pair[1], zip(stack, other, strict=False)) for other in printed)
    known = max((len(list(pairs)) for pairs in alike), default=0)
    printed.append(stack)
    word = "from"
    for line in reversed(stack[known:] if known > 1 else stack):
        yield f"{word} {wording.place(line)}"
        word = "called from"
    if known > 1:
        yield f"{word} {wording.place(replace(stack[known - 1], text=''))}, as above"


def _held(carried: Carried, printed: list[_CallStack]) -> Iterator[str]:
    held = carried.held
    link = f" ({held.carrier_link})" if held.carrier_link else ""
    if carried.step is None or carried.causes is None:
        yield f"  {held.carrier}{link} held {held.body} already when the recording began"
        return
    yield f"  {held.carrier}{link} held {held.body} since step {carried.step}, where it was attached"
    yield from _because(carried.causes, "    ", printed)
