"""The last step from which a failed plan could still have succeeded, and the change after it.

Forks just before the failed motion find the closing step: in each, all objects are where they were at an earlier step.
If these forks succeed up to a step and fail after it, a bisection finds the step with few forks. Then other choices on
record before that step are forced, the latest choice first. If no choice helps, a repair is searched
(:mod:`replay.fix.search`).
"""

from __future__ import annotations

import ast
import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Self

from pycram.foundation.forcing import SKIPPED
from pycram.projection.child import usable_cores
from recorder.mcap_sink import free_path
from recorder.plan_lines import called_name, syntax_nodes
from recorder.records import Mutation, Query, Run, Task, argument_values
from recorder.records.text import NOT_TRIED, TAKEN, chosen_name, fates
from replay.compare import compare_recordings
from replay.errors import ReplayError
from replay.explain.causes.case import FailureCase
from replay.explain.causes.trials import NONE, Trial, TriedTrial, away, restored
from replay.fix.search import Repair, SearchResult, reaches_goal, required, search
from replay.fix.trials import Trials
from replay.history.source import Line, PlanSource
from replay.recording import Recording
from replay.report.question import written
from replay.retrace.decisions import candidate_names
from replay.retrace.prove import Prover

_ALTERNATIVES: Final = 2  # maximum number of other candidates of a choice, except places, that are forced
_SHARES: Final = (2, 1, 3)  # places at these quarters of the order of distances from the taken place are forced
_PROBES: Final = 2  # number of forks that check whether the bisection was right


@dataclass(slots=True)
class LastChance:
    """The result of a search."""

    step: int | None = None  # the last step from which the plan still succeeds; None if there is none
    closed: int | None = None  # the step that closed the last chance; None if unknown
    line: Line | None = None  # the plan's line that made this step
    choice: str = ""  # the decision with which the plan succeeds, as a text for ``fork --answer``; "" if there is none
    repair: Repair | None = None  # the repair with which the plan succeeds; None if there is none
    recording: Path | None = None  # the recording of the successful run
    runs: int = 0  # number of whole runs
    #: Steps at which the objects have the positions of a failing run, although a later step doesn't, or the other way
    #: round.
    exceptions: list[int] = field(default_factory=list)
    others: list[str] = field(default_factory=list)  # tried choices that don't help, with their outcomes


def last_chance(
    trials: Trials, log: Recording, folder: Path, found: LastChance, *, holds: Sequence[str] = (), budget: int
) -> None:
    """Search the last chance of a failed plan; the result is added to ``found``, which survives an interrupt.

    Args:
        folder: folder for the recording of the success.
        holds: properties that must hold in a successful run.
        budget: maximum number of whole runs.

    Raises:
        ReplayError: the plan succeeded, or it doesn't end as recorded.
    """
    if trials.control().kind == "succeeded":
        raise ReplayError("the plan succeeded")
    found.runs = trials.runs
    with _Chances(trials, log, folder, found, holds, budget) as chances:
        chances.find_closing()
        chances.find_choice()
    if found.choice or found.runs >= budget:
        return
    result = SearchResult("")
    before = trials.runs
    try:
        search(trials, log, folder, result, holds=holds, budget=budget - found.runs)
    finally:
        found.runs += trials.runs - before
        found.repair = next((each for each in result.repairs if not each.mark), None)
        if found.repair is not None:
            found.recording = found.repair.recording
            with Recording(found.recording) as repaired:
                parted = compare_recordings(log, repaired).divergence
            differs = parted and (parted.first or parted.second)  # an inserted call is only in the second run
            first = differs.seq if differs else len(log)
            found.step = first - 1
            if found.closed is None or found.closed < first:
                chances.close(first)


def other_choice(trials: Trials, log: Recording, folder: Path, holds: Sequence[str], budget: int) -> LastChance:
    """Force other choices before the failed motion, the latest first, until the whole plan succeeds."""
    found = LastChance(runs=trials.runs)
    if log.why().task is not None:
        with _Chances(trials, log, folder, found, holds, budget) as chances:
            chances.find_choice()
    return found


def last_by_fork(log: Recording) -> int:
    """Return the step of the last change of the world by a fork; -1 without one."""
    return max((each.seq for each in log.records(Mutation) if each.by_fork), default=-1)


