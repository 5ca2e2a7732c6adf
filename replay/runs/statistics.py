"""Statistics over many runs: how often they succeed, of what they fail, and what takes long."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from recorder.records import from_json
from replay.runs.intervals import wilson

if TYPE_CHECKING:
    from collections.abc import Sequence

    from replay.runs.folder import Skipped
    from replay.runs.runs import Runs

_MAX_VALUES: Final = 8  # of a parameter that are listed one by one; numbers with more are cut into quarters
_QUARTERS: Final = 4
_SLOWEST: Final = 10


@dataclass(frozen=True, slots=True)
class Share:
    """How many of some runs succeeded.

    Attributes:
        what: which runs, in words.
        succeeded: how many did.
        of: how many there are.
    """

    what: str
    succeeded: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the share."""
        return wilson(self.succeeded, self.of)


@dataclass(frozen=True, slots=True)
class FailureCause:
    """Runs that failed of the same.

    Attributes:
        cause: in words, without numbers.
        count: how many.
        share: of all failures.
        first: name of the first one's file.
        step: where its failure began; None if that isn't known.
        message: of that one's failure.
        runs: names of all.
        steps: where the failures of these began.
    """

    cause: str
    count: int
    share: float
    first: str
    step: int | None
    message: str
    runs: tuple[str, ...]
    steps: tuple[int | None, ...]


@dataclass(frozen=True, slots=True)
class Slow:
    """What took long.

    Attributes:
        what: a query, motion or task, with its objects.
        count: how often it ran.
        total: s in all runs.
        median: s.
        longest: s.
        run: name of the recording of the longest.
        step: of it.
    """

    what: str
    count: int
    total: float
    median: float
    longest: float
    run: str
    step: int


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of a folder of recordings.

    Attributes:
        folder: the folder.
        plan: name of the plan.
        runs: names of its recordings.
        others: recordings of other plans, which are left out, by the plans' names.
        skipped: files that can't be read, or were left out else.
        success: of the runs that weren't interrupted.
        outcomes: how many runs ended how.
        parameters: success by the values of each parameter that has several.
        causes: of failures, the commonest first.
        queries: that took longest in all.
        motions: that took longest in all.
        tasks: others that took longest in all.
        seconds: median, and longest, of a run, s.
        records: of all runs.
        size: of all files, bytes.
    """

    folder: str
    plan: str
    runs: tuple[str, ...]
    others: tuple[tuple[str, int], ...]
    skipped: tuple[Skipped, ...]
    success: Share
    outcomes: tuple[tuple[str, int], ...]
    parameters: tuple[tuple[str, tuple[Share, ...]], ...]
    causes: tuple[FailureCause, ...]
    queries: tuple[Slow, ...]
    motions: tuple[Slow, ...]
    tasks: tuple[Slow, ...]
    seconds: tuple[float, float]
    records: int
    size: int


def plan_of(runs: Runs, name: str | None = None) -> tuple[str, tuple[tuple[str, int], ...]]:
    """Return the plan that most runs are of, or the one that is asked for, and how many runs are of each other one."""
    counts = runs.sql("SELECT plan, count(*) FROM runs GROUP BY plan ORDER BY count(*) DESC, plan").rows()
    chosen = name if name is not None else counts[0][0] if counts else ""
    return chosen, tuple((plan, count) for plan, count in counts if plan != chosen)


def names_of(runs: Runs, plan: str) -> tuple[str, ...]:
    """Return the names of a plan's recordings, in order."""
    return tuple(name for (name,) in runs.sql("SELECT run FROM runs WHERE plan = ? ORDER BY run", [plan]).rows())


def statistics(runs: Runs, plan: str | None = None) -> Statistics:
    """Return the statistics of a plan's runs, by default of the plan that most are of."""
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
    """Return the causes of failures, the commonest first.

    Args:
        failed: of each run: its name, the cause, the step at which that began, and the failure's message.
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
    """Return success by values; those of a number that has many are cut into quarters of the runs."""
    values = sorted({text for text, _ in of}, key=_sorting)
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


def _sorting(text: str) -> tuple[bool, float, str]:
    value = from_json(text)
    return (False, float(value), "") if isinstance(value, int | float) else (True, 0.0, text)


def _slowest(runs: Runs, table: str, name: str, condition: str, plan: str) -> tuple[Slow, ...]:
    rows = runs.sql(
        f"SELECT t.{name}, count(*), sum(t.seconds), median(t.seconds), max(t.seconds), arg_max(t.run, t.seconds), "  # noqa: S608  the names are ours
        f"arg_max(t.step, t.seconds) FROM {table} t JOIN runs r USING (run) "
        f"WHERE r.plan = ? AND t.seconds IS NOT NULL AND {condition} GROUP BY 1 ORDER BY 3 DESC, 1 LIMIT {_SLOWEST}",
        [plan],
    )
    return tuple(Slow(*row) for row in rows.rows())
