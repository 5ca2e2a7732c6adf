"""Statistics of many runs: success rates, causes of failures, and slow parts. The module also compares two folders.

A comparison pairs runs of both folders that have the same number, seed and parameters. Ends of paired runs differ
because something changed between the sweeps, or because a seed doesn't determine all values.
"""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.records import from_json
from replay.errors import ReplayError
from replay.report import report
from replay.report.phrases import percent, plural

if TYPE_CHECKING:
    from replay.runs.folder import Runs, Skipped

_Z: Final = 1.959963984540054  # quantile of the normal distribution that gives a 95 % interval
_MAX_VALUES: Final = 8  # at most this many values of a parameter are listed. More values are split into quarters.
_QUARTERS: Final = 4
_SLOWEST: Final = 10
_MAX_CAUSES: Final = 10  # maximum number of causes that are printed
_MAX_PAIRS: Final = 3  # maximum number of pairs of runs that are printed


@dataclass(frozen=True, slots=True)
class Share:
    """The success rate of some runs."""

    what: str  # description of the runs
    succeeded: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the rate."""
        return wilson(self.succeeded, self.of)

    def __str__(self) -> str:
        low, high = self.interval
        rate = percent(self.succeeded / self.of) if self.of else "none"
        return f"{self.succeeded} of {self.of} succeeded, {rate} (95 %: {percent(low)} to {percent(high)})"


@dataclass(frozen=True, slots=True)
class FailureCause:
    """The runs that failed for the same cause."""

    cause: str  # text of the cause, without its numbers
    count: int
    share: float  # share of this cause among all failures
    first: str  # name of the first run
    step: int | None  # step at which the failure of that run began, if known
    message: str  # message of the first run's failure
    runs: tuple[str, ...]  # names of all runs with this cause
    steps: tuple[int | None, ...]  # steps at which the failures began


@dataclass(frozen=True, slots=True)
class Slow:
    """A slow query, motion or task."""

    what: str  # name and objects
    count: int  # number of calls
    total: float  # total time in s, over all runs
    median: float  # median time in s
    longest: float  # longest time in s
    run: str  # name of the recording with the longest call
    step: int  # step of the longest call


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of a folder of recordings."""

    folder: str
    plan: str
    runs: tuple[str, ...]  # names of the recordings of the plan
    others: tuple[tuple[str, int], ...]  # number of recordings of other plans, which are left out
    skipped: tuple[Skipped, ...]  # files that are left out
    success: Share  # success rate of the runs that weren't interrupted
    outcomes: tuple[tuple[str, int], ...]  # number of runs, by outcome
    parameters: tuple[tuple[str, tuple[Share, ...]], ...]  # success rates, by parameter and value
    causes: tuple[FailureCause, ...]  # causes of failures, the most frequent first
    queries: tuple[Slow, ...]  # slow queries, by total time
    motions: tuple[Slow, ...]  # slow motions, by total time
    tasks: tuple[Slow, ...]  # other slow tasks, by total time
    seconds: tuple[float, float]  # median and longest duration of a run, s
    records: int  # number of records in all runs
    size: int  # number of bytes of all files


def plan_of(runs: Runs, name: str | None = None) -> tuple[str, tuple[tuple[str, int], ...]]:
    """Return the requested plan (by default the most frequent), and the number of runs of each other plan."""
    counts = runs.sql("SELECT plan, count(*) FROM runs GROUP BY plan ORDER BY count(*) DESC, plan").rows()
    chosen = name if name is not None else counts[0][0] if counts else ""
    return chosen, tuple((plan, count) for plan, count in counts if plan != chosen)


def names_of(runs: Runs, plan: str) -> tuple[str, ...]:
    """Return the names of a plan's recordings in order."""
    return tuple(name for (name,) in runs.sql("SELECT run FROM runs WHERE plan = ? ORDER BY run", [plan]).rows())


