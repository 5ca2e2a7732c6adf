"""Test the causes of a failure: forks take each cause away, and a control run has no changes.

A fork without a cause that fails as the original refutes the cause. A fork in which the failure doesn't come confirms
the cause. A fork with another, later failure confirms the cause, too. The verdicts only hold if the control run repeats
the whole recording.
"""

from __future__ import annotations

import re
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from recorder.records import Run, Task, argument_values
from replay.errors import ReplayError
from replay.explain.causes.trials import CONFIRMED, REFUTED, UNTESTED, Proof, TriedTrial
from replay.file.record_reader import RecordReader
from replay.history.source import PlanSource, parse_traceback
from replay.history.tasks import uncaught_failure
from replay.report import phrases
from replay.retrace.fork import changes_of
from replay.retrace.plan_process import CantRetrace, PlanProcess
from replay.retrace.retrace import compared

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.records import Change, Failure
    from replay.explain.causes.trials import Trial
    from replay.explain.why import Why
    from replay.retrace.retrace import Retracing

BUDGET: Final = 12
"""Default number of forks."""

_AT_ONCE: Final = 2  # number of parallel forks
_MAX_TRIALS: Final = 3  # largest number of forks of a cause
_SECONDS: Final = (30.0, 10.0)  # largest duration of a fork: in s, and as a multiple of the original run
_NUMBER: Final = re.compile(r"-?\d+(?:\.\d+)?")
_RANK: Final = (CONFIRMED, UNTESTED, REFUTED)


def prove(
    log: RecordReader,
    why: Why,
    *,
    budget: int = BUDGET,
    keep: Path | None = None,
    arguments: Sequence[str] | None = None,
    recorded_source: bool = False,
) -> tuple[Why, Retracing]:
    """Test the causes of an explanation in forks.

    Effects outside of the plan's worlds (files, network) happen again in each run.

    Args:
        log: the recording.
        why: The explanation of a failure in the recording.
        budget: The largest number of forks.
        keep: A folder for the recordings of the forks. By default, the recordings are deleted.
        arguments: the plan's arguments, instead of the recorded arguments.
        recorded_source: whether to run the source that is attached to the recording, instead of the files on the disk.

    Returns:
        The explanation with its verdicts, confirmed causes first, and the control run.

    Raises:
        CantRetrace: The plan can't run again.
    """
    unchanged = PlanProcess(log, None, arguments, recorded_source=recorded_source)
    with (
        TemporaryDirectory(prefix="pycram-prove-") as temporary,
        ThreadPoolExecutor(_AT_ONCE) as pool,
        ExitStack() as undoing,
    ):
        folder = Path(temporary) if keep is None else keep
        folder.mkdir(parents=True, exist_ok=True)
        undoing.callback(unchanged.stop)  # otherwise an interrupted block would wait for its runs
        control = pool.submit(compared, unchanged, log)
        prover = _Prover(log, why, folder, arguments, recorded_source=recorded_source, kept=keep is not None)
        undoing.callback(prover.stop)
        known: dict[Trial, TriedTrial] = {}  # causes may share trials
        tried: dict[int, list[TriedTrial]] = {number: [] for number in range(len(why.causes))}
        case = why.case
        trials = [list(cause.trials(case)) if case is not None else [] for cause in why.causes]
        for turn in range(_MAX_TRIALS):
            wanted = [
                (number, trials[number][turn])
                for number, found in tried.items()
                if turn < len(trials[number]) and all(each.verdict != CONFIRMED for each in found)
            ][: max(0, budget - prover.forks)]
            fresh = [each for each in dict.fromkeys(trial for _, trial in wanted) if each not in known]
            known |= zip(fresh, pool.map(prover.tried, fresh), strict=True)
            for number, trial in wanted:
                tried[number].append(known[trial])
        result = control.result()
        proofs = [_proof(tried[number], trials[number], why.causes[number].untestable) for number in tried]
        if not result.identical:
            proofs = [_uncontrolled(proof, result) for proof in proofs]
        order = sorted(tried, key=lambda number: _RANK.index(proofs[number].verdict))
        causes = tuple(why.causes[number] for number in order)
        return replace(why, causes=causes, proofs=tuple(proofs[number] for number in order)), result


