"""``diff``: what is different between two steps of a recording, two recordings, or two folders of these."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE
from replay.compare.runs import compare
from replay.compare.states import difference
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report import phrases
from replay.state.json_data import record_data

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Record
    from replay.compare.runs import Comparison, Divergence
    from replay.compare.states import BodyChange, Difference
    from replay.history.summary import Summary
    from replay.runs.runs import Runs
    from replay.state.state import Attachment

_MAX_LISTED: Final = 8  # joints and fields that are listed one by one
_MIN_TURN: Final = math.radians(0.05)  # smaller ones are not mentioned


def add(parser: argparse.ArgumentParser) -> None:
    """Add two steps, or another recording or folder."""
    parser.epilog = "Exit code 0: fine. 1: the two recordings, or folders, differ. 3: one of them is incomplete."
    parser.add_argument("first", metavar="STEP|LOG", help=f"{HINT}; or the other recording, or folder")
    parser.add_argument("second", metavar="STEP", nargs="?", help="the step to compare it with")
    parser.add_argument("--all", action="store_true", help="also settling of physics, and every joint")
    parser.add_argument(
        "--tolerance",
        type=_tolerance,
        default=0.0,
        metavar="X",
        help="numbers of two recordings that differ less are equal",
    )


def _tolerance(text: str) -> float:
    value = float(text)
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is no tolerance: expected a number from 0")
    return value


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the difference; of two whole recordings that differ, the exit code is 1."""
    if options.second is not None:
        delta = difference(log.state_at(options.first), log.state_at(options.second))
        print_result(lambda: facts(delta), lines(delta, whole=options.all), as_json=options.json)
        return FINE
    if not Path(options.first).exists():
        raise ReplayError(f"{options.first}: no such recording; to compare steps of this one, give two")
    with Recording(options.first) as other:
        compared = compare(log, other, options.tolerance)
        problems = other.problems  # it was read to its end
    print_result(lambda: _run_facts(compared), _run_lines(compared, whole=options.all), as_json=options.json)
    if problems:
        print_message(f"{other.path} is incomplete: {problems}")
    if problems or log.problems:  # lost records may be the difference
        return INCOMPLETE
    return FAILED if compared.divergence is not None or compared.difference else FINE


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    """Print the difference between two folders of recordings."""
    from replay.cli import diff_folders  # noqa: PLC0415  what it needs is an extra

    if options.second is not None or not Path(options.first).is_dir():
        raise ReplayError("two folders are compared, or steps of one recording, or two recordings")
    return diff_folders.run(runs, options)


# --- two steps -------------------------------------------------------------------------------------------------------


