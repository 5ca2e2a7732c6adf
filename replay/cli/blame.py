"""``blame``: what last changed a body or a joint, and why, up to the plan's line."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import takewhile
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Keyframe
from replay.cli.console import print_json, tell
from replay.explain import wording
from replay.explain.blame import blame, commanded
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


_Way: TypeAlias = "tuple[Line, ...]"  # outermost first
_NOTABLE: Final = math.radians(0.05)  # a turn that is worth a word


def add(parser: argparse.ArgumentParser) -> None:
    """Takes what to look at."""
    parser.add_argument("object", metavar="OBJECT[.JOINT]", help="the object, or one of its joints")
    parser.add_argument("--at", metavar="STEP", help=f"until this step: {HINT}")
    parser.add_argument("--world", metavar="NAME", help="in this world (default: the one opened last that has it)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints who did it."""
    found = blame(log, options.object, options.at, options.world)
    if options.json:
        print_json(facts(found))
    else:
        tell("\n".join(lines(found)))
    return 0


def facts(found: Blame) -> dict[str, object]:
    """What was found, for machines.

    Args:
        found: the blame.
    """
    return {
        "world": found.world,
        "other_worlds": found.others,
        "without": found.without,
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


def _causes(why: Causes) -> dict[str, object]:
    return {
        "tasks": [
            {
                "id": cause.task,
                "kind": cause.kind,
                "name": cause.name,
                "parameters": cause.parameters,
                "step": cause.step,
                "line": _place(cause.line),
                "callers": [_place(line) for line in cause.callers],
            }
            for cause in why.tasks
        ],
        "line": _place(why.line),
        "callers": [_place(line) for line in why.way[:-1]],
    }


def _place(line: Line | None) -> dict[str, object] | None:
    if line is None:
        return None
    return {"file": line.file, "line": line.number, "function": line.function, "text": line.text}


def lines(found: Blame) -> Iterator[str]:
    """What was found, for people.

    Args:
        found: the blame.
    """
    yield from _lines(found, [], is_earlier=False)


def _lines(found: Blame, told: list[_Way], *, is_earlier: bool) -> Iterator[str]:
    yield _headline(found)
    yield f"  step {found.record.seq}: {wording.line(found.record)}"
    yield from _because(found.causes, "  ", told)
    for carried in found.carried:
        yield from _held(carried, told)
    if found.others and not is_earlier:
        yield f"  ({found.body} is in {wording.names(found.others)} too: --world tells which one is meant)"
    if found.without and not is_earlier:
        yield f"  ({found.without}, the world opened last, has no {found.body}: --world tells which one is meant)"
    if found.earlier is not None:
        yield ""
        yield "Before that:"
        yield from _lines(found.earlier, told, is_earlier=True)


def _headline(found: Blame) -> str:
    name = f"{found.body}.{found.joint}" if found.joint else found.body
    name += f" in {found.world}" if found.others or found.without else ""
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
    return f"by {wording.length(found.distance)}" + (f", {turned}," if found.angle >= _NOTABLE else "")


def _because(why: Causes, indent: str, told: list[_Way]) -> Iterator[str]:
    for cause in why.tasks:
        yield f"{indent}in {wording.task(cause.kind, cause.name, cause.parameters)}  [step {cause.step}]"
    if not why.tasks:
        yield f"{indent}by the plan itself"
    yield from (f"{indent}{line}" for line in _way(why.way, told))


def _way(way: _Way, told: list[_Way]) -> Iterator[str]:
    """The lines that led there, innermost first, down to those that were told with another way."""
    alike = (takewhile(lambda pair: pair[0] == pair[1], zip(way, other, strict=False)) for other in told)
    known = max((len(list(pairs)) for pairs in alike), default=0)
    told.append(way)
    word = "from"
    for line in reversed(way[known:] if known > 1 else way):
        yield f"{word} {wording.place(line)}"
        word = "called from"
    if known > 1:
        yield f"{word} {wording.place(replace(way[known - 1], text=''))}, as above"


def _held(carried: Carried, told: list[_Way]) -> Iterator[str]:
    held = carried.held
    link = f" ({held.carrier_link})" if held.carrier_link else ""
    if carried.step is None or carried.causes is None:
        yield f"  {held.carrier}{link} held {held.body} already when the recording began"
        return
    yield f"  {held.carrier}{link} held {held.body} since step {carried.step}, where it was attached"
    yield from _because(carried.causes, "    ", told)
