"""``retrace``: whether a plan, run again, does what its recording has; else the first difference."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE, USAGE
from replay.cli.retracing import add_source_and_arguments, facts_of, lines_of
from replay.errors import ReplayError, Unreadable
from replay.recording import Recording

if TYPE_CHECKING:
    import argparse


def add(parser: argparse.ArgumentParser) -> None:
    """Add more recordings, and what to run."""
    parser.epilog = "Exit code 0: each plan did the same again. 1: one didn't. 2: one can't be run. 3: one is damaged."
    parser.add_argument("more", metavar="LOG", nargs="*", help="other recordings")
    parser.add_argument("--plan", metavar="FILE", help="run this file (default: the one that was recorded)")
    parser.add_argument(
        "--answers",
        choices=("asked", "recorded"),
        default="asked",
        help="ask queries again and compare their answers (default), or take the recorded ones, which is faster",
    )
    add_source_and_arguments(parser)


def run(log: Recording, options: argparse.Namespace) -> int:
    """Retrace the recordings one after another; the highest exit code counts."""
    results: list[dict[str, object]] = []
    code = _retrace(log, options, results)
    for name in options.more:
        try:
            with Recording(name) as other:
                code = max(code, _retrace(other, options, results))
                if other.problems:
                    print_message(f"{name} is incomplete: {other.problems}")
                    code = max(code, INCOMPLETE)
        except ReplayError as error:
            code = max(code, _not_run(name, error, results))
    if options.json:
        print_result(lambda: results, (), as_json=True)
    return code


def _retrace(log: Recording, options: argparse.Namespace, results: list[dict[str, object]]) -> int:
    from replay.retrace.plan_process import CantRetrace  # noqa: PLC0415  as below
    from replay.retrace.retrace import retrace  # noqa: PLC0415  needs the executor

    try:
        result = retrace(
            log,
            plan=options.plan,
            arguments=options.arguments,
            answers=options.answers,
            recorded_source=options.recorded_source,
        )
    except CantRetrace as error:  # the others are to be run
        return _not_run(str(log.path), error, results)
    results.append({"file": str(log.path), **facts_of(result)})
    if not options.json:
        print_result(dict, lines_of(result, f"{log.path}: "), as_json=False)
    return FINE if result.identical else FAILED


def _not_run(name: str, error: ReplayError, results: list[dict[str, object]]) -> int:
    """Print why a recording wasn't retraced, and return the exit code."""
    print_message(str(error))
    results.append({"file": name, "error": str(error)})
    return INCOMPLETE if isinstance(error, Unreadable) else USAGE
