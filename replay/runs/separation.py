"""The facts that separate failed from successful runs, from the tables of their folder.

A *site* is a parameter, a slot of a motion's solution, an answer, a choice, an event, or the order of two events. A
*fact* is a statement about the values of a site before the failure (Liblit et al. 2005). Facts are scored as in
spectrum-based fault localisation: Ochiai and Tarantula (Abreu et al. 2007; Jones and Harrold 2005). Facts that are true
of the same runs form a *claim* if their evidence is stronger than random results (:class:`Chance`).
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from recorder.records import Plain, from_json
from replay.runs.statistics import difference

if TYPE_CHECKING:
    from replay.runs.folder import Runs

LEVEL: Final = 0.01  # probability of a claim if nothing separates the runs
PRESENT: Final = frozenset({"happened", "reached"})  # kinds of sites without values
_ORDER: Final = ("parameter", "pose", "choice", "motion", "query", "order", "event", "happened", "reached")
#: Kinds of tasks whose parameters repeat those of a motion, or describe the structure of the plan.
_STRUCTURE: Final = frozenset({"process-module", "plan", "branch", "block", "cleanup"})
_AXES: Final = ("x", "y", "z")
_MAX_SITES: Final = 20_000
_MAX_MARKS: Final = 60  # maximum number of events of a run whose order is compared
_MAX_TEXT: Final = 80  # maximum number of characters of a value
_MAX_VALUES: Final = 12  # number of different texts above which a site isn't compared
_CUTS: Final = 16  # maximum number of bounds that split the values of a number into ranges
_LARGE: Final = 0.71  # how probably a number exceeds another number if the effect is large (Vargha and Delaney 2000)
_ROUNDS: Final = 1000  # number of random permutations of the failures
_LEAST: Final = 200  # minimum number of permutations, for many facts about many runs
_WORK: Final = 2e10  # maximum number of multiplications, which limits the number of permutations
_ROWS: Final = 1000  # number of facts that are evaluated together

Truth: TypeAlias = NDArray[np.bool_]
RunNumbers: TypeAlias = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Claim:
    """A fact that separates the runs, and other facts that are true of the same runs."""

    fact: Fact  # the first fact; facts that don't reflect progress come first
    also: tuple[str, ...]  # texts of the other facts
    ochiai: float  # score, from 0 to 1
    chance: float  # probability of an equally strong claim if nothing separates the runs
    failure: str  # name of a failed run of which the fact is true
    success: str  # name of a similar successful run of which the fact is false; "" if there is none


@dataclass(frozen=True, slots=True)
class Separation:
    """The facts that separate failures from successes."""

    cases: tuple[ComparedRun, ...]
    claims: tuple[Claim, ...]  # the strongest claims first; claims that reflect progress last
    compared: int  # number of facts that were compared
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
    """Return the facts that separate failed from successful runs; by default of all runs, for all causes of failures.

    Runs that succeeded but violated a watched property count as failures.
    """
    wanted = None if names is None else set(names)
    rows = runs.sql(
        "SELECT run, succeeded AND violated = 0, cause, coalesce(q.step - 1, cause_step), records FROM runs r "
        "LEFT JOIN "
        "(SELECT f.run, max(f.step) AS step FROM failures f JOIN failures t USING (run, task, type, message) "
        "WHERE f.of = 'query' AND t.root AND f.step <= t.step GROUP BY 1) q USING (run) "
        "WHERE succeeded IS NOT NULL ORDER BY run"  # a query that raised the failure isn't its cause
    )
    cases = tuple(
        ComparedRun(run, not succeeded, records if succeeded or step is None else step)
        for run, succeeded, why, step, records in rows.rows()
        if (wanted is None or run in wanted) and (succeeded or cause is None or why == cause)
    )
    found = list(compared_of(sites(runs, cases), cases))
    failing = np.array([case.failed for case in cases])
    compared = sum(len(each.true) for each in found)
    if not failing.any() or failing.all():
        return Separation(cases, (), compared, 0)
    failures = int(failing.sum())
    facts = [fact for each in found for fact in each.facts(failing)]
    by_chance = Chance(((each.known, each.true) for each in found), failing)
    groups: dict[tuple[frozenset[int], ...], list[tuple[Fact, float]]] = defaultdict(list)
    failed = frozenset(np.flatnonzero(failing).tolist())
    for fact in facts:
        if fact.evidence and (chance := by_chance.of(fact.evidence)) < LEVEL and fact.interval[0] > 0:
            groups[fact.true & failed, fact.true - failed].append((fact, chance))
    claims = []
    for alike in groups.values():
        alike.sort(key=lambda each: (each[0].how_far, _ORDER.index(each[0].kind), each[0].step))
        fact, _ = alike[0]
        chance = min(chance for _, chance in alike)
        also = tuple(other.text for other, _ in alike[1:])
        claims.append(Claim(fact, also, fact.ochiai(failures), chance, *_pair(fact, facts, cases)))
    claims.sort(  # facts that reflect progress come last
        key=lambda each: (each.fact.how_far, -round(each.ochiai, 6), _ORDER.index(each.fact.kind), each.fact.step)
    )
    explained = len(frozenset().union(*(claim.fact.true & failed for claim in claims)))
    return Separation(cases, tuple(claims), compared, explained)


def _pair(fact: Fact, facts: Sequence[Fact], cases: Sequence[ComparedRun]) -> tuple[str, str]:
    """Return a failed run with a fact, and the most similar successful run without the fact."""
    failed = [number for number in sorted(fact.true) if cases[number].failed]
    others = [number for number in sorted(fact.known - fact.true) if not cases[number].failed]
    if not others:
        return cases[failed[0]].run, ""

    def alike(a: int, b: int) -> int:
        known = (other for other in facts if a in other.known and b in other.known)
        return sum((a in other.true) == (b in other.true) for other in known)

    a, b = max(((a, b) for a in failed[:5] for b in others), key=lambda pair: (alike(*pair), -pair[0], -pair[1]))
    return cases[a].run, cases[b].run


# --- sites ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Value:
    """The value of a site in a run."""

    value: str | float | bool
    step: int


@dataclass(slots=True)
class Site:
    """A point at which runs may differ."""

    kind: str  # "parameter", "pose", "motion", "query", "choice", "event", "order", or one of :data:`PRESENT`
    name: str  # name of the site, such as "arm at pick-up(spoon)"
    #: The values in the order of steps, by number of the run, for runs that reached the site.
    values: dict[int, list[Value]] = field(default_factory=lambda: defaultdict(list))


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """A compared run."""

    run: str  # name of the file
    failed: bool
    end: int  # the step at which the failure began; in a successful run, the last step


def sites(runs: Runs, cases: Sequence[ComparedRun]) -> list[Site]:
    """Return the sites of runs with their values."""
    found = _Sites(cases)
    found.parameters(runs)
    found.poses(runs)
    found.tasks(runs)
    found.queries(runs)
    found.events(runs)
    found.orders()
    return [site for site in found.sites.values() if site.values]


class _Sites:
    def __init__(self, cases: Sequence[ComparedRun]) -> None:
        self.cases = cases
        self.numbers = {case.run: number for number, case in enumerate(cases)}
        self.sites: dict[tuple[str, str], Site] = {}
        self.marks: list[dict[str, tuple[int, str]]] = [{} for _ in cases]  # first step and branch of each event
        self.branches: list[dict[int, str]] = [{} for _ in cases]

    def add(self, kind: str, name: str, number: int, value: Plain, step: int) -> None:
        """Add a single value, or the coordinates of a position. Ignore other values."""
        for suffix, simple in _simple(value):
            key = kind, f"{suffix} of {name}" if suffix else name
            if key not in self.sites and len(self.sites) >= _MAX_SITES:
                return
            self.sites.setdefault(key, Site(*key)).values[number].append(Value(simple, step))

    def before(self, run: str, step: int) -> int | None:
        """Return the number of a run; None if a step is after the run's failure, or if the run isn't compared."""
        number = self.numbers.get(run)
        return number if number is not None and step <= self.cases[number].end else None

    def mark(self, number: int, name: str, step: int, task: int) -> None:
        """Store the first step and the branch of an event."""
        self.marks[number].setdefault(name, (step, self.branches[number].get(task, "")))

    def parameters(self, runs: Runs) -> None:
        for run, parameters in runs.sql("SELECT run, parameters FROM runs").rows():
            number = self.numbers.get(run)
            if number is not None:
                for name, text in parameters or ():
                    self.add("parameter", name, number, from_json(text), 0)

    def poses(self, runs: Runs) -> None:
        """Add the initial positions of bodies, and the first positions to which the plan moved them."""
        put = runs.sql(
            "SELECT p.run, p.step, p.body, p.x, p.y, p.z, m.command FROM poses p JOIN mutations m USING (run, step) "
            "WHERE m.body = p.body AND m.command IN ('load_body', 'move_body') ORDER BY p.run, p.step"
        )
        seen: set[tuple[str, str, str]] = set()
        for run, step, body, *place, command in put.rows():
            number = self.before(run, step)
            if number is None or (run, body, command) in seen:
                continue
            seen.add((run, body, command))
            how = "when it was loaded" if command == "load_body" else "after its first move"
            for axis, value in zip(_AXES, place, strict=True):
                self.add("pose", f"{axis} of {body} {how}", number, value, step)

    def tasks(self, runs: Runs) -> None:  # noqa: C901
        """Add the tasks that runs reached, and their slots, resolvers and process modules."""
        rows = runs.sql(
            "SELECT run, step, task, parent, kind, name, label, parameters, solution, resolver, module, status, "
            "last_step, origin FROM tasks ORDER BY run, step"
        )
        for run, step, task, parent, kind, name, label, *values, resolver, module, status, last, origin in rows.rows():
            number = self.numbers.get(run)
            if number is None:
                continue
            known = self.branches[number]
            branch = known.get(parent, "")
            known[task] = f"{branch}/{task}" if kind == "branch" else branch
            if step > self.cases[number].end:
                continue
            if not self.cases[number].failed or (last is not None and last < self.cases[number].end):
                # tasks that the failure ended only show where the failure was
                self.add("reached", f"{label} {kind}" if kind in _STRUCTURE else label, number, True, step)
            if kind not in _STRUCTURE:
                self.mark(number, f"the start of {label}", step, task)
                slots: dict[str, Plain] = {}
                for text in filter(None, values):  # slots of the solution replace those that the plan gave
                    given = from_json(text)
                    slots |= given if isinstance(given, dict) else {}
                for slot, value in slots.items():
                    self.add("motion", f"{slot} at {label}", number, value, step)
            if last is not None and last < self.cases[number].end and kind not in _STRUCTURE:
                self.mark(number, f"the end of {label}", last, task)
                if status == "failed" and origin:
                    self.add("reached", f"the failure of {label}", number, True, last)
            for what, value in (("resolver", resolver), ("process module", module)):
                if value and kind == "motion":
                    self.add("motion", f"{what} at {label}", number, value.rpartition(".")[2] or value, step)
            if kind == "branch" and name:
                self.mark(number, f"the start of branch {name}", step, task)

    def queries(self, runs: Runs) -> None:
        """Add answers and choices."""
        rows = runs.sql(
            "SELECT run, step, task, label, answer, chosen, candidates, failure FROM queries ORDER BY run, step"
        )
        for run, step, task, label, answer, chosen, candidates, failure in rows.rows():
            number = self.before(run, step)
            if number is None:
                continue
            self.mark(number, label, step, task)
            if candidates and chosen:
                self.add("choice", f"what {label} chose", number, chosen, step)
            if failure:
                self.add("query", label, number, f"raises {failure}", step)
            elif answer and len(answer) < 10 * _MAX_TEXT:
                self.add("query", label, number, from_json(answer), step)

    def events(self, runs: Runs) -> None:
        """Add events, values of fluents, and the plan's own changes of worlds."""
        rows = runs.sql("SELECT run, step, task, kind, label, value FROM events ORDER BY run, step")
        for run, step, task, kind, label, value in rows.rows():
            number = self.before(run, step)
            if number is None:
                continue
            self.mark(number, f"{kind} {label}", step, task)
            if kind == "fluent" and value and len(value) < 10 * _MAX_TEXT:
                self.add("event", f"fluent {label}", number, from_json(value), step)
            else:
                self.add("happened", f"{kind} {label}", number, True, step)
        rows = runs.sql("SELECT run, step, task, command, body FROM mutations WHERE body <> '' ORDER BY run, step")
        for run, step, task, command, body in rows.rows():
            number = self.before(run, step)
            if number is not None:
                self.mark(number, f"{command.replace('_', ' ')} {body}", step, task)
                if command == "load_body":
                    self.add("happened", f"{body} was loaded", number, True, step)

    def orders(self) -> None:
        """Add the order of two events of different branches.

        If only one of both events happened before the failure, that event was the first. A pair counts only if its
        order is known in nearly all failures; otherwise the failures would select the pairs. Both events must have
        happened in at least half of the successful runs.
        """
        failures = sum(case.failed for case in self.cases)
        usual: Counter[str] = Counter()
        for case, marks in zip(self.cases, self.marks, strict=True):
            usual.update(name for name, (_, branch) in marks.items() if branch and not case.failed)
        successes = len(self.cases) - failures
        names = sorted(name for name, count in usual.most_common(_MAX_MARKS) if 2 * count >= successes)
        for first, second in combinations(names, 2):
            site = Site("order", f"{first} before {second}")
            known = 0
            for number, marks in enumerate(self.marks):
                a, b = marks.get(first), marks.get(second)
                if a is None and b is None:
                    continue
                if a is not None and b is not None and not _apart(a[1], b[1]):
                    continue
                is_first = b is None or (a is not None and a[0] < b[0])
                site.values[number] = [Value(is_first, max(each[0] for each in (a, b) if each is not None))]
                known += self.cases[number].failed
            both = ((marks[first], marks[second]) for marks in self.marks if first in marks and second in marks)
            if known >= 0.95 * failures and any(_apart(a[1], b[1]) for a, b in both):
                self.sites["order", site.name] = site


