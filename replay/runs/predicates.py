"""The predicates that may separate failed from successful runs, read from the tables.

A *site* is a parameter, a slot of a motion's solution, an answer, a choice, an event, or an order of two events; it has
values in each run that reached it. Only values before the failure count. In a run that didn't reach a site the
predicate isn't observed (Liblit et al. 2005, "Scalable statistical bug isolation").
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any, Final

from recorder.records import from_json

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from recorder.records import Plain
    from replay.runs.runs import Runs

_MAX_SITES: Final = 20_000
_MAX_MARKS: Final = 60  # events of a run whose order is compared
_MAX_TEXT: Final = 80  # characters of a value
_AXES: Final = ("x", "y", "z")
#: Kinds of sites without values: events that happened, and tasks that runs reached.
PRESENT: Final = frozenset({"happened", "reached"})
#: Kinds of tasks whose parameters are those of their motion, or only describe the plan's structure.
_STRUCTURE: Final = frozenset({"process-module", "plan", "branch", "block", "cleanup"})


@dataclass(frozen=True, slots=True)
class Value:
    """A value of a site in a run."""

    value: str | float | bool
    step: int


@dataclass(slots=True)
class Site:
    """A point at which runs may differ."""

    kind: str  # "parameter", "pose", "motion", "query", "choice", "event", "order", or one of :data:`PRESENT`
    name: str  # as "arm at pick-up(spoon)"
    #: By the number of the run, its values in order; runs that didn't reach the site are left out.
    values: dict[int, list[Value]] = field(default_factory=lambda: defaultdict(list))


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """A run that is compared with others."""

    run: str  # name of its file
    failed: bool
    end: int  # the last step that counts: where its failure began, or the last one of a success


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
    """Collects the sites from the tables."""

    def __init__(self, cases: Sequence[ComparedRun]) -> None:
        self.cases = cases
        self.numbers = {case.run: number for number, case in enumerate(cases)}
        self.sites: dict[tuple[str, str], Site] = {}
        self.marks: list[dict[str, tuple[int, str]]] = [{} for _ in cases]  # by name: first step, and branch
        self.branches: list[dict[int, str]] = [{} for _ in cases]

    def add(self, kind: str, name: str, number: int, value: Plain, step: int) -> None:
        """Add a value, if it is simple; a position is split into its coordinates."""
        for suffix, simple in _simple(value):
            key = kind, f"{suffix} of {name}" if suffix else name
            if key not in self.sites and len(self.sites) >= _MAX_SITES:
                return
            site = self.sites.setdefault(key, Site(*key))
            site.values[number].append(Value(simple, step))

    def before(self, run: str, step: int) -> int | None:
        """Return the number of a run, if a step counts in it."""
        number = self.numbers.get(run)
        return number if number is not None and step <= self.cases[number].end else None

    def mark(self, number: int, name: str, step: int, task: int) -> None:
        """Note the first time that an event happens, and its branch."""
        self.marks[number].setdefault(name, (step, self.branches[number].get(task, "")))

    def parameters(self, runs: Runs) -> None:
        """Add the parameters of runs."""
        for run, parameters in runs.sql("SELECT run, parameters FROM runs").rows():
            number = self.numbers.get(run)
            if number is not None:
                for name, text in parameters or ():
                    self.add("parameter", name, number, from_json(text), 0)

    def poses(self, runs: Runs) -> None:
        """Add the positions at which bodies were loaded, and to which the plan itself moved them."""
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
            how = "loaded" if command == "load_body" else "moved first"
            for axis, value in zip(_AXES, place, strict=True):
                self.add("pose", f"{axis} of {body}, where it was {how}", number, value, step)

    def tasks(self, runs: Runs) -> None:  # noqa: C901  one step after the other
        """Add the tasks that runs reached, with their slots, resolvers and process modules."""
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
                # the tasks that the failure ended only repeat where it happened
                self.add("reached", f"{label} {kind}" if kind in _STRUCTURE else label, number, True, step)
            if kind not in _STRUCTURE:
                self.mark(number, f"the start of {label}", step, task)
                slots: dict[str, Plain] = {}
                for text in values:  # slots of the solution replace the given ones
                    slots |= _object(text)
                for slot, value in slots.items():
                    self.add("motion", f"{slot} at {label}", number, value, step)
            ended = last is not None and last < self.cases[number].end
            if ended and kind not in _STRUCTURE:
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

        If only one of them happened before the failure, it was the first. A pair counts only if it is known in nearly
        all failures, as the failures would select other pairs, and if its events are usual in successful runs.
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
                step = max(each[0] for each in (a, b) if each is not None)
                site.values[number] = [Value(is_first, step)]
                known += self.cases[number].failed
            if known >= 0.95 * failures and any(_both(marks, first, second) for marks in self.marks):
                self.sites["order", site.name] = site


def _both(marks: Mapping[str, tuple[int, str]], first: str, second: str) -> bool:
    return first in marks and second in marks and _apart(marks[first][1], marks[second][1])


def _apart(a: str, b: str) -> bool:
    """Return whether two branches differ and neither contains the other."""
    return a != b and not f"{a}/".startswith(f"{b}/") and not f"{b}/".startswith(f"{a}/")


def _object(text: str) -> Mapping[str, Plain]:
    try:
        value = json.loads(text) if text else {}
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


def _simple(value: Plain) -> Iterator[tuple[str, str | float | bool]]:
    """Yield the simple values by which a value is compared, each with its coordinate or ""."""
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
    elif len(value) == len(_AXES) and all(_is_number(item) for item in value):
        yield from zip(_AXES, map(float, value), strict=True)  # type: ignore[arg-type]
    elif all(isinstance(item, str | dict) for item in value):
        named: list[Any] = [simple for item in value for _, simple in _simple(item)]
        yield "", ", ".join(map(str, named))[:_MAX_TEXT] or "nothing"


def _is_number(value: Plain) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
