"""Facts that are true of some runs and false of others: values, and the ranges of numbers that separate best.

Some facts tell how far failed runs got, which may be a symptom of their end: that they came to a task, what was chosen
last where a success goes on to choose, what only a third attempt has (:attr:`Fact.how_far`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from replay.runs.chance import evidence
from replay.runs.intervals import difference
from replay.runs.predicates import PRESENT, Site

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from replay.runs.chance import Runs, Truth
    from replay.runs.predicates import Case

_MAX_VALUES: Final = 12  # different texts of a site that are compared one by one
_CUTS: Final = 16  # places at which the range of a number is cut, at most
_LARGE: Final = 0.71  # how often a number of one kind exceeds one of another (Vargha and Delaney 2000: a large effect)


@dataclass(frozen=True, slots=True)
class Fact:
    """Something that is true of some runs, and false of others that got to the same site.

    Attributes:
        kind: of its site.
        text: in words, as "arm=right at pick-up(spoon)".
        site: name of its site.
        failed: how many failed runs it is true of.
        failures: how many failed runs got to the site.
        succeeded: how many successful runs it is true of.
        successes: how many successful runs got to the site.
        step: the first step at which it is known, in the middle of the runs.
        evidence: how strongly it goes along with failing; see :mod:`replay.runs.chance`.
        true: numbers of the runs that it is true of.
        known: numbers of the runs that got to the site.
        how_far: whether it tells how far the failed runs got, rather than what went before their failures.
    """

    kind: str
    text: str
    site: str
    failed: int
    failures: int
    succeeded: int
    successes: int
    step: float
    evidence: float
    true: frozenset[int]
    known: frozenset[int]
    how_far: bool

    def ochiai(self, failures: int) -> float:
        """Return the score of Ochiai, 0 to 1, among so many failed runs in all."""
        return self.failed / math.sqrt(failures * (self.failed + self.succeeded)) if self.failed else 0.0

    @property
    def tarantula(self) -> float:
        """The score of Tarantula, 0 to 1."""
        failed = self.failed / self.failures if self.failures else 0.0
        succeeded = self.succeeded / self.successes if self.successes else 0.0
        return failed / (failed + succeeded) if failed else 0.0

    @property
    def effect(self) -> float:
        """By how much the share of failures is larger where it is true."""
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
    """The facts of a site that are compared.

    Attributes:
        site: the site.
        known: numbers of the runs that got there.
        true: a row for each fact: of which of these runs it is true.
        text: returns a fact in words.
        turn: returns which of a run's values, from 1, makes a fact true of it.
        best: whether only the strongest one is of interest, as of ranges of a number.
        whole: the site with all values, where those that runs had at last are compared.
    """

    site: Site
    known: Runs
    true: Truth
    text: Callable[[int], str]
    turn: Callable[[int, int], int] = lambda _row, _run: 1
    best: bool = False
    whole: Site | None = None

    def facts(self, failed: Truth) -> Iterator[Fact]:
        """Yield those that are of interest."""
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
        """Return whether failed runs have it from a turn that successes rarely get to, or at last where these go on."""
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


def compared_of(found: Sequence[Site], cases: Sequence[Case]) -> Iterator[Compared]:
    """Yield what is compared of sites: facts that are true of some runs, and false of others that got there."""
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


def _picked(compared: Compared, rows: Runs, *, whole: Site | None) -> Compared:
    return replace(
        compared,
        true=compared.true[rows],
        text=lambda row: compared.text(int(rows[row])),
        turn=lambda row, run: compared.turn(int(rows[row]), run),
        whole=whole,
    )


def _last(site: Site) -> Site | None:
    """Return what a site had at last, which is what was in force when it failed; None where that is all that it had."""
    if site.kind in {*PRESENT, "order"} or all(len({each.value for each in got}) == 1 for got in site.values.values()):
        return None
    if site.kind == "choice":
        name = f"{site.name} last"
    else:
        before, at, where = site.name.partition(" at ")
        name = f"{before} at the last {where}" if at else f"the last {site.name}"
    return Site(site.kind, name, {number: got[-1:] for number, got in site.values.items()})


def _reached(site: Site, runs: int) -> Compared:
    """Compare that runs got somewhere; of the others it is known that they didn't."""
    true = np.zeros((1, runs), dtype=np.bool_)
    true[0, list(site.values)] = True
    return Compared(site, np.arange(runs), true, lambda _: site.name)


def _values(site: Site, simple: Sequence[str | float | bool]) -> Compared:
    """Compare each value that a site had at some time in a run."""
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
    """Compare the ranges of a number between some values that occur."""
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
    """Return a range in words: its ends lie in the middle between values that occur."""
    name, at, where = site.name.partition(" at ")
    if values[low] == values[high - 1]:
        return f"{name}={values[low]:g}{at}{where}"
    above = _between(values[low - 1], values[low]) if low else ""
    below = _between(values[high - 1], values[high]) if high < len(values) else ""
    text = f"{above} < {name} < {below}" if above and below else f"{name} > {above}" if above else f"{name} < {below}"
    return f"{text}{at}{where}"


def _between(a: float, b: float) -> str:
    """Return a number between two others with as few digits as it takes."""
    texts = (f"{(a + b) / 2:.{digits}g}" for digits in range(2, 17))
    return next((text for text in texts if a < float(text) < b), repr((a + b) / 2))
