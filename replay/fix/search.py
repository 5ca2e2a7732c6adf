"""Search for a repair: the smallest edit after which the whole plan succeeds and its properties hold.

Each candidate is a whole run of an edited plan. Edits of lines that computed the values in the failure come first
(:mod:`replay.origins`). A repair runs again to be recorded, then with other seeds, and with displaced objects.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import count, islice, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.projection.child import usable_cores
from recorder.properties import BadProperty, Property, parse
from recorder.records import Check, Mutation, Plain
from recorder.tasks import Node, State
from replay.errors import ReplayError
from replay.explain.causes.case import hands, objects_in
from replay.file.record_reader import RecordReader
from replay.fix.edits import CERTAIN, Edit, Editor
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
_AWAY: Final = 0.1  # maximum distance in m between a placed object and its target at the end
_MAX_LINES: Final = 12  # maximum number of lines that are edited
_LIKELY: Final = 2  # number of lines that come before handlers of errors
_LATER: Final = 0.12  # additional cost of a line for each line that is more probable
_GUESSED: Final = 0.2  # by how much another value is likelier where a number of the scene speaks for it
_ELSEWHERE: Final = 0.5  # additional cost of edits of lines without values of the failure
_ANOTHER: Final = 0.8  # additional cost for each earlier edit of the same kind on the same line
_MAX_MARKED: Final = 2  # maximum number of marked repairs that are shown
_MORE: Final = 24  # number of runs in which another repair is searched after a marked repair
_SETTLED: Final = 0.001  # distance in m within which objects come to rest when they settle again
ONLY_RUNS: Final = "evidence: its successful runs alone"
_GOALS: Final = ("place", "transporting", "placing")


@dataclass(frozen=True, slots=True)
class Repair:
    """An edited plan that succeeded."""

    edit: Edit
    recording: Path  # the recording of its run
    seeds: int  # number of successful runs with other seeds, of :data:`CHECKS` runs
    elsewhere: int  # number of successful runs in which loose objects are displaced by 1 cm, of :data:`CHECKS` runs
    mark: str  # why the author of the plan may reject the repair; "" if there is no reason
    checks: tuple[int, int] = (0, 0)  # number of these runs, fewer than :data:`CHECKS` at the end of the budget


@dataclass(slots=True)
class SearchResult:
    """The result of a search."""

    asked: str  # text of the requirements on a repair
    repairs: list[Repair] = field(default_factory=list)  # the best first
    tried: int = 0  # number of candidates
    exhausted: bool = False  # whether no candidate is left
    runs: int = 0  # number of whole runs, including those that check repairs
    others: dict[str, str] = field(default_factory=dict)  # other failures of candidates, by edit


def search(
    trials: Trials, log: Recording, folder: Path, found: SearchResult, *, holds: Sequence[str] = (), budget: int
) -> None:
    """Search for repairs of a failed, recorded plan; they are added to ``found``, which survives an interrupt.

    Args:
        folder: folder for recordings of repairs.
        holds: properties that must hold in a repaired run.
        budget: maximum number of whole runs.

    Raises:
        ReplayError: the plan succeeded and its properties hold, or it doesn't end as recorded.
    """
    trials.control()
    why = log.why()
    properties = required(log, holds)
    checked = _checks(log, properties, failed=trials.reference.kind != "succeeded")
    if trials.reference.kind == "succeeded" and all(checked):
        raise ReplayError("the plan succeeded; say what should have held: --holds 'always milk.z > 0.5'")
    failed = why.task.motion if why.task is not None else None
    asked = ["the plan succeeds", *(f"{each} holds" for each in properties)]
    asked += [f"{failed.name} is done"] if failed is not None else []
    found.asked = ", ".join([*asked, "placed objects stay at their targets"])
    unlikely: list[Repair] = []  # marked repairs; they are shown if there is no other
    try:
        _try_all(trials, _candidates(trials, log, why, checked), found, unlikely, budget, folder, properties, failed)
        for at, each in enumerate(unlikely[:_MAX_MARKED] if not found.repairs else ()):
            unlikely[at] = each if any(each.checks) else _checked(trials, each, budget)
    finally:
        shown = [] if found.repairs else unlikely[:_MAX_MARKED]
        for each in unlikely:
            if each not in shown:
                each.recording.unlink(missing_ok=True)
        found.repairs += sorted(shown, key=lambda each: (each.seeds == 0, each.edit.cost))
        found.runs = trials.runs


def _try_all(
    trials: Trials, candidates: Iterator[Edit], found: SearchResult, unlikely: list[Repair], budget: int, folder: Path,
    properties: Sequence[str], failed: Node | None,
) -> None:  # fmt: skip
    """Try candidates until a repair without a mark is found, or only its checks are left of the budget."""
    last = budget - min(sum(CHECKS) + 1, budget // 4)
    while trials.runs < last and not found.repairs:
        likely = (each for each in candidates if not (unlikely and each.chance))  # another chance proves nothing
        wave = [*islice(likely, min(usable_cores(), last - trials.runs))]
        if not wave:
            found.exhausted = True
            break
        endings = trials.all([Version(each.text) for each in wave])
        found.tried += len(wave)
        for edit, ending in zip(wave, endings, strict=True):
            if ending.kind != "succeeded":
                if not alike(ending, trials.reference):
                    found.others[edit.what] = ending.failure
                continue
            if found.repairs or trials.runs >= budget:
                break
            files = (folder / f"{trials.log.path.stem}.fix-{number}.mcap" for number in count(1))
            file = next(each for each in files if not each.exists())
            if not alike(trials.one(edit.text, file), ending) or not reaches_goal(file, properties):
                file.unlink(missing_ok=True)
                continue
            # a repair is shown after an interrupt, too
            found.repairs.append(Repair(edit, file, 0, 0, _mark(trials, edit, file, failed)))
            if not found.repairs[0].mark:
                found.repairs[0] = _checked(trials, found.repairs[0], budget)
            if found.repairs[0].mark:
                unlikely.append(found.repairs.pop())
                last = min(last, trials.runs + _MORE)


def _checks(log: Recording, properties: Sequence[str], *, failed: bool) -> list[CheckedProperty]:
    """Check properties; in a failed run they needn't have a value, for example if their objects aren't loaded."""
    parsed: list[Property] = []
    try:
        parsed = [*map(parse, properties)]
        return log.check(*parsed)
    except BadProperty as error:
        if failed and parsed:
            return []
        raise ReplayError(str(error)) from None


def required(log: Recording, holds: Sequence[str]) -> list[str]:
    """Return the given properties, and those that the plan or its run watches."""
    watched = (each.property for each in log.records(Check) if each.phase == Check.WATCHED)
    return [*dict.fromkeys((*holds, *watched))]


def _candidates(trials: Trials, log: Recording, why: Why, checked: Sequence[CheckedProperty]) -> Iterator[Edit]:
    """Yield edits of the plan, the most probable first: small edits of lines that computed values in the failure."""
    editor = Editor(trials.text)
    alternatives = []
    if why.world is not None:
        alternatives = [[*why.world.bodies], [*hands(why.world.bodies.get(why.world.robot))]]
    edits: list[Edit] = []
    lines, guessed, stale = _lines(trials, log, why, checked, editor)
    for rank, line in enumerate(lines):
        kinds: Counter[tuple[str, float]] = Counter()
        for edit in editor.edits(line, alternatives, stale=line in stale):
            kinds[edit.kind, edit.cost] += 1
            later = _LATER * rank / (1 + 5 * (edit.cost <= CERTAIN)) + _ANOTHER * (kinds[edit.kind, edit.cost] - 1)
            is_likely = line in guessed and edit.asks
            cost = edit.cost + later - _GUESSED * is_likely
            asks, chance = edit.asks and not is_likely, edit.chance and not is_likely
            edits.append(replace(edit, cost=cost, asks=asks, chance=chance))
    failed = [each.number for each in why.call_stack if each.file.endswith(trials.program.name)][-1:]
    for rank, line in enumerate(dict.fromkeys((*failed, *lines[:1]))):
        edits += [replace(each, cost=each.cost + _LATER * rank) for each in editor.insertions(line)]
    edits += [replace(each, cost=each.cost + _ELSEWHERE / (1 + (each.cost <= CERTAIN))) for each in editor.structural()]
    seen: set[str] = set()
    for edit in sorted(edits):
        if edit.text not in seen:
            seen.add(edit.text)
            with suppress(SyntaxError, ValueError):
                compile(edit.text, "plan", "exec")
                yield edit


def _lines(
    trials: Trials, log: Recording, why: Why, checked: Sequence[CheckedProperty], editor: Editor
) -> tuple[list[int], set[int], set[int]]:
    """Return lines of the plan's main file, the most probable first; lines with guesses; lines with outdated values."""
    name = trials.program.name
    ranked, stale, guessed = list[int](), set[int](), set[int]()
    with suppress(CantRetrace):
        found = None if why.failure is None else origins(log, why, recorded_source=True)
        if found is not None:
            ranked, stale, guessed = found.lines_of(name), found.stale_of(name), {each.line for each in found.guesses}
            editor.points = found.points()
    source = PlanSource(log)
    stacks = [source.call_stack(each.record) for each in checked if not each and each.record is not None]
    if not why.call_stack and not any(stacks):  # nothing failed, but something should have been done
        stacks = [source.call_stack(each.started) for each in log.tree().roots[::-1]]
    inner = (line for stack in (why.call_stack, *stacks) for line in reversed(stack))
    called = [*dict.fromkeys(line.number for line in inner if line.file.endswith(name))]
    flow = Flow(trials.text).lines({line: float(rank) for rank, line in enumerate(called)})
    subject = next(objects_in(why.task.motion.parameters.get("object")), "") if why.task is not None else ""
    records = log.records(Mutation) if subject else ()
    loads = (each for each in records if each.HasField("load_body") and each.load_body.body == subject)
    loaded = [line.number for each in loads for line in source.call_stack(each)[-1:] if line.file.endswith(name)]
    rows = zip_longest(ranked[::2], ranked[1::2], (*called[:1], *loaded, *flow))
    lines = [*dict.fromkeys(line for row in rows for line in row if line is not None)]
    lines[_LIKELY:_LIKELY] = editor.handlers
    return [*dict.fromkeys(lines)][:_MAX_LINES], guessed, stale