def _proof(tried: Sequence[TriedTrial], trials: Sequence[Trial], untestable: str) -> Proof:
    refuting = [each for each in tried if each.verdict == REFUTED]
    if len(refuting) < len(tried):
        refuting = [each for each in refuting if each.trial.decisive]
    confirming = [each for each in tried if each.verdict == CONFIRMED]
    for found in (confirming, refuting, [each for each in tried if each.verdict == UNTESTED], tried):
        if found:
            verdict = found[0].verdict if found is not tried else UNTESTED
            text = f"{'not tested' if verdict == UNTESTED else verdict}: {found[0].text}"
            return Proof(verdict, text, tuple(tried))
    return Proof(UNTESTED, f"not tested: {'the budget of forks was spent' if trials else untestable}")


def _uncontrolled(proof: Proof, control: Retracing) -> Proof:
    difference = control.difference.text if control.difference is not None else ""
    text = f"not tested: without a change, the plan doesn't do the same again: {difference}"
    return Proof(UNTESTED, text, tuple(replace(each, verdict=UNTESTED) for each in proof.forks))


@dataclass(frozen=True, slots=True)
class _Failed:
    """The features of a failed task, which identify the task in another run."""

    kind: str
    name: str
    site: tuple[str, int]  # file name and line
    parameters: str  # as recorded
    number: int  # number of earlier tasks with this name
    among_same: int  # number of earlier tasks with this name and the same parameters
    size: int  # number of records from its begin to its end
    signature: tuple[str, str]  # of its failure


class _Prover:
    """A runner of an explanation's trials as forks."""

    def __init__(
        self,
        log: RecordReader,
        why: Why,
        folder: Path,
        arguments: Sequence[str] | None,
        *,
        recorded_source: bool,
        kept: bool,
    ) -> None:
        self._log = log
        self._why = why
        self._folder = folder
        self._arguments = arguments
        self._recorded_source = recorded_source
        self._kept = kept
        self._reading = threading.Lock()  # a single thread at a time reads the recording
        self._task = _failed_task(log, why)
        self._end = _end(log, uncaught_failure(log))
        self._steps = len(log)
        self._seconds = max(_SECONDS[0], _SECONDS[1] * why.run.seconds)
        self.forks = 0
        self._running: set[PlanProcess] = set()
        self._stopped = False

    def stop(self) -> None:
        """Stop all forks, and start no more forks."""
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
                world = trial.world or None
                changes = changes_of(self._log, trial.step, trial.settings, world, trial.answers, None)
                process = PlanProcess(
                    self._log, None, self._arguments, until=trial.step, recorded_source=self._recorded_source
                )
            except ReplayError as error:
                return TriedTrial(trial, UNTESTED, f"{trial.words}: {error}")
            self._running.add(process)
        verdict, text = self._run(process, file, changes, trial)
        return TriedTrial(trial, verdict, f"{trial.words} after step {trial.step}: {text}", str(file) * self._kept)

    def _run(self, process: PlanProcess, file: Path, changes: Sequence[Change], trial: Trial) -> tuple[str, str]:
        timer = threading.Timer(self._seconds, process.stop)
        timer.start()
        try:
            guided = process.run(file=file, changes=changes, quiet=True)
        except CantRetrace as error:
            late = "the fork didn't end in time" if not timer.is_alive() else str(error)
            return UNTESTED, late
        except ReplayError as error:
            return UNTESTED, str(error)
        finally:
            timer.cancel()
        if guided.difference is not None:
            return UNTESTED, f"the plan differs before the change: {guided.difference.text}"
        if guided.unused:
            return UNTESTED, f"the decision {', '.join(guided.unused)} didn't come"
        with RecordReader(file) as forked:
            needed = None if not trial.needs else _next_end(forked, trial)
            if needed is not None and needed.status != Task.SUCCEEDED:
                return UNTESTED, f"{trial.needs} fails nevertheless: {phrases.failure(needed.failure)}"
            return self._judged(forked, len(changes))

    def _judged(self, forked: RecordReader, added: int) -> tuple[str, str]:
        """Return the verdict of a fork, and its outcome in words."""
        if not isinstance(forked[-1], Run):
            return UNTESTED, "the fork ended without an end of its recording"
        end = uncaught_failure(forked)
        task = None if self._task is None else _same_task(forked, self._task)
        if task is None or self._task is None:
            return self._judged_by_end(forked, end, added)
        started, finished = task
        name = phrases.task(started.kind, started.name, {})
        if finished.status == Task.SUCCEEDED:
            after = "and the plan succeeds" if end is None else f"later the plan fails: {phrases.failure(end.failure)}"
            return CONFIRMED, f"{name} succeeds, {after}"
        said = phrases.failure(finished.failure)
        if _signature(finished.failure) == self._task.signature:
            return REFUTED, f"the same failure comes: {said}"
        if finished.status == Task.FAILED and finished.seq - started.seq > self._task.size:
            return CONFIRMED, f"{name} gets further, and fails otherwise: {said}"
        return UNTESTED, f"{name} fails otherwise: {said}"

    def _judged_by_end(self, forked: RecordReader, end: Run | None, added: int) -> tuple[str, str]:
        if end is None:
            decided = self._end is not None
            return (CONFIRMED, "the plan succeeds") if decided else (UNTESTED, "the failed task doesn't come")
        said = phrases.failure(end.failure)
        if _end(forked, end) == self._end:
            return REFUTED, f"the same failure comes: {said}"
        if end.seq - added > self._steps - 1:
            return CONFIRMED, f"another failure comes later: {said}"
        return UNTESTED, f"another failure comes: {said}"