def statistics(runs: Runs, plan: str | None = None) -> Statistics:
    """Return the statistics of a plan's runs; by default, of the most frequent plan."""
    chosen, others = plan_of(runs, plan)
    rows = runs.sql(
        "SELECT run, CASE WHEN succeeded AND violated > 0 THEN 'succeeded but violated' ELSE outcome END, succeeded, "
        "parameters, cause, cause_step, message FROM runs WHERE plan = ? ORDER BY run",
        [chosen],
    ).rows()
    ended = [(ok, dict(given or ())) for _, _, ok, given, *_ in rows if ok is not None]
    names = dict.fromkeys(name for _, given in ended for name in given)
    parameters = ((name, _shares([(given[name], ok) for ok, given in ended if name in given])) for name in names)
    totals = runs.sql(
        "SELECT coalesce(median(seconds), 0), coalesce(max(seconds), 0), coalesce(sum(records), 0)::BIGINT, "
        "coalesce(sum(bytes), 0)::BIGINT FROM runs WHERE plan = ?",
        [chosen],
    ).rows()[0]
    return Statistics(
        folder=str(runs.path),
        plan=chosen,
        runs=tuple(row[0] for row in rows),
        others=others,
        skipped=runs.skipped,
        success=_share("all", [ok for ok, _ in ended]),
        outcomes=tuple(Counter(row[1] for row in rows).most_common()),
        parameters=tuple((name, shares) for name, shares in parameters if len(shares) > 1),
        causes=causes([(run, cause, step, message) for run, _, ok, _, cause, step, message in rows if ok is False]),
        queries=_slowest(runs, "queries", "name", "true", chosen),
        motions=_slowest(runs, "tasks", "label", "kind = 'motion'", chosen),
        tasks=_slowest(runs, "tasks", "label", "kind NOT IN ('motion', 'process-module')", chosen),
        seconds=(totals[0], totals[1]),
        records=totals[2],
        size=totals[3],
    )


def causes(failed: Sequence[tuple[str, str, int | None, str]]) -> tuple[FailureCause, ...]:
    """Return the causes of failures, the most frequent first.

    ``failed`` contains for each failed run its name, and the cause, first step and message of its failure.
    """
    found: dict[str, list[tuple[str, int | None, str]]] = {}
    for run, cause, step, message in failed:
        found.setdefault(cause, []).append((run, step, message))
    return tuple(
        FailureCause(cause, len(of), len(of) / len(failed), *of[0], *tuple(zip(*of, strict=True))[:2])
        for cause, of in sorted(found.items(), key=lambda each: (-len(each[1]), each[1][0][0]))
    )


