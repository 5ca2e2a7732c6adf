"""Search for a repair: the smallest edit after which the whole plan succeeds and its properties hold.

Each candidate is a whole run of an edited plan. Edits of lines that computed values of the failure come first
(:mod:`replay.origins`). A repair runs a second time to be recorded, then under other seeds, and with objects elsewhere.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from itertools import count, islice
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.projection.child import usable_cores
from recorder.properties import BadProperty
from recorder.records import Check, Mutation, Plain
from recorder.tasks import Node, State
from replay.errors import ReplayError
from replay.explain.causes.case import hands
from replay.file.record_reader import RecordReader
from replay.fix.edits import Edit, Editor
from replay.fix.trials import Trials, Version, alike
from replay.history.blame import commanded
from replay.history.flow import Flow
from replay.history.source import PlanSource
from replay.history.tasks import tree
from replay.origins.origins import origins
from replay.recording import Recording
from replay.report import phrases
from replay.retrace.plan_process import CantRetrace
from replay.state.fold import last_open_step

if TYPE_CHECKING:
    from replay.explain.check import CheckedProperty
    from replay.explain.why import Why

CHECKS: Final = (5, 3)  # a repair is checked in this many runs with other seeds, and with displaced objects
_AWAY: Final = 0.1  # largest final distance of a placed object from its target, m
_MAX_LINES: Final = 12  # largest number of lines that are edited
_LATER: Final = 0.12  # additional cost of a line for each likelier line
_ANOTHER: Final = 0.8  # additional cost for each earlier edit of the same kind on the same line
_MAX_MARKED: Final = 2  # largest number of marked repairs that are shown
_MORE: Final = 24  # number of runs that search for another repair after a marked repair
_SETTLED: Final = 0.001  # objects that settle again come to rest within this distance, m
_GOALS: Final = ("place", "transporting", "placing")


@dataclass(frozen=True, slots=True)
class Repair:
    """An edited plan that succeeded."""

    edit: Edit
    recording: Path  # the recording of its run
    seeds: int  # number of runs under other seeds that succeeded (:data:`CHECKS`)
    elsewhere: int  # number of runs with loose objects 1 cm elsewhere that succeeded (:data:`CHECKS`)
    mark: str  # reason why the plan's author may reject the repair; "" without a reason


@dataclass(slots=True)
class SearchResult:
    """The result of a search."""

    asked: str  # the requirements on a repair, in words
    repairs: list[Repair] = field(default_factory=list)  # the best first
    tried: int = 0  # number of candidates
    runs: int = 0  # number of whole runs, including the checks of repairs
    others: dict[str, str] = field(default_factory=dict)  # candidates' other failures by edit


def search(
    trials: Trials, log: Recording, folder: Path, found: SearchResult, *, holds: Sequence[str] = (), budget: int
) -> None:
    """Search for repairs of a failed plan, and add them to ``found``, which keeps them after an interrupt.

    Args:
        trials: the plan.
        log: its recording.
        folder: folder for recordings of repairs.
        found: the result.
        holds: properties that must hold in a repaired run.
        budget: largest number of whole runs.

    Raises:
        ReplayError: the plan succeeded and its properties hold, or it doesn't end as recorded.
    """
    trials.control()
    why = log.why()
    properties = required(log, holds)
    checked = log.check(*properties)
    if trials.reference.kind == "succeeded" and all(checked):
        raise ReplayError("the plan succeeded; say what should have held: --holds 'always milk.z > 0.5'")
    failed = why.task.motion if why.task is not None else None
    found.asked = ", ".join(
        [
            "the plan succeeds",
            *(f"{each} holds" for each in properties),
            *([f"{failed.name} is done"] if failed is not None else []),
            "what it places stays at its target",
        ]
    )
    unlikely: list[Repair] = []  # repairs with a mark; they are shown if there is no other
    try:
        _try_all(trials, _candidates(trials, log, why, checked), found, unlikely, budget, folder, properties, failed)
    except KeyboardInterrupt:
        found.repairs += unlikely[:_MAX_MARKED]
        raise
    shown = [] if found.repairs else unlikely[:_MAX_MARKED]
    for each in unlikely:
        if each not in shown:
            each.recording.unlink(missing_ok=True)
    fitting = [each if each.seeds or each.elsewhere else _checked(trials, each) for each in shown]
    found.repairs += sorted(fitting, key=lambda each: (each.seeds == 0, each.edit.cost))
    found.runs = trials.runs


def _try_all(
    trials: Trials, candidates: Iterator[Edit], found: SearchResult, unlikely: list[Repair], budget: int, folder: Path,
    properties: Sequence[str], failed: Node | None,
) -> None:  # fmt: skip
    """Try candidates until a repair without a mark is found, or the budget is spent."""
    while trials.runs < budget and not found.repairs:
        wave = [*islice(candidates, usable_cores())]
        if not wave:
            break
        with closing(trials.all([Version(each.text) for each in wave])) as results:
            ended = sorted((at, trial.ending) for at, trial in results)
        found.tried += len(wave)
        found.runs = trials.runs
        for at, ending in ended:
            edit = wave[at]
            if ending.kind != "succeeded":
                if not alike(ending, trials.reference):
                    found.others[edit.what] = ending.failure
                continue
            files = (folder / f"{trials.log.path.stem}.fix-{number}.mcap" for number in count(1))
            file = next(each for each in files if not each.exists())
            if not alike(trials.one(edit.text, file).ending, ending) or not reaches_goal(file, properties):
                file.unlink(missing_ok=True)
                continue
            repair = Repair(edit, file, 0, 0, _mark(trials, edit, file, failed))
            if repair.mark:
                budget = min(budget, trials.runs + _MORE)
            else:
                repair = _checked(trials, repair)
            (unlikely if repair.mark else found.repairs).append(repair)
        found.repairs.sort(key=lambda each: each.edit.cost)


def required(log: Recording, holds: Sequence[str]) -> list[str]:
    """Return the given properties, and those that the plan or its run watches."""
    watched = (each.property for each in log.records(Check) if each.phase == Check.WATCHED)
    return [*dict.fromkeys((*holds, *watched))]


def _candidates(trials: Trials, log: Recording, why: Why, checked: Sequence[CheckedProperty]) -> Iterator[Edit]:
    """Yield edits of the plan, likeliest edits first: small edits of lines that computed values of the failure."""
    editor = Editor(trials.text)
    alternatives = []
    if why.world is not None:
        alternatives = [[*why.world.bodies], [*hands(why.world.bodies.get(why.world.robot))]]
    edits: list[Edit] = []
    lines, guessed, stale = _lines(trials, log, why, checked, editor)
    for rank, line in enumerate(lines):
        kinds: Counter[float] = Counter()
        for edit in editor.edits(line, alternatives, stale=line in stale):
            cost = edit.cost + _LATER * rank + _ANOTHER * kinds[edit.cost]
            edits.append(replace(edit, cost=cost, asks=edit.asks and line not in guessed))
            kinds[edit.cost] += 1
    if lines:
        edits += editor.insertions(lines[0])
    seen: set[str] = set()
    for edit in sorted(edits):
        if edit.text not in seen and _is_python(edit.text):
            seen.add(edit.text)
            yield edit


def _lines(
    trials: Trials, log: Recording, why: Why, checked: Sequence[CheckedProperty], editor: Editor
) -> tuple[list[int], set[int], set[int]]:
    """Return lines of the plan's main file, likeliest lines first; those with guesses, and those with stale values."""
    name = trials.program.name
    ranked: list[int] = []
    guessed: set[int] = set()
    stale: set[int] = set()
    with suppress(CantRetrace):
        found = None if why.failure is None else origins(log, why, recorded_source=True)
        if found is not None:
            ranked, stale, guessed = found.lines_of(name), found.stale_of(name), {each.line for each in found.guesses}
    source = PlanSource(log)
    stacks = [source.call_stack(each.record) for each in checked if not each and each.record is not None]
    called = [
        line.number for stack in (why.call_stack, *stacks) for line in reversed(stack) if line.file.endswith(name)
    ]
    flow = Flow(editor.text).lines({line: float(rank) for rank, line in enumerate(called)})
    return [*dict.fromkeys((*ranked, *called[:1], *flow))][:_MAX_LINES], guessed, stale


