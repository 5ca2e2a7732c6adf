"""Statistics over many runs: how often they succeed, why they fail, and what takes long."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from recorder.records import from_json
from replay.report.phrases import percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from replay.runs.folder import Skipped
    from replay.runs.runs import Runs


_MAX_VALUES: Final = 8  # values of a parameter that are listed one by one; more numbers are split into quarters
_QUARTERS: Final = 4
_SLOWEST: Final = 10


@dataclass(frozen=True, slots=True)
class Share:
    """The success rate of some runs."""

    what: str  # which runs, in words
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

    cause: str  # without numbers
    count: int
    share: float  # of all failures
    first: str  # name of the first run
    step: int | None  # at which the first failure began, if known
    message: str  # of the first failure
    runs: tuple[str, ...]  # names of all
    steps: tuple[int | None, ...]  # at which their failures began


@dataclass(frozen=True, slots=True)
class Slow:
    """A query, motion or task that took long."""

    what: str  # its name and objects
    count: int  # how often it ran
    total: float  # s in all runs
    median: float  # s
    longest: float  # s
    run: str  # name of the recording with the longest
    step: int  # of the longest


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of a folder of recordings."""

    folder: str
    plan: str
    runs: tuple[str, ...]  # names of its recordings
    others: tuple[tuple[str, int], ...]  # number of recordings of each other plan, which are left out
    skipped: tuple[Skipped, ...]  # files that are left out
    success: Share  # of the runs that weren't interrupted
    outcomes: tuple[tuple[str, int], ...]  # number of runs by outcome
    parameters: tuple[tuple[str, tuple[Share, ...]], ...]  # success by the values of each parameter with several values
    causes: tuple[FailureCause, ...]  # of failures, the most frequent first
    queries: tuple[Slow, ...]  # by total time
    motions: tuple[Slow, ...]  # by total time
    tasks: tuple[Slow, ...]  # other tasks, by total time
    seconds: tuple[float, float]  # median and longest duration of a run, s
    records: int  # of all runs
    size: int  # of all files, bytes


def plan_of(runs: Runs, name: str | None = None) -> tuple[str, tuple[tuple[str, int], ...]]:
    """Return the requested plan, by default the most frequent one, and the number of runs of each other plan."""
    counts = runs.sql("SELECT plan, count(*) FROM runs GROUP BY plan ORDER BY count(*) DESC, plan").rows()
    chosen = name if name is not None else counts[0][0] if counts else ""
    return chosen, tuple((plan, count) for plan, count in counts if plan != chosen)


def names_of(runs: Runs, plan: str) -> tuple[str, ...]:
    """Return the names of a plan's recordings in order."""
    return tuple(name for (name,) in runs.sql("SELECT run FROM runs WHERE plan = ? ORDER BY run", [plan]).rows())


def statistics(runs: Runs, plan: str | None = None) -> Statistics:
    """Return the statistics of a plan's runs, by default of the most frequent plan."""
    chosen, others = plan_of(runs, plan)
    rows = runs.sql(
        "SELECT run, outcome, succeeded, parameters, cause, cause_step, message FROM runs WHERE plan = ? ORDER BY run",
        [chosen],
    ).rows()
    ended = [
        (run, succeeded, dict(parameters or ())) for run, _, succeeded, parameters, *_ in rows if succeeded is not None
    ]
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
        success=Share("all", sum(succeeded for _, succeeded, _ in ended), len(ended)),
        outcomes=tuple(Counter(row[1] for row in rows).most_common()),
        parameters=_by_parameter([(bool(succeeded), given) for _, succeeded, given in ended]),
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

    Args:
        failed: of each run its name, the cause, the step at which that began, and the failure's message.
    """
    found: dict[str, list[tuple[str, int | None, str]]] = {}
    for run, cause, step, message in failed:
        found.setdefault(cause, []).append((run, step, message))
    by_count = sorted(found.items(), key=lambda each: (-len(each[1]), each[1][0][0]))
    return tuple(
        FailureCause(
            cause,
            len(of),
            len(of) / len(failed),
            *of[0],
            tuple(run for run, _, _ in of),
            tuple(step for _, step, _ in of),
        )
        for cause, of in by_count
    )


def _by_parameter(ended: Sequence[tuple[bool, dict[str, str]]]) -> tuple[tuple[str, tuple[Share, ...]], ...]:
    found = []
    for name in dict.fromkeys(name for _, given in ended for name in given):
        of = [(given[name], succeeded) for succeeded, given in ended if name in given]
        shares = _shares(of)
        if len(shares) > 1:
            found.append((name, shares))
    return tuple(found)


def _shares(of: Sequence[tuple[str, bool]]) -> tuple[Share, ...]:
    """Return success by value; many numbers are split into quarters of the runs."""

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


_Z: Final = 1.959963984540054  # of 95 %


def wilson(count: int, of: int, z: float = _Z) -> tuple[float, float]:
    """Return the 95 % interval of a rate (Wilson 1927, "Probable inference"); 0 to 1 without runs.

    Unlike the normal approximation, it holds for few runs and for rates near 0 and 1.
    """
    if of == 0:
        return 0.0, 1.0
    share, spread = count / of, z * z / of
    middle = (share + spread / 2) / (1 + spread)
    half = z / (1 + spread) * math.sqrt(share * (1 - share) / of + spread / (4 * of))
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return (0.0 if count == 0 else low), (1.0 if count == of else high)


def difference(a: int, of_a: int, b: int, of_b: int) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two rates (Newcombe 1998, method 10, from Wilson's intervals)."""
    first, second = (a / of_a if of_a else 0.0), (b / of_b if of_b else 0.0)
    (low_a, high_a), (low_b, high_b) = wilson(a, of_a), wilson(b, of_b)
    apart = first - second
    return apart - math.hypot(first - low_a, high_b - second), apart + math.hypot(high_a - first, second - low_b)
