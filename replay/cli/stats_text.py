"""Statistics of a folder of recordings in words, and as data."""

from __future__ import annotations

import dataclasses
import shlex
from typing import TYPE_CHECKING, Final

from replay.cli.formatting import one_line, short
from replay.cli.reading_runs import percent, plural, success

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from replay.runs.statistics import Slow, Statistics

_MAX_CAUSES: Final = 10
_MAX_SLOW: Final = 5


def data(told: Statistics) -> dict[str, object]:
    """Return statistics as JSON has them, with the intervals of shares."""
    facts = dataclasses.asdict(told)
    facts["success"] |= {"interval": told.success.interval}
    facts["parameters"] = {
        name: [dataclasses.asdict(share) | {"interval": share.interval} for share in shares]
        for name, shares in told.parameters
    }
    facts["outcomes"], facts["others"] = dict(told.outcomes), dict(told.others)
    return facts


def summary_lines(told: Statistics) -> Iterator[str]:
    """Yield what the runs are, and how they ended."""
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in told.outcomes)
    median, longest = told.seconds
    yield f"folder     {told.folder} ({told.size / 1e6:.1f} MB)"
    yield f"plan       {told.plan or 'none'}"
    yield f"runs       {plural(len(told.runs), 'run')}: {outcomes}" if told.runs else "runs       none"
    yield f"success    {success(told.success)}"
    yield f"took       {median:.2f} s in the middle, {longest:.2f} s at most"
    yield f"records    {told.records}"
    if told.others:
        others = ", ".join(f"{plural(count, 'run')} of {plan}" for plan, count in told.others)
        yield f"left out   {others}"
    if told.skipped:
        yield f"left out   {plural(len(told.skipped), 'file')}"


def lines(told: Statistics) -> Iterator[str]:
    """Yield all statistics."""
    yield from summary_lines(told)
    for name, shares in told.parameters:
        yield from ("", f"By {name}")
        width = max(len(share.what) for share in shares)
        yield from (f"  {share.what:{width}}  {success(share)}" for share in shares)
    if told.causes:
        yield from ("", "Failures by cause")
    for cause in told.causes[:_MAX_CAUSES]:
        yield f"  {plural(cause.count, 'run')}, {percent(cause.share)}: {cause.cause}"
        yield f"    first: {one_line(short(cause.message))}"
        yield f"    pycram-replay why {shlex.quote(f'{told.folder}/{cause.first}')}"
    if len(told.causes) > _MAX_CAUSES:
        yield f"  {plural(len(told.causes) - _MAX_CAUSES, 'more cause')}"
    yield from _slow("Queries that took longest", told.queries)
    yield from _slow("Motions that took longest", told.motions)
    yield from _slow("Other tasks that took longest", told.tasks)


def _slow(title: str, slow: Sequence[Slow]) -> Iterator[str]:
    if not slow:
        return
    yield from ("", title)
    width = max(len(short(each.what)) for each in slow[:_MAX_SLOW])
    for each in slow[:_MAX_SLOW]:
        total = f"{each.total:.3f} s in {each.count}, {each.median * 1e3:.1f} ms in the middle"
        longest = f"at most {each.longest * 1e3:.1f} ms at step {each.step} of {each.run}"
        yield f"  {short(each.what):{width}}  {total}, {longest}"
