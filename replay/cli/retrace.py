"""``retrace``: whether a plan, run again, does what its recording has; else the first difference."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from replay.cli import formatting
from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE, USAGE
from replay.errors import ReplayError, Unreadable
from replay.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.retrace.retrace import Retracing

_MAX_FIELDS = 4  # that are listed
_MAX_CALLERS = 4


def add(parser: argparse.ArgumentParser) -> None:
    """Add more recordings, and what to run."""
    parser.epilog = "Exit code 0: each plan did the same again. 1: one didn't. 2: one can't be run. 3: one is damaged."
    parser.add_argument("more", metavar="LOG", nargs="*", help="other recordings")
    parser.add_argument("--plan", metavar="FILE", help="run this file (default: the one that was recorded)")
    parser.add_argument(
        "--arguments", nargs=argparse.REMAINDER, help="all that follow are the plan's (default: the recorded ones)"
    )


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
        result = retrace(log, plan=options.plan, arguments=options.arguments)
    except CantRetrace as error:  # the others are to be run
        return _not_run(str(log.path), error, results)
    results.append({"file": str(log.path), **asdict(result), "plan": str(result.plan), "identical": result.identical})
    if not options.json:
        print_result(dict, _lines(log, result), as_json=False)
    return FINE if result.identical else FAILED


def _not_run(name: str, error: ReplayError, results: list[dict[str, object]]) -> int:
    """Print why a recording wasn't retraced, and return the exit code."""
    print_message(str(error))
    results.append({"file": name, "error": str(error)})
    return INCOMPLETE if isinstance(error, Unreadable) else USAGE


def _lines(log: Recording, result: Retracing) -> Iterator[str]:
    difference = result.difference
    of = f"{log.path}: {formatting.path(str(result.plan))}"
    if difference is None:
        where = f"{result.equal} records" if result.equal == result.steps else f"first {result.equal} records"
        yield f"identical  {of} made the same {where} again, in {result.seconds:.1f} s"
    else:
        yield f"different  {of}, from step {difference.step} on: {difference.text.replace(*_short(difference.line))}"
        yield from (f"           called from {_short(caller)[1]}" for caller in difference.callers[:_MAX_CALLERS])
        for name, (before, now) in list(difference.fields.items())[:_MAX_FIELDS]:
            yield f"           {name}: recorded {formatting.short(str(before))}, now {formatting.short(str(now))}"
        left = len(difference.fields) - _MAX_FIELDS
        if left > 0:
            yield f"           and {left} more fields"
    yield from (f"note       {note}" for note in result.notes)


def _short(line: str) -> tuple[str, str]:
    """Return a plan's line, and with its file's path from the folder that one is in."""
    file, _, number = line.rpartition(":")
    return (line, f"{formatting.path(file)}:{number}") if file else ("\0", "")
