"""``retrace``: whether a plan, run again, does what its recording has; else the first difference.

What verbs that run a plan again have in common: which source runs with which arguments, and the comparison.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE, USAGE
from replay.errors import ReplayError, Unreadable
from replay.recording import Recording
from replay.report import phrases

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.retrace.retrace import Retracing


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


_MAX_FIELDS = 4  # that are listed
_MAX_CALLERS = 4


def add_source_and_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which source runs, and the plan's arguments."""
    parser.add_argument(
        "--recorded-source",
        action="store_true",
        help="run the source that is attached to the recording (default: the files on the disk)",
    )
    add_arguments(parser)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the plan's arguments."""
    parser.add_argument(
        "--arguments", nargs=argparse.REMAINDER, help="all that follow are the plan's (default: the recorded ones)"
    )


def facts_of(result: Retracing) -> dict[str, object]:
    """Return the result as JSON data."""
    return {**asdict(result), "plan": str(result.plan), "identical": result.identical}


def lines_of(result: Retracing, of: str) -> Iterator[str]:
    """Yield the result as text, with what it is the result of before the plan's name."""
    difference = result.difference
    of += phrases.path(str(result.plan))
    if difference is None:
        taken = f", with {result.taken} recorded answers" if result.taken else ""
        where = f"{result.equal} records" if result.equal == result.steps else f"first {result.equal} records"
        yield f"identical  {of} made the same {where} again, in {result.seconds:.1f} s{taken}"
    else:
        yield f"different  {of}, from step {difference.step} on: {difference.text.replace(*_short(difference.line))}"
        yield from (f"           called from {_short(caller)[1]}" for caller in difference.callers[:_MAX_CALLERS])
        for name, (before, now) in list(difference.fields.items())[:_MAX_FIELDS]:
            yield f"           {name}: recorded {phrases.short(str(before))}, now {phrases.short(str(now))}"
        left = len(difference.fields) - _MAX_FIELDS
        if left > 0:
            yield f"           and {left} more fields"
    yield from (f"note       {note}" for note in result.notes)


def _short(line: str) -> tuple[str, str]:
    """Return a plan's line, and with its file's path from the folder that one is in."""
    file, _, number = line.rpartition(":")
    return (line, f"{phrases.path(file)}:{number}") if file else ("\0", "")
