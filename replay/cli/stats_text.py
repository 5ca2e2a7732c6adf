"""Statistics of a folder of recordings in words, and as data."""

from __future__ import annotations

import dataclasses
import shlex
from typing import TYPE_CHECKING, Final

from replay.cli.reading_runs import percent, plural, success
from replay.report.phrases import one_line, short

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from replay.runs.statistics import Slow, Statistics

_MAX_CAUSES: Final = 10
_MAX_SLOW: Final = 5


def data(stats: Statistics) -> dict[str, object]:
    """Return statistics as JSON has them, with the intervals of shares."""
    facts = dataclasses.asdict(stats)
    facts["success"] |= {"interval": stats.success.interval}
    facts["parameters"] = {
        name: [dataclasses.asdict(share) | {"interval": share.interval} for share in shares]
        for name, shares in stats.parameters
    }
    facts["outcomes"], facts["others"] = dict(stats.outcomes), dict(stats.others)
    return facts


def summary_lines(stats: Statistics) -> Iterator[str]:
    """Yield what the runs are, and how they ended."""
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in stats.outcomes)
    median, longest = stats.seconds
    yield f"folder     {stats.folder} ({stats.size / 1e6:.1f} MB)"
    yield f"plan       {stats.plan or 'none'}"
    yield f"runs       {plural(len(stats.runs), 'run')}: {outcomes}" if stats.runs else "runs       none"
    yield f"success    {success(stats.success)}"
    yield f"took       {median:.2f} s in the middle, {longest:.2f} s at most"
    yield f"records    {stats.records}"
    if stats.others:
        others = ", ".join(f"{plural(count, 'run')} of {plan}" for plan, count in stats.others)
        yield f"left out   {others}"
    if stats.skipped:
        yield f"left out   {plural(len(stats.skipped), 'file')}"


def lines(stats: Statistics) -> Iterator[str]:
    """Yield all statistics."""
    yield from summary_lines(stats)
    for name, shares in stats.parameters:
        yield from ("", f"By {name}")
        width = max(len(share.what) for share in shares)
        yield from (f"  {share.what:{width}}  {success(share)}" for share in shares)
    if stats.causes:
        yield from ("", "Failures by cause")
    for cause in stats.causes[:_MAX_CAUSES]:
        yield f"  {plural(cause.count, 'run')}, {percent(cause.share)}: {cause.cause}"
        yield f"    first: {one_line(short(cause.message))}"
        yield f"    pycram-replay why {shlex.quote(f'{stats.folder}/{cause.first}')}"
    if len(stats.causes) > _MAX_CAUSES:
        yield f"  {plural(len(stats.causes) - _MAX_CAUSES, 'more cause')}"
    yield from _slow("Queries that took longest", stats.queries)
    yield from _slow("Motions that took longest", stats.motions)
    yield from _slow("Other tasks that took longest", stats.tasks)


def _slow(title: str, slow: Sequence[Slow]) -> Iterator[str]:
    if not slow:
        return
    yield from ("", title)
    width = max(len(short(each.what)) for each in slow[:_MAX_SLOW])
    for each in slow[:_MAX_SLOW]:
        total = f"{each.total:.3f} s in {each.count}, {each.median * 1e3:.1f} ms in the middle"
        longest = f"at most {each.longest * 1e3:.1f} ms at step {each.step} of {each.run}"
        yield f"  {short(each.what):{width}}  {total}, {longest}"