def facts(delta: Difference) -> dict[str, object]:
    """Return a difference, for machines."""
    return {
        "opened": delta.opened,
        "closed": delta.closed,
        "came": [{"world": world, "object": body} for world, body in delta.added],
        "went": [{"world": world, "object": body} for world, body in delta.removed],
        "changed": [_change_facts(change) for change in delta.changed],
        "facts": [{"world": world, "fact": name, "values": pair} for (world, name), pair in delta.facts.items()],
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


def lines(delta: Difference, *, whole: bool = False) -> Iterator[str]:
    """Yield a difference as text; ``whole`` includes settling of physics and every joint."""
    yield from (f"{world} was opened" for world in delta.opened)
    yield from (f"{world} was closed" for world in delta.closed)
    yield from (f"{body} is new" for _, body in delta.added)
    yield from (f"{body} is gone" for _, body in delta.removed)
    for (world, name), (before, after) in delta.facts.items():
        yield f"{world}: {name} {_plain(before)} -> {_plain(after)}"
    shown = delta.changed if whole else delta.notable
    for change in shown:
        yield from _change(change, whole=whole)
    rest = len(delta.changed) - len(shown)
    if rest:
        yield (f"{rest} more settled by less than 1 mm" if shown else f"{rest} objects settled by less than 1 mm")
    if not delta:
        yield "no difference"


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return phrases.vector(value)
    if value is None:
        return "nowhere"
    return phrases.number(value) if isinstance(value, float) else str(value) or "none"


def _change(change: BodyChange, *, whole: bool) -> Iterator[str]:
    changes = []
    if change.moved or (whole and (change.distance or change.angle)):
        is_turned = change.angle > 0 and (whole or change.angle >= _MIN_TURN)
        turned = f", turned by {phrases.degrees(change.angle)}" if is_turned else ""
        before, after = phrases.vectors(change.before[0], change.after[0])
        changes.append(f"moved by {phrases.length(change.distance)}{turned}: {before} -> {after}")
    if change.carrier_changed:
        holder, former = change.carrier[1], change.carrier[0]
        changes.append(f"held by {_holder(holder)}, before by {_holder(former)}")
    changes += [f"has another {detail}" for detail in change.details]
    joints = change.joints if whole else change.moved_joints
    if len(joints) > _MAX_LISTED and not whole:
        changes.append(f"{len(joints)} joints moved, most of all " + _joint(*max(joints.items(), key=_travel)))
        joints = {}
    changes += [_joint(name, pair) for name, pair in joints.items()]
    if len(changes) == 1:
        yield f"{change.body} {changes[0]}"
    else:
        yield change.body
        yield from (f"  {line}" for line in changes)


def _joint(name: str, pair: tuple[float, float]) -> str:
    before, after = phrases.apart(*pair)
    return f"{name} {before} -> {after}"


def _travel(item: tuple[str, tuple[float, float]]) -> float:
    return abs(item[1][1] - item[1][0])


def _holder(held: Attachment | None) -> str:
    return "nothing" if held is None else phrases.carrier(held)


# --- two recordings --------------------------------------------------------------------------------------------------


def _run_facts(compared: Comparison) -> dict[str, object]:
    divergence = compared.divergence
    return {
        "alike": compared.equal,
        "parting": divergence
        and {
            "first": divergence.first and record_data(divergence.first),
            "second": divergence.second and record_data(divergence.second),
            "task": divergence.task,
            "fields": divergence.fields,
        },
        "world": facts(compared.difference),
        "outcomes": [_outcome(each) for each in compared.outcomes],
        "failures": [each.failure for each in compared.outcomes],
    }


def _run_lines(compared: Comparison, *, whole: bool) -> Iterator[str]:
    first, second = compared.outcomes
    if compared.divergence is None:
        yield f"the runs are the same: {compared.equal} records"
    else:
        yield from _divergence(compared.divergence, compared.equal)
    if compared.difference:
        yield ""
        yield "at the end, first -> second:"
        yield from (f"  {line}" for line in lines(compared.difference, whole=whole))
    ends = _ended(first), _ended(second)
    yield ""
    yield f"both {ends[0]}" if ends[0] == ends[1] else f"the first {ends[0]}; the second {ends[1]}"


def _ended(run: Summary) -> str:
    """Return how a run ended, as a verb."""
    verbs = {"cut off": "broke off", "running": "had not ended", "lost": "lost its end"}
    return verbs.get(run.outcome) or _outcome(run)


def _outcome(run: Summary) -> str:
    return run.outcome + (f" ({run.failure})" if run.failure else "")


def _divergence(divergence: Divergence, equal: int) -> Iterator[str]:
    where = f" in {divergence.task}" if divergence.task else ""
    yield f"the runs are equal for {equal} records, then they diverge{where}:"
    for name, record in (("first", divergence.first), ("second", divergence.second)):
        yield f"  {name:6} {_record(record)}"
    for field, (before, after) in list(divergence.fields.items())[:_MAX_LISTED]:
        apart = f"  (by {abs(after - before):.3g})" if isinstance(before, float) and isinstance(after, float) else ""
        yield f"    {field}: {phrases.value(before)} -> {phrases.value(after)}{apart}"
    if len(divergence.fields) > _MAX_LISTED:
        yield f"    ... {len(divergence.fields) - _MAX_LISTED} more values"


def _record(record: Record | None) -> str:
    return (
        f"step {record.seq}: {phrases.short(phrases.record_line(record))}"
        if record is not None
        else "has no such record"
    )
