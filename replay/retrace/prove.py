"""Test the causes of a failure: each fork takes a cause away.

If a fork without the cause fails in the same way, the fork refutes the cause. If the fork succeeds, or fails later in
another way, the fork confirms the cause. A control run without changes must repeat the recording up to the failure.
"""

from __future__ import annotations

import ast
import re
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.plan_lines import syntax_nodes
from recorder.records import Failure, Mutation, Run, Task, argument_values, format_failure
from replay.compare import is_worded_alike, signature
from replay.errors import ReplayError
from replay.explain.causes.case import pairs_of
from replay.explain.causes.raised import Raised, is_mistake
from replay.explain.causes.trials import CONFIRMED, IN_CODE, REFUTED, UNTESTED, Proof, Trial, TriedTrial
from replay.file.record_reader import RecordReader
from replay.history.source import Line, PlanSource, parse_traceback
from replay.history.tasks import uncaught_failure
from replay.report import phrases
from replay.retrace.fork import changes_of
from replay.retrace.plan_process import CantRetrace, PlanProcess
from replay.retrace.retrace import Retracing, compared

if TYPE_CHECKING:
    from replay.explain.why import Why

_BUDGET: Final = 12  # maximum number of forks
_AT_ONCE: Final = 2  # number of parallel forks
_MAX_TRIALS: Final = 3  # maximum number of forks for one cause
_SECONDS: Final = (30.0, 10.0)  # maximum duration of a fork: in s, and as a multiple of the original run
_WORD: Final = re.compile(r"[^\W\d]\w*")
_End: TypeAlias = "tuple[str, tuple[Line, ...]]"  # signature and lines of a plan's failure
_RANK: Final = (CONFIRMED, IN_CODE, UNTESTED, REFUTED)


def prove(
    log: RecordReader, why: Why, *, keep: Path | None = None, recorded_source: bool = False
) -> tuple[Why, Retracing]:
    """Test the causes of an explanation in forks.

    Effects outside of the plan's worlds (files, network) happen again in each run.

    Args:
        keep: A folder for the recordings of the forks. By default, these recordings are deleted.
        recorded_source: Whether to run the source that is attached to the recording, instead of the files on the disk.

    Returns:
        The explanation with its verdicts, confirmed causes first; and the result of the control run.

    Raises:
        CantRetrace: The plan can't run again.
    """
    unchanged = PlanProcess(log, recorded_source=recorded_source)
    with (
        TemporaryDirectory(prefix="pycram-prove-") as temporary,
        ThreadPoolExecutor(_AT_ONCE) as pool,
        ExitStack() as undoing,
    ):
        undoing.callback(unchanged.stop)  # without this, an interrupted block would wait for its runs
        control = pool.submit(compared, unchanged, log)
        prover = Prover(log, why, keep or Path(temporary), recorded_source=recorded_source, kept=keep is not None)
        undoing.callback(prover.stop)
        known: dict[Trial, TriedTrial] = {}  # several causes may have the same trial
        tried: list[list[TriedTrial]] = [[] for _ in why.causes]
        trials = [list(cause.trials(why.case)) if why.case is not None else [] for cause in why.causes]
        for turn in range(_MAX_TRIALS):
            wanted = [
                (found, each[turn])
                for found, each in zip(tried, trials, strict=True)
                if turn < len(each) and all(one.verdict != CONFIRMED for one in found)
            ][: max(0, _BUDGET - prover.forks)]
            fresh = [each for each in dict.fromkeys(trial for _, trial in wanted) if each not in known]
            known |= zip(fresh, pool.map(prover.tried, fresh), strict=True)
            for found, trial in wanted:
                found.append(known[trial])
        result = control.result()
        proofs = [
            Proof(IN_CODE, "no verdict: a fork changes the world, and not the plan's code")
            if isinstance(cause, Raised) and not (each or cause.own) and is_mistake(cause.type)
            else _proof(found, "the limit of forks was reached" if each else cause.untestable, result, why.step)
            for found, each, cause in zip(tried, trials, why.causes, strict=True)
        ]
        ranked = sorted(zip(why.causes, proofs, strict=True), key=lambda each: _RANK.index(each[1].verdict))
        causes, proven = zip(*ranked, strict=True) if ranked else ((), ())
        return replace(why, causes=causes, proofs=proven), result


def _proof(tried: Sequence[TriedTrial], untested: str, control: Retracing, failed: int) -> Proof:
    """Return the verdict of a cause's forks, if the control run repeats the recording up to the failed step."""
    if control.difference is not None and control.difference.step <= failed:
        untested = f"without changes, the plan doesn't repeat its recording: {control.difference.text}"
        return Proof(UNTESTED, f"not tested: {untested}", tuple(replace(each, verdict=UNTESTED) for each in tried))
    every = all(each.verdict == REFUTED for each in tried)
    weighty = [each for each in tried if each.verdict != REFUTED or every or each.trial.decisive]
    for verdict in (CONFIRMED, REFUTED, UNTESTED):
        for each in weighty:
            if each.verdict == verdict:
                said = f"{'undecided' if verdict == UNTESTED else verdict}: {each.text}"
                return Proof(verdict, said, tuple(tried))
    return Proof(UNTESTED, f"not tested: {untested}", tuple(tried))


