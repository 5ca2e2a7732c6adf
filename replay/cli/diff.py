"""``diff``: what is different between two steps of a recording, or between two recordings."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_json, remark, tell
from replay.errors import ReplayError
from replay.explain import wording
from replay.explain.compare import compare
from replay.explain.step_names import HINT
from replay.recording import open_recording
from replay.state.diff import difference
from replay.state.json_data import record_data

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Record
    from replay.explain.compare import Comparison, Parting
    from replay.explain.summary import Summary
    from replay.recording import Recording
    from replay.state.diff import BodyChange, Difference
    from replay.state.state import Attachment

_FEW: Final = 8  # joints and fields that are told one by one
_TURN: Final = math.radians(0.05)  # from which on it is worth a word
_FINE, _PARTED, _INCOMPLETE = 0, 1, 3


def add(parser: argparse.ArgumentParser) -> None:
    """Takes two steps, or another recording."""
    parser.epilog = "Exit code 0: fine. 1: the two recordings differ. 3: one of them is incomplete."
    parser.add_argument("first", metavar="STEP|LOG", help=f"{HINT}; or the other recording")
    parser.add_argument("second", metavar="STEP", nargs="?", help="the step to compare it with")
    parser.add_argument("--all", action="store_true", help="also what only came to rest, and every joint")
    parser.add_argument(
        "--tolerance", type=_size, default=0.0, metavar="X", help="numbers of two recordings that differ less are equal"
    )


def _size(text: str) -> float:
    size = float(text)
    if not 0 <= size < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is no size: a number from 0 is")
    return size


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the difference; of two whole recordings that part, the exit code is 1."""
    if options.second is not None:
        found = difference(log.state_at(options.first), log.state_at(options.second))
        if options.json:
            print_json(facts(found))
        else:
            tell("\n".join(lines(found, whole=options.all)))
        return _FINE
    if not Path(options.first).exists():
        raise ReplayError(f"{options.first}: no such recording; to compare steps of this one, give two")
    with open_recording(options.first) as other:
        compared = compare(log, other, options.tolerance)
        missing = other.missing  # read to its end
    if options.json:
        print_json(_run_facts(compared))
    else:
        tell("\n".join(_run_lines(compared, whole=options.all)))
    if missing:
        remark(f"{other.path} is incomplete: {missing}")
    if missing or log.missing:  # what differs may be what is lost
        return _INCOMPLETE
    return _PARTED if compared.parting is not None or compared.world else _FINE


# --- two steps -------------------------------------------------------------------------------------------------------


def facts(found: Difference) -> dict[str, object]:
    """A difference, for machines.

    Args:
        found: the difference.
    """
    return {
        "opened": found.opened,
        "closed": found.closed,
        "came": [{"world": world, "object": body} for world, body in found.came],
        "went": [{"world": world, "object": body} for world, body in found.went],
        "changed": [_change_facts(change) for change in found.changed],
        "facts": [{"world": world, "fact": name, "values": pair} for (world, name), pair in found.facts.items()],
    }


def _change_facts(change: BodyChange) -> dict[str, object]:
    return {
        "world": change.world,
        "object": change.body,
        "before": change.before,
        "after": change.after,
        "distance": change.distance,
        "angle": change.angle,
        "joints": {
            name: [None if math.isnan(value) else value for value in pair] for name, pair in change.joints.items()
        },
        "carrier": [held and {"object": held.carrier, "link": held.carrier_link} for held in change.carrier],
        "details": change.details,
        "notable": change.notable,
    }


def lines(found: Difference, *, whole: bool = False) -> Iterator[str]:
    """A difference, for people.

    Args:
        found: the difference.
        whole: whether to tell also what only came to rest, and every joint.
    """
    yield from (f"{world} was opened" for world in found.opened)
    yield from (f"{world} was closed" for world in found.closed)
    yield from (f"{body} is new" for _, body in found.came)
    yield from (f"{body} is gone" for _, body in found.went)
    for (world, name), (before, after) in found.facts.items():
        yield f"{world}: {name} {_plain(before)} -> {_plain(after)}"
    shown = found.changed if whole else found.notable
    for change in shown:
        yield from _change(change, whole=whole)
    rest = len(found.changed) - len(shown)
    if rest:
        yield (
            f"{rest} more came to rest, by less than 1 mm"
            if shown
            else f"{rest} objects came to rest, by less than 1 mm"
        )
    if not found:
        yield "no difference"


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return wording.vector(value)
    return wording.number(value) if isinstance(value, float) else str(value) or "none"


