"""Facts that are true of some runs and false of others: values, and the ranges of numbers that separate best."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from replay.runs.intervals import difference, fisher

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from replay.runs.predicates import Case, Site

_MAX_VALUES: Final = 12  # different texts of a site that are compared one by one
_CUTS: Final = 16  # places at which the range of a number is cut, at most


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
        tests: how many facts of that site were compared to choose it.
        true: numbers of the runs that it is true of.
        known: numbers of the runs that got to the site.
    """

    kind: str
    text: str
    site: str
    failed: int
    failures: int
    succeeded: int
    successes: int
    step: float
    tests: int
    true: frozenset[int]
    known: frozenset[int]

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
    def chance(self) -> float:
        """How likely so large a difference is by chance, of this fact alone."""
        others = len(self.known) - len(self.true)
        return fisher(self.failed, len(self.true), self.failures - self.failed, others)

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


def facts_of(found: Sequence[Site], cases: Sequence[Case]) -> Iterator[Fact]:
    """Yield the facts of sites: each that is true of some runs, and false of others that got there."""
    for site in found:
        simple = {each.value for values in site.values.values() for each in values}
        numbers = [value for value in simple if isinstance(value, float)]
        if site.kind == "reached":
            yield from _reached(site, cases)
        elif len(numbers) == len(simple) and len(simple) > 2:
            yield from _ranges(site, cases)
        elif 1 < len(simple) <= _MAX_VALUES:
            yield from _values(site, cases, simple)


def _fact(
    site: Site, text: str, true: frozenset[int], known: frozenset[int], cases: Sequence[Case], tests: int
) -> Fact | None:
    """Return a fact; None where all runs are alike."""
    if not true or len(true) == len(known):
        return None
    failed, failures = (sum(cases[number].failed for number in each) for each in (true, known))
    steps = sorted(site.values[number][0].step for number in true if number in site.values)
    return Fact(
        site.kind,
        text,
        site.name,
        failed,
        failures,
        len(true) - failed,
        len(known) - failures,
        steps[len(steps) // 2] if steps else 0.0,
        tests,
        true,
        known,
    )


def _reached(site: Site, cases: Sequence[Case]) -> Iterator[Fact]:
    """Yield that runs got somewhere; of the others it is known that they didn't."""
    fact = _fact(site, site.name, frozenset(site.values), frozenset(range(len(cases))), cases, 1)
    if fact is not None:
        yield fact


def _values(site: Site, cases: Sequence[Case], simple: set[str | float | bool]) -> Iterator[Fact]:
    """Yield a fact for each value that a site had at some time in a run."""
    known = frozenset(site.values)
    for value in sorted(simple, key=str):
        true = frozenset(number for number in known if any(each.value == value for each in site.values[number]))
        fact = _fact(site, _value_text(site, value), true, known, cases, 1)
        if fact is not None:
            yield fact


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


def _ranges(site: Site, cases: Sequence[Case]) -> Iterator[Fact]:
    """Yield the range of a number that separates best, of those between some values that occur."""
    known = sorted(site.values)
    first = np.array([float(site.values[number][0].value) for number in known])
    order = np.argsort(first, kind="stable")
    values, failed = first[order], np.array([cases[number].failed for number in known])[order]
    starts = np.flatnonzero(np.diff(values)) + 1  # indices at which a new value begins
    if len(starts) > _CUTS:
        starts = starts[np.unique(np.linspace(0, len(starts) - 1, _CUTS).round().astype(int))]
    cuts = [0, *starts.tolist(), len(values)]
    sums = np.concatenate([[0], np.cumsum(failed)])
    total = int(sums[-1])
    best: tuple[float, int, int] | None = None
    tests = 0
    for at, low in enumerate(cuts):
        for high in cuts[at + 1 :]:
            if high - low == len(values):
                continue
            tests += 1
            inside, hits = high - low, int(sums[high] - sums[low])
            larger = hits * len(values) > total * inside
            chance = fisher(hits, inside, total - hits, len(values) - inside) if larger else 1.0
            if best is None or chance < best[0]:
                best = chance, low, high
    if best is None:  # it had one value only in the first place
        return
    _, low, high = best
    numbers = [known[at] for at in order]
    text = _range_text(site, values, low, high)
    fact = _fact(site, text, frozenset(numbers[low:high]), frozenset(known), cases, tests)
    if fact is not None:
        yield fact


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