def _apart(a: str, b: str) -> bool:
    """Return whether two branches are separate: neither contains the other."""
    return a != b and not f"{a}/".startswith(f"{b}/") and not f"{b}/".startswith(f"{a}/")


def _simple(value: Plain) -> Iterator[tuple[str, str | float | bool]]:
    """Yield the single values of a value, each with its coordinate or ""."""
    if isinstance(value, bool):
        yield "", value
    elif isinstance(value, int | float):
        yield "", float(value)
    elif isinstance(value, str):
        yield "", value[:_MAX_TEXT]
    elif value is None:
        yield "", "None"
    elif isinstance(value, dict):
        if isinstance(value.get("object"), str):
            yield "", str(value["object"])
        elif len(value) == 1 and isinstance(text := next(iter(value.values())), str):
            yield "", text[:_MAX_TEXT]
    elif len(value) == len(_AXES) and all(type(item) in (int, float) for item in value):
        yield from zip(_AXES, map(float, value), strict=True)  # type: ignore[arg-type]
    elif all(isinstance(item, str | dict) for item in value):
        named: list[Any] = [simple for item in value for _, simple in _simple(item)]
        yield "", ", ".join(map(str, named))[:_MAX_TEXT] or "nothing"


# --- facts ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Fact:
    """A statement that is true of some runs that reached a site, and false of others."""

    kind: str  # kind of the site
    text: str  # text of the fact, such as "arm=right at pick-up(spoon)"
    site: str  # name of the site
    failed: int  # number of failed runs of which the fact is true
    failures: int  # number of failed runs that reached the site
    succeeded: int  # number of successful runs of which the fact is true
    successes: int  # number of successful runs that reached the site
    step: float  # median of the first steps at which the runs had the value
    evidence: float  # strength of the correlation between the fact and failure
    true: frozenset[int]  # numbers of the runs of which the fact is true
    known: frozenset[int]  # numbers of the runs that reached the site
    how_far: bool  # whether the fact may only reflect the progress of failed runs; such facts are listed last

    def ochiai(self, failures: int) -> float:
        """Return the score of Ochiai, from 0 to 1. ``failures`` is the number of all failed runs."""
        return self.failed / math.sqrt(failures * (self.failed + self.succeeded)) if self.failed else 0.0

    @property
    def tarantula(self) -> float:
        """The score of Tarantula, from 0 to 1."""
        failed = self.failed / self.failures if self.failures else 0.0
        return failed / (failed + (self.succeeded / self.successes if self.successes else 0.0)) if failed else 0.0

    @property
    def effect(self) -> float:
        """The failure rate of runs with the fact, minus the failure rate of other runs."""
        others = len(self.known) - len(self.true)
        return self.failed / len(self.true) - ((self.failures - self.failed) / others if others else 0.0)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the effect."""
        return difference(self.failed, len(self.true), self.failures - self.failed, len(self.known) - len(self.true))


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """The facts of a site."""

    site: Site
    known: RunNumbers  # numbers of the runs that reached the site
    true: Truth  # array: whether a fact (row) is true of a run (column)
    text: Callable[[int], str]  # a function that returns the text of a fact
    #: A function that returns the index, from 1, of the value by which a fact is true of a run.
    turn: Callable[[int, int], int] = lambda _row, _run: 1
    best: bool = False  # whether only the strongest fact counts, as with ranges of a number
    whole: Site | None = None  # the site with all values, if only the last values are compared

    def facts(self, failed: Truth) -> Iterator[Fact]:
        """Yield the facts that are compared."""
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
        """Return whether the fact may only show that failed runs got further, or less far, than successful runs."""
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
    """Yield the facts of each site that are true of some runs and false of others."""
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
    """Return the site with the last value of each run; None if no run has several values."""
    if site.kind in {*PRESENT, "order"} or all(len({each.value for each in got}) == 1 for got in site.values.values()):
        return None
    if site.kind == "choice":
        name = f"{site.name} last"
    else:
        before, at, where = site.name.partition(" at ")
        name = f"{before} at the last {where}" if at else f"the last {site.name}"
    return Site(site.kind, name, {number: got[-1:] for number, got in site.values.items()})


def _reached(site: Site, runs: int) -> Compared:
    known = np.arange(runs)
    return Compared(site, known, np.isin(known, list(site.values))[None, :], lambda _: site.name)


def _values(site: Site, simple: Sequence[str | float | bool]) -> Compared:
    """For each value of a site, compare whether a run had this value."""
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
    shown = f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else value
    if site.kind in ("query", "event"):
        return f"{site.name} -> {shown}"
    name, at, where = site.name.partition(" at ")
    return f"{name}={shown}{at}{where}"


def _ranges(site: Site) -> Compared:
    """Compare ranges of a number; their ends are between values."""
    known = np.array(sorted(site.values))
    first = np.array([float(site.values[number][0].value) for number in known.tolist()])
    values = np.sort(first)
    starts = np.flatnonzero(np.diff(values)) + 1  # indices at which new values begin
    if len(starts) > _CUTS:
        starts = starts[np.unique(np.linspace(0, len(starts) - 1, _CUTS).round().astype(int))]
    cuts = [0, *starts.tolist(), len(values)]
    ends = [(low, high) for at, low in enumerate(cuts) for high in cuts[at + 1 :]]
    true = np.array([(first >= values[low]) & (first <= values[high - 1]) for low, high in ends])
    return Compared(site, known, true, lambda row: _range_text(site, values, *ends[row]), best=True)


def _range_text(site: Site, values: np.ndarray, low: int, high: int) -> str:
    """Return the text of a range. The ends of a range are halfway between values."""
    name, at, where = site.name.partition(" at ")
    if values[low] == values[high - 1]:
        return f"{name}={values[low]:g}{at}{where}"
    above = _between(values[low - 1], values[low]) if low else ""
    below = _between(values[high - 1], values[high]) if high < len(values) else ""
    text = f"{above} < {name} < {below}" if above and below else f"{name} > {above}" if above else f"{name} < {below}"
    return f"{text}{at}{where}"


def _between(a: float, b: float) -> str:
    """Return the number with the fewest digits between two numbers."""
    texts = (f"{(a + b) / 2:.{digits}g}" for digits in range(2, 17))
    return next((text for text in texts if a < float(text) < b), repr((a + b) / 2))


# --- chance -----------------------------------------------------------------------------------------------------------


def evidence(true: Truth, failed: Truth) -> NDArray[np.float64]:
    """Return the log-likelihood ratio of two failure rates, with and without a fact, against a single rate.

    The ratio is 0 if the failure rate isn't higher with the fact. ``true`` contains whether a fact (row) is true of a
    run (column), and ``failed`` whether a run (row) failed in a permutation (column).
    """
    count, inside = true.shape[1], true.sum(axis=1, dtype=np.int64)[:, None]
    labels = failed.reshape(count, -1)
    failures = labels.sum(axis=0, dtype=np.int64)[None, :]
    hits = np.rint(true.astype(np.float32) @ labels.astype(np.float32)).astype(np.int64)
    counts = np.arange(count + 1, dtype=np.float64)
    log = counts * np.log(np.maximum(counts, 1))  # n log n
    cells = log[hits] + log[inside - hits] + log[failures - hits] + log[count - inside - failures + hits]
    margins = log[inside] + log[count - inside] + log[failures] + log[count - failures]
    return np.where(hits * count > failures * inside, cells - margins + log[count], 0.0)


class Chance:
    """The strongest evidence of all facts in each random permutation of the failures.

    Source: Westfall and Young 1993, the single-step maximum. ``facts`` contains, for each site, the numbers of the runs
    that reached the site, and a row for each fact.
    """

    def __init__(self, facts: Iterable[tuple[RunNumbers, Truth]], failed: Truth) -> None:
        alike: dict[bytes, list[tuple[RunNumbers, Truth]]] = defaultdict(list)
        for known, true in facts:
            alike[known.tobytes()].append((known, true))
        groups = [
            (each[0][0], np.unique(np.concatenate([true for _, true in each]), axis=0)) for each in alike.values()
        ]
        rounds = int(min(_ROUNDS, max(_LEAST, _WORK / max(sum(true.size for _, true in groups), 1))))
        dice = np.random.default_rng(0)  # a fixed seed, so that the result is reproducible
        dealt = dice.permuted(np.tile(failed, (rounds, 1)), axis=1).T
        strongest: NDArray[Any] = np.zeros(rounds)
        for known, true in groups:
            for start in range(0, len(true), _ROWS):
                np.maximum(strongest, evidence(true[start : start + _ROWS], dealt[known]).max(axis=0), out=strongest)
        self._strongest = np.sort(strongest)

    def of(self, strength: float) -> float:
        """Return the probability that a fact has this evidence when failures are assigned at random."""
        as_strong = len(self._strongest) - int(np.searchsorted(self._strongest, strength - 1e-9))
        return (1 + as_strong) / (1 + len(self._strongest))