def _signature(failure: Failure) -> tuple[str, str]:
    """Return the type and the message of a failure, without its numbers."""
    return failure.type, _NUMBER.sub("#", failure.message)


def _end(log: RecordReader, end: Run | None) -> object:
    """Return the signature and the innermost line of a plan's failure; None if the plan succeeded."""
    if end is None:
        return None
    parsed = list(parse_traceback(end.failure.traceback, PlanSource(log)))
    return _signature(end.failure), parsed[-1].lines[-1:] if parsed else ()


def _failed_task(log: RecordReader, why: Why) -> _Failed | None:
    if why.task is None or why.task.finished is None:
        return None
    record = why.task.motion.started
    finished = why.task.motion.finished or why.task.finished
    found = [each for each in _alike(log, record.kind, record.name, _site(record)) if each.seq < record.seq]
    given = _given(record)
    same = sum(_given(each) == given for each in found)
    return _Failed(
        record.kind,
        record.name,
        _site(record),
        given,
        len(found),
        same,
        finished.seq - record.seq,
        _signature(finished.failure),
    )


def _same_task(log: RecordReader, wanted: _Failed) -> tuple[Task, Task] | None:
    """Return the start and the end of the same task in another run.

    Prefer a task with the same parameters, and then a task with the same number of earlier tasks.
    """
    found = list(_alike(log, wanted.kind, wanted.name, wanted.site))
    same = [each for each in found if _given(each) == wanted.parameters]
    started = same[wanted.among_same : wanted.among_same + 1] or found[wanted.number : wanted.number + 1]
    for each in started:
        for record in log.records(Task, each.seq):
            if record.task == each.task and record.phase == Task.FINISHED:
                return each, record
    return None


def _next_end(log: RecordReader, trial: Trial) -> Task | None:
    """Return the end of the motion that a trial lets succeed."""
    ends = (each for each in log.records(Task, trial.step + 1) if each.kind == "motion" and each.name == trial.needs)
    return next((each for each in ends if each.phase == Task.FINISHED), None)


def _alike(log: RecordReader, kind: str, name: str, site: tuple[str, int]) -> Iterator[Task]:
    for record in log.records(Task):
        if record.phase == Task.STARTED and (record.kind, record.name, _site(record)) == (kind, name, site):
            yield record


def _site(record: Task) -> tuple[str, int]:
    return Path(record.source_file).name, record.source_line


def _given(record: Task) -> str:
    return str(argument_values(record.parameters))