def _shares(of: Sequence[tuple[str, bool]]) -> tuple[Share, ...]:
    """Return success rates, by value. Many different numbers are split into four ranges with equal numbers of runs."""

    def order(text: str) -> tuple[bool, float, str]:
        value = from_json(text)
        return (False, float(value), "") if isinstance(value, int | float) else (True, 0.0, text)

    values = sorted({text for text, _ in of}, key=order)
    numbers = [from_json(text) for text in values]
    if len(values) <= _MAX_VALUES:
        return tuple(_share(str(from_json(text)), [ok for value, ok in of if value == text]) for text in values)
    if not all(isinstance(each, int | float) for each in numbers):
        return ()
    ordered = sorted((float(str(from_json(text))), ok) for text, ok in of)
    cuts = [len(ordered) * quarter // _QUARTERS for quarter in range(_QUARTERS + 1)]
    parts = [ordered[a:b] for a, b in pairwise(cuts) if b > a]
    return tuple(_share(f"{part[0][0]:.3g} to {part[-1][0]:.3g}", [ok for _, ok in part]) for part in parts)


def _share(what: str, succeeded: Sequence[bool]) -> Share:
    return Share(what, sum(succeeded), len(succeeded))


def _slowest(runs: Runs, table: str, name: str, condition: str, plan: str) -> tuple[Slow, ...]:
    rows = runs.sql(
        f"SELECT t.{name}, count(*), sum(t.seconds), median(t.seconds), max(t.seconds), arg_max(t.run, t.seconds), "  # noqa: S608  the names are ours
        f"arg_max(t.step, t.seconds) FROM {table} t JOIN runs r USING (run) "
        f"WHERE r.plan = ? AND t.seconds IS NOT NULL AND {condition} GROUP BY 1 ORDER BY 3 DESC, 1 LIMIT {_SLOWEST}",
        [plan],
    )
    return tuple(Slow(*row) for row in rows.rows())


def wilson(count: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate (Wilson 1927, "Probable inference"); 0 to 1 without runs.

    The interval also holds for few runs and for rates near 0 and 1.
    """
    if of == 0:
        return 0.0, 1.0
    share, spread = count / of, _Z * _Z / of
    middle = (share + spread / 2) / (1 + spread)
    half = _Z / (1 + spread) * math.sqrt(share * (1 - share) / of + spread / (4 * of))
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return (0.0 if count == 0 else low), (1.0 if count == of else high)


def difference(a: int, of_a: int, b: int, of_b: int) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two rates (Newcombe 1998, method 10, from Wilson's intervals)."""
    first, second = (a / of_a if of_a else 0.0), (b / of_b if of_b else 0.0)
    (low_a, high_a), (low_b, high_b) = wilson(a, of_a), wilson(b, of_b)
    apart = first - second
    return apart - math.hypot(first - low_a, high_b - second), apart + math.hypot(high_a - first, second - low_b)


@dataclass(frozen=True, slots=True)
class FolderComparison:
    """The difference between two folders of runs."""

    plan: str
    first: Share  # success rate in the first folder
    second: Share  # success rate in the second folder
    causes: tuple[tuple[str, int, int], ...]  # causes with their counts in both folders, the largest changes first
    paired: int  # number of pairs of runs
    mended: tuple[tuple[str, str], ...]  # names of paired runs that failed only in the first folder
    broken: tuple[tuple[str, str], ...]  # names of paired runs that failed only in the second folder

    @property
    def effect(self) -> float:
        """The success rate in the second folder, minus the success rate in the first folder; 0 without rates."""
        a, b = self.first, self.second
        return b.succeeded / b.of - a.succeeded / a.of if a.of and b.of else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the effect."""
        return difference(self.second.succeeded, self.second.of, self.first.succeeded, self.first.of)

    def __bool__(self) -> bool:
        """Return whether runs end differently in the second folder."""
        shares = (self.first.succeeded, self.first.of) != (self.second.succeeded, self.second.of)
        return shares or bool(self.mended or self.broken) or any(a != b for _, a, b in self.causes)


def compare_folders(first: Runs, second: Runs) -> FolderComparison:
    """Compare the runs of a plan in two folders; raise ReplayError if a folder has no run of this plan.

    The plan is the most frequent plan of the first folder.
    """
    chosen, _ = plan_of(first)
    stats = [statistics(each, chosen) for each in (first, second)]
    for runs, each in zip((first, second), stats, strict=True):
        if not each.runs:
            raise ReplayError(f"{runs.path} has no run of {chosen!r}; only runs of the same plan are compared")
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
    """Return name and success of runs by number, seed and parameters. Outside of sweeps, names replace numbers."""
    rows = runs.sql(
        "SELECT coalesce(number::VARCHAR, run), seed, parameters::VARCHAR, run, succeeded FROM runs "
        "WHERE plan = ? AND succeeded IS NOT NULL",
        [plan],
    )
    return {(number, seed, given): (run, succeeded) for number, seed, given, run, succeeded in rows.rows()}


@report.data.register(Share)
def _(share: Share) -> dict[str, object]:
    return report.fields_data(share) | {"interval": list(share.interval)}


@report.data.register(FolderComparison)
def _(found: FolderComparison) -> dict[str, object]:
    causes = [{"cause": cause, "first": a, "second": b} for cause, a, b in found.causes]
    return report.fields_data(found) | {"causes": causes, "effect": found.effect, "interval": list(found.interval)}


def lines(found: FolderComparison, first: Path, second: Path) -> Iterator[str]:
    """Yield the comparison of two folders as text."""

    def signed(share: float) -> str:
        return f"{'+' if share > 0 else ''}{percent(share) if share >= 0 else f'-{percent(-share)}'}"

    low, high = found.interval
    yield f"plan     {found.plan}"
    yield f"first    {found.first}: {first}"
    yield f"second   {found.second}: {second}"
    yield f"change   {signed(found.effect)} (95 %: {signed(low)} to {signed(high)})"
    yield f"paired   {plural(found.paired, 'pair')} of runs with the same number, seed and parameters"
    folders = ("fail only in the first folder", found.mended), ("fail only in the second folder", found.broken)
    for what, pairs in folders:
        if pairs:
            yield from ("", f"{len(pairs)} of them {what}")
        for a, b in pairs[:_MAX_PAIRS]:
            yield f"  pycram-replay diff {shlex.quote(str(first / a))} {shlex.quote(str(second / b))}"
    if found.causes:
        yield from ("", "Failures by cause, first -> second")
    yield from (f"  {a:4} -> {b:<4} {cause}" for cause, a, b in found.causes[:_MAX_CAUSES])
    if len(found.causes) > _MAX_CAUSES:
        yield f"  {plural(len(found.causes) - _MAX_CAUSES, 'more cause')}"