def _is_python(text: str) -> bool:
    try:
        compile(text, "plan", "exec")
    except (SyntaxError, ValueError):
        return False
    return True


def reaches_goal(file: Path, properties: Sequence[str]) -> bool:
    """Return whether properties hold in a run, and whether objects stay where the run placed them."""
    with Recording(file) as log:
        placed: dict[str, Sequence[float]] = {}
        for node in log.tree().find(status=State.SUCCEEDED):
            target, thing = node.parameters.get("target"), node.parameters.get("object")
            if node.name in _GOALS and isinstance(target, list) and isinstance(thing, dict):
                placed[str(thing.get("object"))] = [float(str(value)) for value in target]
        world = log.state_at(last_open_step(log, log.final_step())).worlds
        bodies = {name: body for each in world.values() for name, body in each.bodies.items()}
        stays = all(
            math.dist(bodies[name].position, target) < _AWAY for name, target in placed.items() if name in bodies
        )
        try:
            return stays and all(log.check(*properties))
        except BadProperty:  # the edit has renamed or removed an object
            return False


def _mark(trials: Trials, edit: Edit, file: Path, failed: Node | None) -> str:
    """Return why the author may reject a repair, from its recording."""
    with Recording(file) as log:
        before, done = (each.find(status=State.SUCCEEDED) for each in (tree(trials.log), log.tree()))
        mark = "" if failed is None else changed_goal(before, done, failed, edit)
        left = sorted(_commanded(trials.log) - _commanded(log))
    return mark or (f"it leaves {phrases.names(left)} alone" if left else "")