def reaches_goal(file: Path, properties: Sequence[str]) -> bool:
    """Return whether properties hold in a run, and whether placed objects stay in their places."""
    with Recording(file) as log:
        placed: dict[str, Sequence[float]] = {}
        for node in log.tree().find(status=State.SUCCEEDED):
            target, thing = node.parameters.get("target"), next(objects_in(node.parameters.get("object")), "")
            if node.name == "accessing":  # a drawer or door takes along what is in it; only heights stay
                placed = {name: place[2:] or place for name, place in placed.items()}
            elif node.name == "pick-up":
                placed.pop(thing, None)
            elif node.name in _GOALS and isinstance(target, list) and thing:
                placed[thing] = [float(str(value)) for value in target]
        world = log.state_at(last_open_step(log, log.final_step())).worlds
        bodies = {name: body for each in world.values() for name, body in each.bodies.items()}
        ends = [(bodies[name].position[-len(place) :], place) for name, place in placed.items() if name in bodies]
        stays = all(math.dist(*each) < _AWAY for each in ends)
        try:
            return stays and all(log.check(*properties))
        except BadProperty:  # the edit has renamed or removed an object
            return False


def _mark(trials: Trials, edit: Edit, file: Path, failed: Node | None) -> str:
    """Return why the author may reject a repair, from its recording."""
    with Recording(file) as log:
        before, done = (each.find(status=State.SUCCEEDED) for each in (tree(trials.log), log.tree()))
        mark = "" if failed is None else changed_goal(before, done, failed, edit)
        records = (part.records(Mutation) for part in (trials.log, log))
        changed = [{commanded(each) for each in part if not each.HasField("load_body")} for part in records]
        left = sorted(changed[0] - changed[1])
        mark = mark or (changed_place(trials.log, log) if edit.asks else "")
    if left and not mark:
        mark = f"it leaves {phrases.names(left)} alone"
    return mark or (ONLY_RUNS if edit.chance else "")


