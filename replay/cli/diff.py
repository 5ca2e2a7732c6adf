"""``diff``: what is different between two steps of a recording, two recordings, or two folders of these."""

from __future__ import annotations

import argparse
import dataclasses
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE
from replay.compare import states
from replay.compare.runs import compare, lines as run_lines
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report import report

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.runs.comparison import FolderComparison
    from replay.runs.runs import Runs

_MAX_CAUSES: Final = 10  # of failures that are named
_MAX_PAIRS: Final = 3  # of runs that are named


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
        delta = states.difference(log.state_at(options.first), log.state_at(options.second))
        print_result(lambda: report.data(delta), states.lines(delta, whole=options.all), as_json=options.json)
        return FINE
    if not Path(options.first).exists():
        raise ReplayError(f"{options.first}: no such recording; to compare steps of this one, give two")
    with Recording(options.first) as other:
        compared = compare(log, other, options.tolerance)
        problems = other.problems  # it was read to its end
    print_result(lambda: report.data(compared), run_lines(compared, whole=options.all), as_json=options.json)
    if problems:
        print_message(f"{other.path} is incomplete: {problems}")
    if problems or log.problems:  # lost records may be the difference
        return INCOMPLETE
    return FAILED if compared.divergence is not None or compared.difference else FINE


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    """Print the difference between two folders of recordings."""
    from replay.cli.reading_runs import opened  # noqa: PLC0415  what these need is an extra
    from replay.runs.comparison import compare_folders  # noqa: PLC0415  as above

    if options.second is not None or not Path(options.first).is_dir():
        raise ReplayError("two folders are compared, or steps of one recording, or two recordings")
    with opened(options.first) as second:
        found = compare_folders(runs, second)
        for left_out in second.skipped:
            print_message(f"left out: {second.path}: {left_out.name}: {left_out.reason}")
        text = _folder_lines(found, runs.path, second.path)
        print_result(lambda: _folder_data(found), text, as_json=options.json)
        return INCOMPLETE if second.skipped else FAILED if found else FINE


def _folder_data(found: FolderComparison) -> dict[str, object]:
    facts = dataclasses.asdict(found)
    for name, share in (("first", found.first), ("second", found.second)):
        facts[name] |= {"interval": share.interval}
    facts["causes"] = [{"cause": cause, "first": a, "second": b} for cause, a, b in found.causes]
    return facts | {"effect": found.effect, "interval": list(found.interval)}


def _folder_lines(found: FolderComparison, first: Path, second: Path) -> Iterator[str]:
    from replay.cli.reading_runs import percent, plural, success  # noqa: PLC0415  as above

    def signed(share: float) -> str:
        return f"{'+' if share > 0 else ''}{percent(share) if share >= 0 else f'-{percent(-share)}'}"

    low, high = found.interval
    yield f"plan     {found.plan}"
    yield f"first    {success(found.first)}: {first}"
    yield f"second   {success(found.second)}: {second}"
    yield f"change   {signed(found.effect)} (95 %: {signed(low)} to {signed(high)})"
    yield f"paired   {plural(found.paired, 'run')} of both with the same number, seed and parameters"
    for what, pairs in (("fail no more", found.mended), ("fail only in the second", found.broken)):
        if pairs:
            yield from ("", f"{len(pairs)} of them {what}")
        for a, b in pairs[:_MAX_PAIRS]:
            yield f"  pycram-replay diff {shlex.quote(str(first / a))} {shlex.quote(str(second / b))}"
    if found.causes:
        yield from ("", "Failures by cause, first -> second")
    yield from (f"  {a:4} -> {b:<4} {cause}" for cause, a, b in found.causes[:_MAX_CAUSES])
    if len(found.causes) > _MAX_CAUSES:
        yield f"  {plural(len(found.causes) - _MAX_CAUSES, 'more cause')}"
