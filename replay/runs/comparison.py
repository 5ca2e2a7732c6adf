"""Two folders of runs compared: how often each succeeds, of what each fails, and which runs end otherwise.

Runs of both sweeps that were given the same (number, seed and parameters) are paired: what differs between these is
what was changed between the sweeps, such as the plan, or what isn't determined by a seed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from replay.errors import ReplayError
from replay.runs.intervals import difference
from replay.runs.statistics import Share, plan_of, statistics

if TYPE_CHECKING:
    from replay.runs.runs import Runs
    from replay.runs.statistics import Statistics


@dataclass(frozen=True, slots=True)
class FolderComparison:
    """What is different between two folders of runs.

    Attributes:
        plan: name of the plan.
        first: successes in the first folder.
        second: successes in the second one.
        causes: of failures, each with its counts in both, the largest change first.
        paired: how many runs of the first were given the same as one of the second.
        mended: of these, the names of those that failed in the first and succeed in the second.
        broken: the names of those that succeeded in the first and fail in the second.
    """

    plan: str
    first: Share
    second: Share
    causes: tuple[tuple[str, int, int], ...]
    paired: int
    mended: tuple[tuple[str, str], ...]
    broken: tuple[tuple[str, str], ...]

    @property
    def effect(self) -> float:
        """By how much the share of successes is larger in the second; 0 where one has no run that ended."""
        a, b = self.first, self.second
        return b.succeeded / b.of - a.succeeded / a.of if a.of and b.of else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of that."""
        return difference(self.second.succeeded, self.second.of, self.first.succeeded, self.first.of)

    def __bool__(self) -> bool:
        """Whether the runs end otherwise in the second folder."""
        shares = (self.first.succeeded, self.first.of) != (self.second.succeeded, self.second.of)
        return shares or bool(self.mended or self.broken) or any(a != b for _, a, b in self.causes)


def compare_folders(first: Runs, second: Runs, plan: str | None = None) -> FolderComparison:
    """Return what is different between two folders of runs of one plan.

    Args:
        first: the runs before.
        second: the runs after.
        plan: its name; by default of the plan that most of the first are of.

    Raises:
        ReplayError: one of them has no run of that plan.
    """
    chosen, _ = plan_of(first, plan)
    stats = [statistics(each, chosen) for each in (first, second)]
    for runs, each in zip((first, second), stats, strict=True):
        if not each.runs:
            raise ReplayError(f"{runs.path} has no run of {chosen!r}; runs of one plan are compared")
    before, after = _ended(first, chosen), _ended(second, chosen)
    both = sorted((before[given], after[given]) for given in before.keys() & after.keys())
    return FolderComparison(
        chosen,
        stats[0].success,
        stats[1].success,
        _causes(*stats),
        len(both),
        tuple((a, b) for (a, before_ok), (b, after_ok) in both if after_ok and not before_ok),
        tuple((a, b) for (a, before_ok), (b, after_ok) in both if before_ok and not after_ok),
    )


def _ended(runs: Runs, plan: str) -> dict[tuple[str, str, str], tuple[str, bool]]:
    """Return name and success of runs, by what they were given; those of no sweep go by their names, too."""
    rows = runs.sql(
        "SELECT coalesce(number::VARCHAR, run), seed, parameters::VARCHAR, run, succeeded FROM runs "
        "WHERE plan = ? AND succeeded IS NOT NULL",
        [plan],
    )
    return {(number, seed, given): (run, succeeded) for number, seed, given, run, succeeded in rows.rows()}


def _causes(first: Statistics, second: Statistics) -> tuple[tuple[str, int, int], ...]:
    before, after = (Counter({cause.cause: cause.count for cause in stats.causes}) for stats in (first, second))
    found = [(cause, before[cause], after[cause]) for cause in before | after]
    return tuple(sorted(found, key=lambda each: (-abs(each[2] - each[1]), -max(each[1:]), each[0])))