class _Chances:
    def __init__(
        self, trials: Trials, log: Recording, folder: Path, found: LastChance, holds: Sequence[str], budget: int
    ) -> None:
        why = log.why()
        self._temporary = TemporaryDirectory(prefix="pycram-chance-")
        self._prover = Prover(log, why, Path(self._temporary.name), recorded_source=True, kept=True)
        self._folder = folder
        self._log, self._case, self._found, self._budget = log, why.case, found, budget
        self._control = trials.runs
        self._properties = required(log, holds)
        self._tasks = {each.task: each for each in log.records(Task) if each.phase == Task.STARTED}
        #: The step at which objects are put back: the start of the failed motion, or else the step before the failure.
        self._end = why.step - 1 if why.case is None or why.case.motion is None else why.case.began
        self._step = why.step
        self._source = PlanSource(log)
        self._by_fork = last_by_fork(log)  # a fork before this step wouldn't repeat the change

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._prover.stop()
        self._temporary.cleanup()

    # --- the step that closed the chance -----------------------------------------------------------------------------

    def find_closing(self) -> None:
        """Find the change after which the failed motion fails, by putting the objects back to earlier steps."""
        case = self._case
        if case is None or case.world is None:
            return
        held = {each.body for each in case.world.attachments.values() if each.carrier == case.world.robot}
        needed = {case.world.robot, *held.intersection(case.subjects)}
        names = [name for name in case.world.bodies if name not in needed]
        busy = {case.holder(name, self._end - 1) for name in needed} - {""}
        changes = [*self._changes(case.world.name, names)]
        known: dict[int, bool] = {len(changes): False}  # results by number of kept changes

        def helps(kept: int) -> bool:
            if kept not in known and self._left():
                tried = self._prover.tried(_put_back(case, names, busy, changes[kept] - 1, self._end))
                known[kept] = self._prover.succeeds(tried)
                self._found.runs = self._control + self._prover.forks
            return known.get(kept, False)

        kept, width = len(changes) - 1, 1
        while kept > 0 and not helps(kept):  # a change that closed the chance is often late
            kept, width = max(kept - width, 0), 2 * width
        if not changes or not helps(kept):
            return
        kept = self._bisected(kept, known, helps)
        for _ in range(_PROBES):  # is this step right again, between later steps that are wrong?
            later = sorted(each for each in known if each > kept)
            gaps = [(after - before, (before + after) // 2) for before, after in pairwise(later)]
            width, probe = max(gaps, default=(0, 0))
            if width > 1 and helps(probe):
                self._found.exceptions.append(changes[kept])
                kept = self._bisected(probe, known, helps)
        if kept and not helps(0):
            self._found.exceptions.append(changes[0])
        self.close(changes[kept])

    def _bisected(self, kept: int, known: dict[int, bool], helps: Callable[[int], bool]) -> int:
        """Return the largest number of kept changes that helps, below the next number that is known not to help."""
        wrong = min(number for number, right in known.items() if number > kept and not right)
        while wrong - kept > 1 and self._left():
            middle = (kept + wrong) // 2
            if helps(middle):
                kept = middle
            else:
                wrong = middle
        return kept

    def _changes(self, world: str, names: Sequence[str]) -> Iterator[int]:
        """Yield the steps that change some objects, but don't load them."""
        for record in self._log.records(Mutation, 0, self._end):
            effect = record.effect
            moved = {each.body for states in (effect.bodies, effect.attached, effect.detached) for each in states}
            if record.world == world and not record.HasField("load_body") and not moved.isdisjoint(names):
                yield record.seq

    def close(self, step: int) -> None:
        """Store the step that closed the chance, with the plan's line."""
        record = self._log[min(step, len(self._log) - 1)]
        stack, task = self._source.call_stack(record), self._tasks.get(record.task) if hasattr(record, "task") else None
        while not stack and task is not None:
            stack, task = self._source.call_stack(task), self._tasks.get(task.parent)
        self._found.closed, self._found.line = record.seq, stack[-1] if stack else None

    def _left(self) -> bool:
        return self._found.runs < self._budget

    # --- choices -----------------------------------------------------------------------------------------------------

    def find_choice(self) -> None:
        """Force other choices before the closing step, the latest first, until the whole plan succeeds."""
        choices, found = list(self._choices()), self._found
        with ThreadPoolExecutor(usable_cores()) as pool, ExitStack() as undoing:
            undoing.callback(self._prover.stop)  # without this, an interrupted block would wait for its forks
            while choices and self._left():
                size = min(usable_cores(), self._budget - found.runs)
                wave, choices = choices[:size], choices[size:]
                for tried in pool.map(self._prover.tried, wave):
                    found.runs = self._control + self._prover.forks
                    if found.choice or not self._succeeds(tried):
                        found.others.append(tried.text)
                        continue
                    found.step, found.choice, choices = tried.trial.step, tried.trial.answers[0], []
                    found.recording = free_path(self._folder / f"{self._log.path.stem}.chance.mcap")
                    shutil.move(tried.file, found.recording)
                    if found.closed is None or found.closed <= found.step:
                        self.close(found.step + 1)

    def _succeeds(self, tried: TriedTrial) -> bool:
        if not self._prover.succeeds(tried):
            return False
        with Recording(tried.file) as forked:
            end = forked[-1]
        return isinstance(end, Run) and end.succeeded and reaches_goal(Path(tried.file), self._properties)

    def _choices(self) -> Iterator[Trial]:
        """Yield decisions with other values, the latest decision first."""
        closed = self._found.closed
        if closed is not None:
            yield from self._skipped(closed)
        for record in self._log.backwards(self._step if closed is None else closed, (Query, Task)):
            if record.seq <= self._by_fork + 1:
                return
            texts: list[str] = []
            step = record.seq - 1
            if isinstance(record, Query):
                texts = [f"{record.name}(...)={name!r}" for name in _alternatives(record)]
            elif isinstance(record, Task) and (motion := self._tasks.get(record.parent)) is not None:
                used = argument_values(record.parameters).get("arm")
                chooses = used and record.phase == Task.STARTED and record.kind == "process-module"
                arms = [*self._case.hands] if chooses and self._case is not None else []
                texts = [f"{motion.name}.arm(...)={arm}" for arm in arms if arm != used]
                step = motion.seq - 1
            yield from (Trial(step, text, answers=(text,)) for text in texts)

    def _skipped(self, closed: int) -> Iterator[Trial]:
        """Yield the trial without the call that closed the chance, if the plan itself made it and it has no result."""
        record, line = self._log[closed], self._found.line
        if not isinstance(record, Mutation) or record.task or line is None:
            return
        for node in syntax_nodes(line.text):
            name = called_name(node)
            if name not in ("", "simulate", "settle") and isinstance(node.func, ast.Attribute):  # type: ignore[attr-defined]
                text = f"{name}(...)={SKIPPED}"
                yield Trial(closed - 1, text, answers=(text,))


def _put_back(case: FailureCase, names: Sequence[str], busy: set[str], then: int, end: int) -> Trial:
    """Return the fork in which objects, also in the robot's hands, are where they were after an earlier step.

    An object that was in a busy hand is moved far away instead, because a hand holds one object.
    """
    hands = {name: case.holder(name, then) for name in names if case.holder(name, then) != case.holder(name, end - 1)}
    settings = [f"{written(name)}.hand={NONE}" for name in hands]
    words = f"all objects are as they were at step {then}"
    settings += next(restored(case, names, then, end, words), Trial(end, words)).settings
    for name, arm in hands.items():
        moved = away(case, name, end) if arm in busy else ()
        settings += [each for trial in moved for each in trial.settings]
        settings += [f"{written(name)}.hand={arm}"] if arm in case.hands and arm not in busy else []
    return Trial(end, words, tuple(settings), world=case.world.name if case.world is not None else "")


def _alternatives(query: Query) -> list[str]:
    """Return the names of a few candidates that weren't tried."""
    if not query.HasField("chosen"):
        return []
    names = [*candidate_names(query)]
    if not query.grid.spots:
        untried = [name for each in query.candidates if each.reason in ("", "Untried") for name in each.names]
        return [name for name in untried if name != chosen_name(query)][:_ALTERNATIVES]
    spots = [*zip((each.position[:2] for each in query.grid.spots), fates(query), names, strict=True)]
    taken = next((at for at, fate, _ in spots if fate == TAKEN), spots[0][0])
    free = sorted((math.dist(at, taken), name) for at, fate, name in spots if fate == NOT_TRIED)
    return [free[len(free) * share // 4][1] for share in _SHARES if free]
