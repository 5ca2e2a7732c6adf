"""``diff`` of two folders of recordings: how often each succeeds, of what each fails, which runs end otherwise."""

from __future__ import annotations

import dataclasses
import shlex
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE
from replay.cli.reading_runs import opened, percent, plural, success
from replay.runs.comparison import compare_folders

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from pathlib import Path

    from replay.runs.comparison import FolderComparison
    from replay.runs.runs import Runs

_MAX_CAUSES: Final = 10
_MAX_PAIRS: Final = 3  # of runs that are named


def run(first: Runs, options: argparse.Namespace) -> int:
    """Print the difference to another folder; the exit code is 1 if there is any."""
    with opened(options.first) as second:
        found = compare_folders(first, second)
        for left_out in second.skipped:
            print_message(f"left out: {second.path}: {left_out.name}: {left_out.reason}")
        print_result(lambda: _data(found), _lines(found, first.path, second.path), as_json=options.json)
        return INCOMPLETE if second.skipped else FAILED if found else FINE


def _data(found: FolderComparison) -> dict[str, object]:
    facts = dataclasses.asdict(found)
    for name, share in (("first", found.first), ("second", found.second)):
        facts[name] |= {"interval": share.interval}
    facts["causes"] = [{"cause": cause, "first": a, "second": b} for cause, a, b in found.causes]
    return facts | {"effect": found.effect, "interval": list(found.interval)}


def _lines(found: FolderComparison, first: Path, second: Path) -> Iterator[str]:
    low, high = found.interval
    yield f"plan     {found.plan}"
    yield f"first    {success(found.first)}: {first}"
    yield f"second   {success(found.second)}: {second}"
    yield f"change   {_signed(found.effect)} (95 %: {_signed(low)} to {_signed(high)})"
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


def _signed(share: float) -> str:
    return f"{'+' if share > 0 else ''}{percent(share) if share >= 0 else f'-{percent(-share)}'}"
