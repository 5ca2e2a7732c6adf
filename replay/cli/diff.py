"""``diff``: the difference between two steps of a recording, two recordings, or two folders of recordings."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE, opened
from replay.compare import compare_recordings, comparison_lines, difference, difference_lines
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report import report

if TYPE_CHECKING:
    from replay.runs.folder import Runs


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 0: success. 1: the two recordings, or folders, differ. 3: a recording is incomplete."
    parser.add_argument("first", metavar="STEP|LOG", help=f"the first step ({HINT}), or the other recording or folder")
    parser.add_argument("second", metavar="STEP", nargs="?", help="the second step")
    parser.add_argument("--all", action="store_true", help="also print every joint, and small moves of objects")
    parser.add_argument("--tolerance", type=_tolerance, default=0.0, metavar="X", help="ignore differences up to X")


def _tolerance(text: str) -> float:
    value = float(text)
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} isn't a tolerance: expected a number of at least 0")
    return value


def run(log: Recording, options: argparse.Namespace) -> int:
    if options.second is not None:
        delta = difference(log.state_at(options.first), log.state_at(options.second))
        print_result(lambda: report.data(delta), difference_lines(delta, whole=options.all), as_json=options.json)
        return FINE
    if not Path(options.first).exists():
        raise ReplayError(f"{options.first}: no such recording; to compare two steps of this recording, give both")
    with Recording(options.first) as other:
        compared = compare_recordings(log, other, options.tolerance)
        problems = other.problems  # these problems are known only after reading the whole recording
    print_result(lambda: report.data(compared), comparison_lines(compared, whole=options.all), as_json=options.json)
    if problems:
        print_message(f"{other.path} is incomplete: {problems}")
    if problems or log.problems:  # the difference may come from lost records
        return INCOMPLETE
    return FAILED if compared.divergence is not None or compared.difference else FINE


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    from replay.runs.statistics import compare_folders, lines  # noqa: PLC0415  needs an extra

    if options.second is not None or not Path(options.first).is_dir():
        raise ReplayError("diff compares two folders, two recordings, or two steps of a recording")
    with opened(options.first) as second:
        found = compare_folders(runs, second)
        for left_out in second.skipped:
            print_message(f"left out: {second.path}: {left_out.name}: {left_out.reason}")
        text = lines(found, runs.path, second.path)
        print_result(lambda: report.data(found), text, as_json=options.json)
        return INCOMPLETE if second.skipped else FAILED if found else FINE