def changed_place(before: RecordReader, log: RecordReader) -> str:
    """Return where the plan itself puts an object in a repaired run, if it is elsewhere than before; otherwise ""."""
    for kind, what in (("move_body", "the requested place"), ("load_body", "the scene")):
        changes = ((each for each in part.records(Mutation) if not each.task) for part in (before, log))
        moves = ([getattr(each, kind) for each in part if each.HasField(kind)] for part in changes)
        for one, other in zip(*moves, strict=False):
            if one.body == other.body and math.dist(one.position, other.position) > _SETTLED:
                places = (phrases.vector(each.position) for each in (one, other))
                return f"it changes {what}: {one.body} at {' becomes '.join(places)}"
    return ""


def _checked(trials: Trials, repair: Repair, budget: int) -> Repair:
    """Run a repair under other seeds, and with loose objects elsewhere, within the budget."""
    text = repair.edit.text
    seeds = [Version(text, seed=seed) for seed in range(1, CHECKS[0] + 1)]
    places = [Version(text, elsewhere=draw) for draw in range(1, CHECKS[1] + 1)]
    versions = [each for pair in zip_longest(seeds, places) for each in pair if each][: max(budget - trials.runs, 0)]
    good, every = [0, 0], [0, 0]
    for version, ending in zip(versions, trials.all(versions), strict=True):
        every[bool(version.elsewhere)] += 1
        good[bool(version.elsewhere)] += ending.kind == "succeeded"
    marks = ("it succeeds with its own seed only", "it fails with objects 1 cm elsewhere")
    doubts = [mark for mark, right, runs in zip(marks, good, every, strict=True) if runs and not right]
    mark = next(filter(None, (repair.mark, *doubts)), "")
    return replace(repair, seeds=good[0], elsewhere=good[1], mark=mark, checks=(every[0], every[1]))


