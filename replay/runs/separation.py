"""What separates runs that failed from those that succeeded, by the facts that are on record of them.

Each fact that is true of some runs and false of others is scored as in spectrum-based fault localisation: Ochiai and
Tarantula (Abreu et al. 2007; Jones and Harrold 2005). Facts are compared with the other runs that got to the same
site, so that what merely comes before a failure has no score (Liblit et al. 2005: "context"), and what tells how far
runs got ranks below all that doesn't. A claim is made only
where failures that are dealt to the runs at random would make any in less than one of a hundred folders
(:mod:`replay.runs.chance`). Facts that are true of the same runs are one claim.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from replay.runs.chance import Chance
from replay.runs.facts import compared_of
from replay.runs.predicates import Case, sites

if TYPE_CHECKING:
    from collections.abc import Sequence

    from replay.runs.facts import Compared, Fact
    from replay.runs.runs import Runs

LEVEL: Final = 0.01
"""Chance that any claim is made where nothing separates."""
_ORDER: Final = ("parameter", "pose", "choice", "motion", "query", "order", "event", "happened", "reached")


@dataclass(frozen=True, slots=True)
class Claim:
    """A fact that separates, with those that are true of the same runs.

    Attributes:
        fact: the first of them; one that tells how far runs got only where all do.
        also: the others, in words.
        ochiai: the score, 0 to 1.
        chance: that any claim is this strong though nothing separates.
        failure: a run that failed, of which it is true.
        success: a run that succeeded, of which it is false, and otherwise much like that one; "" if there is none.
    """

    fact: Fact
    also: tuple[str, ...]
    ochiai: float
    chance: float
    failure: str
    success: str


@dataclass(frozen=True, slots=True)
class Separation:
    """What separates failures from successes.

    Attributes:
        cases: the runs.
        claims: what separates, the strongest first; those that tell how far runs got come last.
        compared: how many facts were compared.
        explained: how many failed runs the claims are true of.
    """

    cases: tuple[Case, ...]
    claims: tuple[Claim, ...]
    compared: int
    explained: int

    @property
    def failures(self) -> int:
        """How many runs failed."""
        return sum(case.failed for case in self.cases)

    @property
    def successes(self) -> int:
        """How many runs succeeded."""
        return len(self.cases) - self.failures


def separate(runs: Runs, names: Sequence[str] | None = None, cause: str | None = None) -> Separation:
    """Return what separates the runs that failed from those that succeeded.

    Args:
        runs: the runs.
        names: of those that are compared; by default all.
        cause: of the failures that are compared with the successes; by default all.
    """
    cases = _cases(runs, names, cause)
    return _separation(cases, list(compared_of(sites(runs, cases), cases)))


def _cases(runs: Runs, names: Sequence[str] | None, cause: str | None) -> tuple[Case, ...]:
    wanted = None if names is None else set(names)
    rows = runs.sql(
        "SELECT run, succeeded, cause, coalesce(q.step - 1, cause_step), records FROM runs r LEFT JOIN "
        "(SELECT f.run, max(f.step) AS step FROM failures f JOIN failures t USING (run, task, type, message) "
        "WHERE f.of = 'query' AND t.root AND f.step <= t.step GROUP BY 1) q USING (run) "
        "WHERE succeeded IS NOT NULL ORDER BY run"  # a query that raised the failure is the failure, not its cause
    )
    return tuple(
        Case(run, not succeeded, records if succeeded or step is None else step)
        for run, succeeded, why, step, records in rows.rows()
        if (wanted is None or run in wanted) and (succeeded or cause is None or why == cause)
    )


def _separation(cases: tuple[Case, ...], found: list[Compared]) -> Separation:
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
    claims.sort(key=_rank)
    explained = len(frozenset().union(*(claim.fact.true & failed for claim in claims)))
    return Separation(cases, tuple(claims), compared, explained)


def _rank(claim: Claim) -> tuple[bool, float, int, float]:
    """Return by what claims are put in order: symptoms come last, however well their runs' ends separate them."""
    return claim.fact.how_far, -round(claim.ochiai, 6), _ORDER.index(claim.fact.kind), claim.fact.step


def _pair(fact: Fact, facts: Sequence[Fact], cases: Sequence[Case]) -> tuple[str, str]:
    """Return a failed run of which a fact is true, and the successful one that is most like it, of which it isn't."""
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
