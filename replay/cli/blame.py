"""``blame``: what last changed a body or a joint, and why, up to the plan's line."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, argument_values
from replay.cli import call_stacks, formatting, record_text
from replay.cli.console import print_result
from replay.explain.blame import commanded
from replay.explain.step_names import HINT
from replay.state.json_data import record_data

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from recorder.geometry import Pose
    from replay.cli.call_stacks import CallStack
    from replay.explain.blame import Blame, Carried
    from replay.explain.causing_tasks import Causes
    from replay.recording import Recording


_MIN_TURN: Final = math.radians(0.05)  # smaller ones are not mentioned


def add(parser: argparse.ArgumentParser) -> None:
    """Add the object, the step and the world."""
    parser.add_argument("object", metavar="OBJECT[.JOINT]", help="the object, or one of its joints")
    parser.add_argument("--at", metavar="STEP", help=f"until this step: {HINT}")
    parser.add_argument("--world", metavar="NAME", help="in this world (default: the one opened last that has it)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the change and its causes."""
    change = log.blame(options.object, options.at, options.world)
    print_result(lambda: facts(change), lines(change), as_json=options.json)
    return 0


def facts(change: Blame) -> dict[str, object]:
    """Return the change as JSON data."""
    return {
        "world": change.world,
        "other_worlds": change.other_worlds,
        "without": change.default_world,
        "object": change.body,
        "joint": change.joint,
        "how": change.how,
        "before": change.before,
        "after": change.after,
        "distance": change.distance if math.isfinite(change.distance) else None,
        "angle": change.angle,
        "record": record_data(change.record),
        "causes": _causes(change.causes),
        "carried": [
            {
                "carrier": carried.held.carrier,
                "carrier_link": carried.held.carrier_link,
                "body": carried.held.body,
                "step": carried.step,
                "causes": _causes(carried.causes) if carried.causes is not None else None,
            }
            for carried in change.carried
        ],
        "earlier": facts(change.earlier) if change.earlier is not None else None,
    }


def _causes(causes: Causes) -> dict[str, object]:
    return {
        "tasks": [
            {
                "id": task.started.task,
                "kind": task.started.kind,
                "name": task.started.name,
                "parameters": argument_values(task.started.parameters),
                "step": task.started.seq,
                "cause": task.started.cause,
            }
            | call_stacks.facts(task.call_stack)
            for task in causes.tasks
        ],
    } | call_stacks.facts(causes.call_stack)


def lines(change: Blame) -> Iterator[str]:
    """Yield the change as text."""
    yield from _lines(change, [], is_earlier=False)


def _lines(change: Blame, printed: list[CallStack], *, is_earlier: bool) -> Iterator[str]:
    yield _headline(change)
    yield f"  step {change.record.seq}: {record_text.line(change.record)}"
    if not getattr(change.record, "by_fork", False):  # which its line says
        yield from _because(change.causes, "  ", printed)
    for carried in change.carried:
        yield from _held(carried, printed)
    if change.other_worlds and not is_earlier:
        yield f"  ({change.body} is in {formatting.names(change.other_worlds)} too: --world chooses one)"
    if change.default_world and not is_earlier:
        yield f"  ({change.default_world}, the world opened last, has no {change.body}: --world chooses one)"
    if change.earlier is not None:
        yield ""
        yield "Before that:"
        yield from _lines(change.earlier, printed, is_earlier=True)


def _headline(change: Blame) -> str:
    name = f"{change.body}.{change.joint}" if change.joint else change.body
    name += f" in {change.world}" if change.other_worlds or change.default_world else ""
    if change.after is None:
        return f"{name} was removed" + (f" from {_value(change.before)}" if change.before is not None else "")
    where = _value(change.after)
    if isinstance(change.record, Keyframe):
        return f"{name} was at {where} already when the recording began"
    if change.how == "load":
        return f"{name} has been at {where} since it was loaded"
    by = {
        "command": "was moved",
        "carried": f"was carried by {change.carried[-1].held.carrier}" if change.carried else "was carried",
        "along": f"moved along with {commanded(change.record)}",
        "hand": "was dragged by hand in the window",
        "driven": "followed a trajectory",
        "physics": "moved in simulation",
        "reset": "moved when the world was reset",
        "restored": "moved when a saved state was restored",
    }
    if isinstance(change.before, float) and isinstance(change.after, float):
        before, after = formatting.apart(change.before, change.after)
        return f"{name} {by[change.how]}: from {before} to {after}"
    return f"{name} {by[change.how]}: {_size(change)} to {where}"


def _value(value: Pose | float) -> str:
    return formatting.number(value) if isinstance(value, float) else formatting.vector(value[0])


def _size(change: Blame) -> str:
    turned = f"turned by {formatting.degrees(change.angle)}"
    if change.angle and not change.distance:
        return f"{turned}, not moved away,"
    return f"by {formatting.length(change.distance)}" + (f", {turned}," if change.angle >= _MIN_TURN else "")


def _because(causes: Causes, indent: str, printed: list[CallStack]) -> Iterator[str]:
    for started in (task.started for task in causes.tasks):
        called = formatting.task(started.kind, started.name, argument_values(started.parameters))
        by = "by" if started.kind == "handler" else "in"
        event = f", step {started.cause}" if by == "by" and started.cause else ""  # 0: before the recording
        yield f"{indent}{by} {called}{event}  [step {started.seq}]"
    if not causes.tasks:
        yield f"{indent}by the plan itself"
    yield from (f"{indent}{line}" for line in call_stacks.lines(causes.call_stack, printed))


def _held(carried: Carried, printed: list[CallStack]) -> Iterator[str]:
    held = carried.held
    if carried.step is None or carried.causes is None:
        yield f"  {formatting.carrier(held)} held {held.body} already when the recording began"
        return
    yield f"  {formatting.carrier(held)} held {held.body} since step {carried.step}, where it was attached"
    yield from _because(carried.causes, "    ", printed)
