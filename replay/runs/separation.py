"""What separates runs that failed from those that succeeded, by the facts that are on record of them.

Each fact that is true of some runs and false of others is scored as in spectrum-based fault localisation: Ochiai and
Tarantula (Abreu et al. 2007; Jones and Harrold 2005). Facts are compared with the other runs that got to the same
site, so that what merely comes before a failure has no score (Liblit et al. 2005: "context"), and what tells how far
runs got ranks below all that doesn't. A claim is made only
where failures that are dealt to the runs at random would make any in less than one of a hundred folders
(:mod:`replay.runs.chance`). Facts that are true of the same runs are one claim.

Facts that are true of some runs and false of others: values, and the ranges of numbers that separate best.

Some facts tell how far failed runs got, which may be a symptom of their end: that they came to a task, what was chosen
last where a success goes on to choose, what only a third attempt has (:attr:`Fact.how_far`).

How surprising it is that something is true of so many failures, where very much is compared.

The failures are dealt anew to the runs at random, many times; each time the strongest evidence of all facts is kept:
what chance alone would find (Westfall and Young 1993, "Resampling-based multiple testing", the single-step maximum).
Facts that are true of nearly the same runs, as the ranges of a number, so count little more than one of them, and no
claim is made without a cause in more than the share of folders that is asked for.

The evidence is the log-likelihood ratio of two shares of failures against one (the G-test's statistic, halved).
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from replay.runs.predicates import PRESENT, ComparedRun, Site, sites
from replay.runs.statistics import difference

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from replay.runs.runs import Runs


LEVEL: Final = 0.01
"""Chance that any claim is made where nothing separates."""
_ORDER: Final = ("parameter", "pose", "choice", "motion", "query", "order", "event", "happened", "reached")


@dataclass(frozen=True, slots=True)
class Claim:
    """A fact that separates, with those that are true of the same runs."""

    fact: Fact  # the first of them; one of progress only if all are
    also: tuple[str, ...]  # the other facts, in words
    ochiai: float  # score, 0 to 1
    chance: float  # probability of a claim this strong if nothing separates the runs
    failure: str  # a failed run of which the fact is true
    success: str  # a similar successful run of which the fact is false, or ""


@dataclass(frozen=True, slots=True)
class Separation:
    """The facts that separate failures from successes."""

    cases: tuple[ComparedRun, ...]
    claims: tuple[Claim, ...]  # the strongest first; facts of progress last
    compared: int  # number of compared facts
    explained: int  # number of failed runs of which a claim is true

    @property
    def failures(self) -> int:
        """Number of failed runs."""
        return sum(case.failed for case in self.cases)

    @property
    def successes(self) -> int:
        """Number of successful runs."""
        return len(self.cases) - self.failures


def separate(runs: Runs, names: Sequence[str] | None = None, cause: str | None = None) -> Separation:
    """Return the facts that separate failed from successful runs.

    Args:
        runs: the folder of the runs.
        names: names of the runs to compare; by default all.
        cause: cause of the failures to compare with the successes; by default all.
    """
    cases = _cases(runs, names, cause)
    return _separation(cases, list(compared_of(sites(runs, cases), cases)))


def _cases(runs: Runs, names: Sequence[str] | None, cause: str | None) -> tuple[ComparedRun, ...]:
    wanted = None if names is None else set(names)
    rows = runs.sql(
        "SELECT run, succeeded, cause, coalesce(q.step - 1, cause_step), records FROM runs r LEFT JOIN "
        "(SELECT f.run, max(f.step) AS step FROM failures f JOIN failures t USING (run, task, type, message) "
        "WHERE f.of = 'query' AND t.root AND f.step <= t.step GROUP BY 1) q USING (run) "
        "WHERE succeeded IS NOT NULL ORDER BY run"  # a query that raised the failure is the failure, not its cause
    )
    return tuple(
        ComparedRun(run, not succeeded, records if succeeded or step is None else step)
        for run, succeeded, why, step, records in rows.rows()
        if (wanted is None or run in wanted) and (succeeded or cause is None or why == cause)
    )


def _separation(cases: tuple[ComparedRun, ...], found: list[Compared]) -> Separation:
    failing = np.array([case.failed for case in cases])
    compared = sum(len(each.true) for each in found)
    if not failing.any() or failing.all():
        return Separation(cases, (), compared, 0)
    failures = int(failing.sum())
    facts = [fact for each in found for fact in each.facts(failing)]
    by_chance = Chance(((each.known, each.true) for each in found), failing)
    strong = [
        (fact, chance)
        for fact in facts
        if fact.evidence and (chance := by_chance.of(fact.evidence)) < LEVEL and fact.interval[0] > 0
    ]
    groups: dict[tuple[frozenset[int], ...], list[tuple[Fact, float]]] = defaultdict(list)
    failed = frozenset(np.flatnonzero(failing).tolist())
    for fact, chance in strong:
        groups[fact.true & failed, fact.true - failed].append((fact, chance))
    claims = []
    for alike in groups.values():
        alike.sort(key=lambda each: (each[0].how_far, _ORDER.index(each[0].kind), each[0].step))
        fact, _ = alike[0]
        chance = min(chance for _, chance in alike)
        also = tuple(other.text for other, _ in alike[1:])
        claims.append(Claim(fact, also, fact.ochiai(failures), chance, *_pair(fact, facts, cases)))
    claims.sort(  # facts of progress come last, however well they separate
        key=lambda each: (each.fact.how_far, -round(each.ochiai, 6), _ORDER.index(each.fact.kind), each.fact.step)
    )
    explained = len(frozenset().union(*(claim.fact.true & failed for claim in claims)))
    return Separation(cases, tuple(claims), compared, explained)


def _pair(fact: Fact, facts: Sequence[Fact], cases: Sequence[ComparedRun]) -> tuple[str, str]:
    """Return a failed run of which a fact is true, and the most similar successful run of which it is false."""
    failed = [number for number in sorted(fact.true) if cases[number].failed]
    others = [number for number in sorted(fact.known - fact.true) if not cases[number].failed]
    if not others:
        return cases[failed[0]].run, ""
    alike: Counter[tuple[int, int]] = Counter()
    for a in failed[:5]:
        for other in facts:
            if a in other.known:
                for b in others:
                    alike[a, b] += b in other.known and (a in other.true) == (b in other.true)
    a, b = max(((a, b) for a in failed[:5] for b in others), key=lambda pair: (alike[pair], -pair[0], -pair[1]))
    return cases[a].run, cases[b].run


_MAX_VALUES: Final = 12  # different texts of a site that are compared one by one
_CUTS: Final = 16  # places at which the range of a number is cut, at most
_LARGE: Final = 0.71  # how often a number of one kind exceeds one of another (Vargha and Delaney 2000: a large effect)


@dataclass(frozen=True, slots=True)
class Fact:
    """A statement that is true of some runs and false of others that reached the same site."""

    kind: str  # of its site
    text: str  # as "arm=right at pick-up(spoon)"
    site: str  # name of its site
    failed: int  # number of failed runs of which it is true
    failures: int  # number of failed runs that reached the site
    succeeded: int  # number of successful runs of which it is true
    successes: int  # number of successful runs that reached the site
    step: float  # median of the first steps at which it is known
    evidence: float  # how strongly it correlates with failing
    true: frozenset[int]  # numbers of the runs of which it is true
    known: frozenset[int]  # numbers of the runs that reached the site
    how_far: bool  # whether it only tells how far the failed runs got

    def ochiai(self, failures: int) -> float:
        """Return the score of Ochiai, 0 to 1, given the number of all failed runs."""
        return self.failed / math.sqrt(failures * (self.failed + self.succeeded)) if self.failed else 0.0

    @property
    def tarantula(self) -> float:
        """The score of Tarantula, 0 to 1."""
        failed = self.failed / self.failures if self.failures else 0.0
        succeeded = self.succeeded / self.successes if self.successes else 0.0
        return failed / (failed + succeeded) if failed else 0.0

    @property
    def effect(self) -> float:
        """The failure rate of runs of which it is true, minus that of other runs."""
        others = len(self.known) - len(self.true)
        false = (self.failures - self.failed) / others if others else 0.0
        return self.failed / len(self.true) - false

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the effect."""
        others = len(self.known) - len(self.true)
        return difference(self.failed, len(self.true), self.failures - self.failed, others)


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """The facts of a site."""

    site: Site
    known: RunNumbers  # numbers of the runs that reached the site
    true: Truth  # whether a fact (row) is true of one of these runs (column)
    text: Callable[[int], str]  # returns a fact in words
    #: Returns the number, from 1, of the value in a run that makes a fact true.
    turn: Callable[[int, int], int] = lambda _row, _run: 1
    best: bool = False  # whether only the strongest fact counts, as of ranges of a number
    whole: Site | None = None  # the site with all values, if the last values are compared

    def facts(self, failed: Truth) -> Iterator[Fact]:
        """Yield the facts that count."""
        here = failed[self.known]
        found = evidence(self.true, here)[:, 0]
        for row in [int(found.argmax())] if self.best else range(len(found)):
            true = self.known[self.true[row]].tolist()
            steps = sorted(self.site.values[number][0].step for number in true if number in self.site.values)
            hits, failures = int(here[self.true[row]].sum()), int(here.sum())
            yield Fact(
                self.site.kind,
                self.text(row),
                self.site.name,
                hits,
                failures,
                len(true) - hits,
                len(here) - failures,
                steps[len(steps) // 2] if steps else 0.0,
                float(found[row]),
                frozenset(true),
                frozenset(self.known.tolist()),
                bool(found[row] > 0) and self._how_far(row, failed),
            )

    def _how_far(self, row: int, failed: Truth) -> bool:
        """Return whether failed runs have it from a turn that successes rarely reach, or where these go on."""
        if self.site.kind in PRESENT:
            return self.site.kind == "reached"
        values = (self.whole or self.site).values
        true = self.known[self.true[row] & failed[self.known]].tolist()
        turns = [len(values[run]) if self.whole else self.turn(row, run) for run in true]
        successes = np.sort([len(values[run]) for run in self.known[~failed[self.known]].tolist()])
        if not len(successes):
            return False
        shorter, no_longer = np.searchsorted(successes, turns), np.searchsorted(successes, turns, side="right")
        effect = (shorter.mean() + no_longer.mean()) / 2 / len(successes)
        return bool(effect >= _LARGE or (self.whole is not None and effect <= 1 - _LARGE))


def compared_of(found: Sequence[Site], cases: Sequence[ComparedRun]) -> Iterator[Compared]:
    """Yield the facts of sites that are true of some runs and false of others that reached the site."""
    for each in found:
        for site in (each, _last(each)):
            if site is None:
                continue
            simple = {each.value for values in site.values.values() for each in values}
            numbers = [value for value in simple if isinstance(value, float)]
            if site.kind in PRESENT:
                compared = _reached(site, len(cases))
            elif len(numbers) == len(simple) and len(simple) > 2:
                compared = _ranges(site)
            elif 1 < len(simple) <= _MAX_VALUES:
                compared = _values(site, sorted(simple, key=str))
            else:
                continue
            some = compared.true.any(axis=1) & ~compared.true.all(axis=1)
            if some.any():
                yield _picked(compared, np.flatnonzero(some), whole=None if site is each else each)


def _picked(compared: Compared, rows: RunNumbers, *, whole: Site | None) -> Compared:
    return replace(
        compared,
        true=compared.true[rows],
        text=lambda row: compared.text(int(rows[row])),
        turn=lambda row, run: compared.turn(int(rows[row]), run),
        whole=whole,
    )


def _last(site: Site) -> Site | None:
    """Return the site with only the last value of each run, which was in force when it failed.

    None if no run has several values.
    """
    if site.kind in {*PRESENT, "order"} or all(len({each.value for each in got}) == 1 for got in site.values.values()):
        return None
    if site.kind == "choice":
        name = f"{site.name} last"
    else:
        before, at, where = site.name.partition(" at ")
        name = f"{before} at the last {where}" if at else f"the last {site.name}"
    return Site(site.kind, name, {number: got[-1:] for number, got in site.values.items()})


def _reached(site: Site, runs: int) -> Compared:
    """Compare whether runs reached a site."""
    true = np.zeros((1, runs), dtype=np.bool_)
    true[0, list(site.values)] = True
    return Compared(site, np.arange(runs), true, lambda _: site.name)


def _values(site: Site, simple: Sequence[str | float | bool]) -> Compared:
    """Compare whether a site ever had each value."""
    known = sorted(site.values)
    had = [{each.value for each in site.values[number]} for number in known]
    true = np.array([[value in values for values in had] for value in simple])

    def turn(row: int, run: int) -> int:
        return 1 + [each.value for each in site.values[run]].index(simple[row])

    return Compared(site, np.array(known), true, lambda row: _value_text(site, simple[row]), turn)


def _value_text(site: Site, value: str | float | bool) -> str:
    if site.kind == "order":
        first, _, second = site.name.partition(" before ")
        return site.name if value else f"{second} before {first}"
    shown = (
        ("true" if value else "false")
        if isinstance(value, bool)
        else f"{value:g}"
        if isinstance(value, float)
        else value
    )
    if site.kind in ("query", "event"):
        return f"{site.name} -> {shown}"
    name, at, where = site.name.partition(" at ")
    return f"{name}={shown}{at}{where}"


def _ranges(site: Site) -> Compared:
    """Compare the ranges of a number between values that occur."""
    known = np.array(sorted(site.values))
    first = np.array([float(site.values[number][0].value) for number in known.tolist()])
    values = np.sort(first)
    starts = np.flatnonzero(np.diff(values)) + 1  # indices at which a new value begins
    if len(starts) > _CUTS:
        starts = starts[np.unique(np.linspace(0, len(starts) - 1, _CUTS).round().astype(int))]
    cuts = [0, *starts.tolist(), len(values)]
    ends = [(low, high) for at, low in enumerate(cuts) for high in cuts[at + 1 :]]
    true = np.array([(first >= values[low]) & (first <= values[high - 1]) for low, high in ends])
    return Compared(site, known, true, lambda row: _range_text(site, values, *ends[row]), best=True)


def _range_text(site: Site, values: np.ndarray, low: int, high: int) -> str:
    """Return a range in words; its ends are halfway between values that occur."""
    name, at, where = site.name.partition(" at ")
    if values[low] == values[high - 1]:
        return f"{name}={values[low]:g}{at}{where}"
    above = _between(values[low - 1], values[low]) if low else ""
    below = _between(values[high - 1], values[high]) if high < len(values) else ""
    text = f"{above} < {name} < {below}" if above and below else f"{name} > {above}" if above else f"{name} < {below}"
    return f"{text}{at}{where}"


def _between(a: float, b: float) -> str:
    """Return a number between two others with the fewest digits."""
    texts = (f"{(a + b) / 2:.{digits}g}" for digits in range(2, 17))
    return next((text for text in texts if a < float(text) < b), repr((a + b) / 2))


Truth = NDArray[np.bool_]
RunNumbers = NDArray[np.intp]

_ROUNDS: Final = 1000
_LEAST: Final = 200  # rounds, if there are many facts of many runs
_WORK: Final = 2e10  # multiplications at most
_ROWS: Final = 1000  # facts that are looked at together


def evidence(true: Truth, failed: Truth) -> NDArray[np.float64]:
    """Return how strongly facts correlate with failing; 0 without a higher failure rate.

    Args:
        true: whether a fact (row) is true of a run (column).
        failed: whether each of these runs failed; one column for each permutation.
    """
    count, inside = true.shape[1], true.sum(axis=1, dtype=np.int64)[:, None]
    labels = failed.reshape(count, -1)
    failures = labels.sum(axis=0, dtype=np.int64)[None, :]
    hits = np.rint(true.astype(np.float32) @ labels.astype(np.float32)).astype(np.int64)
    counts = np.arange(count + 1, dtype=np.float64)
    log = counts * np.log(np.maximum(counts, 1))  # n log n
    cells = log[hits] + log[inside - hits] + log[failures - hits] + log[count - inside - failures + hits]
    margins = log[inside] + log[count - inside] + log[failures] + log[count - failures]
    ratio: NDArray[np.float64] = np.where(hits * count > failures * inside, cells - margins + log[count], 0.0)
    return ratio


class Chance:
    """The strongest evidence in random permutations of the failures.

    Args:
        facts: numbers of the runs that reached a site, and a row for each fact of it.
        failed: whether each run failed.
    """

    def __init__(self, facts: Iterable[tuple[RunNumbers, Truth]], failed: Truth) -> None:
        alike: dict[bytes, list[tuple[RunNumbers, Truth]]] = defaultdict(list)
        for known, true in facts:
            alike[known.tobytes()].append((known, true))
        groups = [
            (each[0][0], np.unique(np.concatenate([true for _, true in each]), axis=0)) for each in alike.values()
        ]
        work = sum(true.size for _, true in groups)
        rounds = int(min(_ROUNDS, max(_LEAST, _WORK / max(work, 1))))
        dice = np.random.default_rng(0)  # the same answer each time
        dealt = dice.permuted(np.tile(failed, (rounds, 1)), axis=1).T
        strongest: NDArray[Any] = np.zeros(rounds)
        for known, true in groups:
            for start in range(0, len(true), _ROWS):
                found = evidence(true[start : start + _ROWS], dealt[known])
                np.maximum(strongest, found.max(axis=0), out=strongest)
        self._strongest = np.sort(strongest)

    def of(self, strength: float) -> float:
        """Return the probability that chance alone finds any fact with so much evidence."""
        as_strong = len(self._strongest) - int(np.searchsorted(self._strongest, strength - 1e-9))
        return (1 + as_strong) / (1 + len(self._strongest))