def _change(change: BodyChange, *, whole: bool) -> Iterator[str]:
    told = []
    if change.moved or (whole and (change.distance or change.angle)):
        turned = (
            f", turned by {wording.degrees(change.angle)}"
            if change.angle >= (0.0 if whole else _TURN) and change.angle
            else ""
        )
        before, after = wording.vectors(change.before[0], change.after[0])
        told.append(f"moved by {wording.length(change.distance)}{turned}: {before} -> {after}")
    if change.changed_hands:
        holder, former = change.carrier[1], change.carrier[0]
        told.append(f"held by {_holder(holder)}, before by {_holder(former)}")
    told += [f"has another {detail}" for detail in change.details]
    joints = change.joints if whole else change.moved_joints
    if len(joints) > _FEW and not whole:
        told.append(f"{len(joints)} joints moved, most of all " + _joint(*max(joints.items(), key=_travel)))
        joints = {}
    told += [_joint(name, pair) for name, pair in joints.items()]
    if len(told) == 1:
        yield f"{change.body} {told[0]}"
    else:
        yield change.body
        yield from (f"  {line}" for line in told)


def _joint(name: str, pair: tuple[float, float]) -> str:
    before, after = wording.apart(*pair)
    return f"{name} {before} -> {after}"


def _travel(item: tuple[str, tuple[float, float]]) -> float:
    return abs(item[1][1] - item[1][0])


def _holder(held: Attachment | None) -> str:
    if held is None:
        return "nobody"
    return held.carrier + (f" ({held.carrier_link})" if held.carrier_link else "")


# --- two recordings --------------------------------------------------------------------------------------------------


def _run_facts(compared: Comparison) -> dict[str, object]:
    parting = compared.parting
    return {
        "alike": compared.alike,
        "parting": parting
        and {
            "first": parting.first and record_data(parting.first),
            "second": parting.second and record_data(parting.second),
            "task": parting.task,
            "fields": parting.fields,
        },
        "world": facts(compared.world),
        "outcomes": [_outcome(each) for each in compared.outcomes],
        "failures": [each.failure for each in compared.outcomes],
    }


def _run_lines(compared: Comparison, *, whole: bool) -> Iterator[str]:
    first, second = compared.outcomes
    if compared.parting is None:
        yield f"the runs are the same: {compared.alike} records"
    else:
        yield from _parting(compared.parting, compared.alike)
    if compared.world:
        yield ""
        yield "at the end, first -> second:"
        yield from (f"  {line}" for line in lines(compared.world, whole=whole))
    told = _ended(first), _ended(second)
    yield ""
    yield f"both {told[0]}" if told[0] == told[1] else f"the first {told[0]}; the second {told[1]}"


def _ended(run: Summary) -> str:
    """What a run did in the end, as one says it of one and of two."""
    return {"cut off": "broke off", "running": "had not ended"}.get(run.outcome) or _outcome(run)


def _outcome(run: Summary) -> str:
    return run.outcome + (f" ({run.failure})" if run.failure else "")


def _parting(parting: Parting, alike: int) -> Iterator[str]:
    where = f" in {parting.task}" if parting.task else ""
    yield f"the runs are alike for {alike} records, then they part{where}:"
    for name, record in (("first", parting.first), ("second", parting.second)):
        yield f"  {name:6} {_told(record)}"
    for field, (before, after) in list(parting.fields.items())[:_FEW]:
        apart = f"  (by {abs(after - before):.3g})" if isinstance(before, float) and isinstance(after, float) else ""
        yield f"    {field}: {wording.value(before)} -> {wording.value(after)}{apart}"
    if len(parting.fields) > _FEW:
        yield f"    ... {len(parting.fields) - _FEW} more values"


def _told(record: Record | None) -> str:
    return f"step {record.seq}: {wording.short(wording.line(record))}" if record is not None else "has no such record"
