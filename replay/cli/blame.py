"""``blame``: the last change of a body or a joint, its cause, and the plan's line that led to it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from replay.cli.console import print_result
from replay.explain.blame_report import lines
from replay.history.steps import HINT
from replay.report import report

if TYPE_CHECKING:
    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("object", metavar="OBJECT[.JOINT]", help="the object, or one of its joints")
    parser.add_argument("--at", metavar="STEP", help=f"the last step that is searched: {HINT}")
    parser.add_argument(
        "--world", metavar="NAME", help="world of the object (default: the last opened world with the object)"
    )


def run(log: Recording, options: argparse.Namespace) -> None:
    change = log.blame(options.object, options.at, options.world)
    print_result(lambda: report.data(change), lines(change), as_json=options.json)