def _checked(trials: Trials, repair: Repair) -> Repair:
    """Run a repair under other seeds, and with loose objects elsewhere."""
    text = repair.edit.text
    versions = [Version(text, seed=seed) for seed in range(1, CHECKS[0] + 1)]
    versions += [Version(text, elsewhere=draw) for draw in range(1, CHECKS[1] + 1)]
    good = [0, 0]
    with closing(trials.all(versions)) as results:
        for index, trial in results:
            good[index >= CHECKS[0]] += trial.ending.kind == "succeeded"
    mark = repair.mark
    if not mark and not all(good):
        mark = "it succeeds with its own seed only" if not good[0] else "it fails with objects 1 cm elsewhere"
    return replace(repair, seeds=good[0], elsewhere=good[1], mark=mark)


def _commanded(log: RecordReader) -> set[str]:
    """Return the names of the objects that the plan changed."""
    return {commanded(record) for record in log.records(Mutation)}


def _is_near(one: list[Plain], other: Plain) -> bool:
    """Return whether two targets are the same, although objects may have settled a little differently."""
    try:
        return math.dist(one, other) < _SETTLED  # type: ignore[arg-type]
    except (TypeError, ValueError):  # they aren't points
        return one == other


def _asked(nodes: Sequence[Node]) -> list[Node]:
    """Return the motions for which the plan itself asked."""
    motions = (node for node in nodes if node.kind == "motion")
    return [node for node in motions if all(each.kind != "action" for each in node.around())]


def changed_goal(before: Sequence[Node], done: Sequence[Node], failed: Node, edit: Edit) -> str:
    """Return how a repaired run differs from what the plan had asked for; "" if it did the same."""
    alike = [node for node in done if (node.kind, node.name) == (failed.kind, failed.name)]
    thing = failed.parameters.get("object")
    if not alike:
        return f"{failed.name}, which had failed, isn't done any more"
    if thing is not None and all(node.parameters.get("object") != thing for node in alike):
        return f"{failed.name} isn't done any more with {phrases.value(thing)}"
    for asked, now in zip([*_asked(before), failed] if edit.asks else (), _asked(done), strict=False):
        one, other = asked.parameters.get("target"), now.parameters.get("target")
        if asked.name == now.name and isinstance(one, list) and not _is_near(one, other):
            return f"it changes what is asked for: the target {phrases.value(one)} becomes {phrases.value(other)}"
    return ""
