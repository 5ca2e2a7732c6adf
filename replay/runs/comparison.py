"""Two folders of runs compared: how often each succeeds, why each fails, and which runs end differently.

Runs of both sweeps with the same number, seed and parameters are paired. A pair differs because something was changed
between the sweeps, such as the plan, or because a seed doesn't determine everything.
"""

from __future__ import annotations

import dataclasses
import shlex
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from replay.errors import ReplayError
from replay.report import report
from replay.report.phrases import percent, plural
from replay.runs.statistics import Share, difference, plan_of, statistics

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from replay.runs.runs import Runs


_MAX_CAUSES: Final = 10
_MAX_PAIRS: Final = 3  # of runs that are named


@dataclass(frozen=True, slots=True)
class FolderComparison:
    """The difference between two folders of runs."""

    plan: str
    first: Share  # successes in the first folder
    second: Share  # successes in the second folder
    causes: tuple[tuple[str, int, int], ...]  # of failures, with their counts in both, the largest change first
    paired: int  # number of pairs of runs
    mended: tuple[tuple[str, str], ...]  # names of pairs that fail in the first folder only
    broken: tuple[tuple[str, str], ...]  # names of pairs that fail in the second folder only

    @property
    def effect(self) -> float:
        """The success rate in the second folder minus that in the first; 0 if a folder has no run that ended."""
        a, b = self.first, self.second
        return b.succeeded / b.of - a.succeeded / a.of if a.of and b.of else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the effect."""
        return difference(self.second.succeeded, self.second.of, self.first.succeeded, self.first.of)

    def __bool__(self) -> bool:
        """Whether the runs end differently in the second folder."""
        shares = (self.first.succeeded, self.first.of) != (self.second.succeeded, self.second.of)
        return shares or bool(self.mended or self.broken) or any(a != b for _, a, b in self.causes)


def compare_folders(first: Runs, second: Runs, plan: str | None = None) -> FolderComparison:
    """Compare two folders of runs of one plan, by default the most frequent one of the first folder.

    Raises:
        ReplayError: a folder has no run of that plan.
    """
    chosen, _ = plan_of(first, plan)
    stats = [statistics(each, chosen) for each in (first, second)]
    for runs, each in zip((first, second), stats, strict=True):
        if not each.runs:
            raise ReplayError(f"{runs.path} has no run of {chosen!r}; runs of one plan are compared")
    before, after = _ended(first, chosen), _ended(second, chosen)
    both = sorted((before[given], after[given]) for given in before.keys() & after.keys())
    counts = [Counter({cause.cause: cause.count for cause in each.causes}) for each in stats]
    counted = [(cause, counts[0][cause], counts[1][cause]) for cause in counts[0] | counts[1]]
    return FolderComparison(
        chosen,
        stats[0].success,
        stats[1].success,
        tuple(sorted(counted, key=lambda each: (-abs(each[2] - each[1]), -max(each[1:]), each[0]))),
        len(both),
        tuple((a, b) for (a, before_ok), (b, after_ok) in both if after_ok and not before_ok),
        tuple((a, b) for (a, before_ok), (b, after_ok) in both if before_ok and not after_ok),
    )


def _ended(runs: Runs, plan: str) -> dict[tuple[str, str, str], tuple[str, bool]]:
    """Return name and success of runs by number, seed and parameters; runs of no sweep have their name as number."""
    rows = runs.sql(
        "SELECT coalesce(number::VARCHAR, run), seed, parameters::VARCHAR, run, succeeded FROM runs "
        "WHERE plan = ? AND succeeded IS NOT NULL",
        [plan],
    )
    return {(number, seed, given): (run, succeeded) for number, seed, given, run, succeeded in rows.rows()}


@report.data.register(FolderComparison)
def _(found: FolderComparison) -> dict[str, object]:
    facts = dataclasses.asdict(found)
    for name, share in (("first", found.first), ("second", found.second)):
        facts[name] |= {"interval": share.interval}
    facts["causes"] = [{"cause": cause, "first": a, "second": b} for cause, a, b in found.causes]
    return facts | {"effect": found.effect, "interval": list(found.interval)}


def lines(found: FolderComparison, first: Path, second: Path) -> Iterator[str]:
    """Yield a comparison as text, given the two folders."""

    def signed(share: float) -> str:
        return f"{'+' if share > 0 else ''}{percent(share) if share >= 0 else f'-{percent(-share)}'}"

    low, high = found.interval
    yield f"plan     {found.plan}"
    yield f"first    {found.first}: {first}"
    yield f"second   {found.second}: {second}"
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
