"""What verbs that run a plan again have in common: which source runs with which arguments, and the comparison."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from replay.cli import formatting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.retrace.retrace import Retracing

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
    of += formatting.path(str(result.plan))
    if difference is None:
        taken = f", with {result.taken} recorded answers" if result.taken else ""
        where = f"{result.equal} records" if result.equal == result.steps else f"first {result.equal} records"
        yield f"identical  {of} made the same {where} again, in {result.seconds:.1f} s{taken}"
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