class Prover:
    """Runs the trials of an explanation as forks."""

    def __init__(self, log: RecordReader, why: Why, folder: Path, *, recorded_source: bool, kept: bool) -> None:
        self._log = log
        self._folder = folder
        self._recorded_source = recorded_source
        self._kept = kept
        self._reading = threading.Lock()  # only one thread at a time may read the recording
        self._worded = is_worded_alike(log)
        self._end = self._ended(log, uncaught_failure(log))
        self._steps = len(log)
        self._checked = why.failure or Failure()  # the failure of a property or a check of the plan
        self._seconds = max(_SECONDS[0], _SECONDS[1] * why.run.seconds)
        self._task: Task | None = None  # the start of the failed task
        self._failure = Failure()  # the failure of this task
        if why.task is not None and (finished := why.task.motion.finished or why.task.finished) is not None:
            self._task, self._failure = why.task.motion.started, finished.failure
            self._size = finished.seq - self._task.seq
            self._succeeded = _succeeded(log, self._task, finished.seq)
            alike = {exact: _alike(log, self._task, exact=exact) for exact in (True, False)}
            self._numbers = {exact: sum(each.seq < self._task.seq for each in alike[exact]) for exact in alike}
        self.forks = 0
        self._running: set[PlanProcess] = set()
        self._stopped = False
        folder.mkdir(parents=True, exist_ok=True)

    def stop(self) -> None:
        """Stop all forks, and don't start others."""
        self._stopped = True
        for process in [*self._running]:
            process.stop()

    def tried(self, trial: Trial) -> TriedTrial:
        """Run a trial, and judge it."""
        with self._reading:
            if self._stopped:
                return TriedTrial(trial, UNTESTED, "stopped")
            self.forks += 1
            file = self._folder / f"{self._log.path.stem}.prove-{self.forks}.mcap"
            try:
                changes = changes_of(self._log, trial.step, trial.settings, trial.world or None, trial.answers, None)
                process = PlanProcess(self._log, until=trial.step, recorded_source=self._recorded_source)
            except ReplayError as error:
                return TriedTrial(trial, UNTESTED, f"{trial.words}: {error}")
            self._running.add(process)
        timer = threading.Timer(self._seconds, process.stop)
        timer.start()
        try:
            guided = process.run(file=file, changes=changes, quiet=True)
        except ReplayError as error:
            late = isinstance(error, CantRetrace) and not timer.is_alive()
            verdict, text = UNTESTED, "the fork didn't end in time" if late else str(error)
        else:
            verdict = UNTESTED
            if guided.difference is not None:
                text = f"the plan differs before the change: {guided.difference.text}"
            elif guided.unused:
                text = f"the decision {', '.join(guided.unused)} wasn't made"
            else:
                with RecordReader(file) as forked:
                    came = _late(forked, trial.step) if trial.settings else 0
                    text = f"a motion was under way, so the change came only at step {came}"
                    verdict, text = (UNTESTED, text) if came else self._judged(forked, trial, len(changes))
        finally:
            timer.cancel()
        return TriedTrial(trial, verdict, f"{trial.words} after step {trial.step}: {text}", str(file) * self._kept)

    def _judged(self, forked: RecordReader, trial: Trial, added: int) -> tuple[str, str]:
        """Return the verdict of a fork, and the text of its outcome."""
        if not isinstance(forked[-1], Run):
            return UNTESTED, "the recording of the fork has no end"
        wanted = "motion", trial.needs, Task.FINISHED
        every = forked.records(Task, trial.step + 1)
        needed = next((each for each in every if (each.kind, each.name, each.phase) == wanted), None)
        if needed is not None and needed.status != Task.SUCCEEDED:
            return UNTESTED, f"{trial.needs} still fails: {phrases.failure(needed.failure)}"
        end = uncaught_failure(forked)
        plan_end = self._ended(forked, end)
        started, finished = self._same_task(forked)
        if started is not None and finished is not None:
            name = phrases.task(started.kind, started.name, {})
            failure = None if finished.status == Task.SUCCEEDED else finished.failure
            same = failure is not None and self._signature(failure) == self._signature(self._failure)
            later = finished.status == Task.FAILED and finished.seq - started.seq > self._size
        else:
            name, failure = "the plan", None if end is None else end.failure
            same = plan_end == self._end
            later = self._task is None and end is not None and end.seq - added > self._steps - 1
        if failure is None and finished is not None:
            after = "and the plan succeeds" if end is None else f"later the plan fails: {phrases.failure(end.failure)}"
            return CONFIRMED, f"{name} succeeds, {after}"
        if failure is None:
            return (UNTESTED, "the fork doesn't start the failed task") if same else (CONFIRMED, "the plan succeeds")
        said = phrases.failure(failure)
        if trial.compares:
            return self._compared(failure, plan_end if self._task is None else None, same=same, later=later)
        if same and failure.type == "TimedOut" and started is not None and finished is not None:
            same = _succeeded(forked, started, finished.seq) <= self._succeeded  # more time helps, and isn't enough
            later = not same
        touched = [
            {(at.get("body"), at.get("body_link")) for at in pairs_of(each)} for each in (failure, self._failure)
        ]
        later = later and not (trial.succeeds or (touched[0] & touched[1] and failure.type == self._failure.type))
        further = "gets further, and " * later
        text = f"the same failure occurs: {said}" if same else f"{name} {further}fails in another way: {said}"
        return (REFUTED if not trial.partial else UNTESTED) if same else CONFIRMED if later else UNTESTED, text

    def _compared(self, failure: Failure, end: _End | None, *, same: bool, later: bool) -> tuple[str, str]:
        """Return the verdict on a change that wrote a checked value. The former value may fail the check as well.

        ``end`` is the end of the fork, if the plan's own code makes the check.
        """
        said, is_before = phrases.failure(failure), False
        if end is not None and self._end is not None and end[1] and self._end[1]:
            same = same or end[1][-1] == self._end[1][-1]
            is_before = self._is_before(end[1], self._end[1])
        old, new = (set(_WORD.findall(each.message)) for each in (self._checked, failure))  # such as names of objects
        if same and (new <= old or old <= new):
            return UNTESTED, f"the check still fails: {said}"
        if not same and (is_before or (failure.type != self._checked.type and not later)):
            return UNTESTED, f"{said} happens before the check"
        return CONFIRMED, f"the check passes, and {'another check' if same else 'the plan'} fails later: {said}"

    def _is_before(self, lines: Sequence[Line], others: Sequence[Line]) -> bool:
        """Return whether the first different line of two call stacks comes before the other one, outside of a loop."""
        differing = (pair for pair in zip(lines, others, strict=False) if pair[0].number != pair[1].number)
        one, other = next(differing, (lines[0], lines[0]))
        with self._reading:
            nodes = syntax_nodes(PlanSource(self._log).text(one.file))
        loops = [each for each in nodes if isinstance(each, ast.For | ast.While) and each.lineno <= one.number]
        again = any(other.number <= (each.end_lineno or 0) for each in loops)
        return one.number < other.number and not again and (one.file, one.function) == (other.file, other.function)

    def succeeds(self, tried: TriedTrial) -> bool:
        """Return whether the failed task succeeds in a fork; without a task, whether the fork confirms the cause."""
        if tried.verdict != CONFIRMED:
            return False
        with RecordReader(tried.file) as forked:
            started, finished = self._same_task(forked)
            return started is None or (finished is not None and finished.status == Task.SUCCEEDED)

    def _signature(self, failure: Failure) -> str:
        return signature(format_failure(failure), worded=self._worded)

    def _ended(self, log: RecordReader, end: Run | None) -> _End | None:
        """Return the signature and the lines of a plan's failure; None if the plan succeeded."""
        if end is None:
            return None
        parsed = list(parse_traceback(end.failure.traceback, PlanSource(log)))
        return self._signature(end.failure), parsed[-1].lines if parsed else ()

    def _same_task(self, forked: RecordReader) -> tuple[Task | None, Task | None]:
        """Return the start and the end of the failed task in a fork, with the same parameters if possible."""
        if self._task is None:
            return None, None
        for exact, number in self._numbers.items():
            for started in _alike(forked, self._task, exact=exact)[number : number + 1]:
                every = forked.records(Task, started.seq)
                ends = (each for each in every if (each.task, each.phase) == (started.task, Task.FINISHED))
                return started, next(ends, None)
        return None, None


def _succeeded(log: RecordReader, started: Task, end: int) -> int:
    """Return the number of tasks that succeeded within a task."""
    return sum(each.status == Task.SUCCEEDED for each in log.records(Task, started.seq, end))


def _late(forked: RecordReader, step: int) -> int:
    """Return the step of a fork's first change if the plan itself changed the world after the wanted step; else 0."""
    changes = iter(forked.records(Mutation, step + 1))
    first = next(changes, None)
    return 0 if first is None or first.by_fork else next((each.seq for each in changes if each.by_fork), 0)


def _alike(log: RecordReader, task: Task, *, exact: bool) -> list[Task]:
    """Return the starts of tasks with the same name at the same line, and with the same parameters if ``exact``."""

    def key(each: Task) -> object:
        site = Path(each.source_file).name, each.source_line
        return each.phase, each.kind, each.name, site, str(argument_values(each.parameters)) if exact else ""

    wanted = key(task)
    return [each for each in log.records(Task) if each.name == task.name and key(each) == wanted]