def _is_near(one: list[Plain], other: Plain) -> bool:
    """Return whether two targets are the same, even if objects have settled a little differently."""
    try:
        return math.dist(one, other) < _SETTLED  # type: ignore[arg-type]
    except (TypeError, ValueError):  # they aren't points
        return one == other


def _asked(nodes: Sequence[Node]) -> list[Node]:
    """Return the motions that the plan itself requested."""
    motions = (node for node in nodes if node.kind == "motion")
    return [node for node in motions if all(each.kind != "action" for each in node.around())]


def changed_goal(before: Sequence[Node], done: Sequence[Node], failed: Node, edit: Edit) -> str:
    """Return how a repaired run differs from the requests of the plan; "" if it doesn't."""
    alike = [node for node in done if (node.kind, node.name) == (failed.kind, failed.name)]
    thing = failed.parameters.get("object")
    if not alike:
        return f"{failed.name}, which had failed, no longer runs"
    if thing is not None and all(node.parameters.get("object") != thing for node in alike):
        return f"{failed.name} no longer runs with {phrases.value(thing)}"
    for asked, now in zip([*_asked(before), failed] if edit.asks else (), _asked(done), strict=False):
        one, other = asked.parameters.get("target"), now.parameters.get("target")
        if asked.name == now.name and isinstance(one, list) and not _is_near(one, other):
            return f"it changes the task: the target {phrases.value(one)} becomes {phrases.value(other)}"
    return ""
