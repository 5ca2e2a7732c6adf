"""Fork a run: the plan runs again, guided by the recording up to a step, and then continues live.

The plan then has its variables, blocks and branches again. The plan of a fork may be edited if its records up to the
step are the same. A fork may also change the world after the step, the answers of queries, or the seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from pycram.running import MAX_SEED
from recorder.records import Change, Run
from recorder.records.values import LEFT_OUT
from replay.errors import Damaged, ReplayError
from replay.file.record_reader import RecordReader
from replay.retrace.changes import change_text, checked_answer, settings as settings_of
from replay.retrace.decisions import BadChange
from replay.retrace.plan_process import FirstDifference, PlanProcess
from replay.retrace.retrace import Retracing, compared, reads_before


class NotForked(ReplayError):
    """The plan differs from the recording before the step of the fork."""

    def __init__(self, step: int, difference: FirstDifference, notes: Sequence[str] = ()) -> None:
        reads = "".join(f"; {each}" for each in (*notes, *reads_before(difference)))
        earlier = f"; fork at step {difference.step - 1} to change this" if difference.step else ""
        what = f"at step {difference.step} {difference.text}"
        super().__init__(f"the plan differs before step {step}: {what}{earlier}{reads}")
        self.step = step  # step of the fork
        self.difference = difference  # the first difference before that step


@dataclass(frozen=True, slots=True)
class Fork:
    """The result of a fork."""

    file: Path  # recording of the fork, with all steps from the plan's start
    step: int  # last common step of both recordings
    records: int  # number of records
    succeeded: bool  # whether the plan succeeded
    notes: tuple[str, ...]  # differences from the recorded conditions
    control: Retracing | None = None  # comparison of the unchanged plan with the recording; None if it wasn't requested
    unused: tuple[str, ...] = ()  # answers for decisions that the plan never had to make


def fork(
    log: RecordReader,
    step: int,
    file: Path,
    *,
    plan: str | Path | None = None,
    arguments: Sequence[str] | None = None,
    settings: Sequence[str] = (),
    world: str | None = None,
    answers: Sequence[str] = (),
    seed: int | None = None,
    control: bool = False,
    recorded_source: bool = False,
    begun: Callable[[], None] = lambda: None,
) -> Fork:
    """Run a plan again to a step of its recording, and continue from there into a new recording.

    Effects of the plan outside of its worlds (files, network) happen again. Output up to the step is dropped. Output
    after the step goes to stderr. The plan gets no input. :class:`.PlanProcess` explains the choice of the plan, its
    arguments and its source.

    Args:
        step: The last step that both runs have in common.
        file: The new recording, which replaces an existing file.
        settings: Values after the step, such as ``milk.position=1,2,0.9`` (:mod:`replay.retrace.changes`).
        world: The world of the settings; by default the last opened world.
        answers: Answers for the next matching queries after the step, such as ``reachable_object(milk)=false``.
        seed: The seed of random numbers and of the order of branches after the step.
        control: Also run the plan to its end without the changes. If the control run repeats the recording, all
            differences of the fork come from the changes.
        begun: A function that is called after all checks, before the plan runs.

    Raises:
        CantRetrace: The plan is missing, or the conditions of the run aren't recorded or can't be repeated.
        BadChange, NoSuchName: A setting or an answer is impossible.
        NotForked: The plan differs before the step.
        Damaged: An earlier step, or the step itself, is lost.
        ReplayError: The folder of the new recording doesn't exist.
    """
    log.check_file()  # after this check, all losses are known
    gap = next((gap for gap in log.lost() if gap.start <= step), None)
    if gap is not None:
        raise Damaged(log.path, f"the part before step {step}", f"step {gap.start} is lost; fork at an earlier step")
    if not file.absolute().parent.is_dir():
        raise ReplayError(f"{file}: there is no folder {file.parent}; make the folder first")
    process = PlanProcess(log, plan, arguments, until=step, recorded_source=recorded_source)
    changes = changes_of(log, step, settings, world, answers, seed)
    unchanged = None
    if control:
        secret = any(LEFT_OUT in text for text in process.began.arguments)
        unchanged = PlanProcess(log, None, arguments if secret else None, recorded_source=recorded_source)
    notes = tuple(process.notes())
    begun()
    with ThreadPoolExecutor() as beside, ExitStack() as undoing:
        if unchanged is not None:  # without this, an interrupted block would wait for the thread of the control run
            undoing.callback(unchanged.stop)
        controlling = None if unchanged is None else beside.submit(compared, unchanged, log)
        try:
            guided = process.run(file=file, changes=changes)
            if guided.difference is not None:
                raise NotForked(step, guided.difference, guided.notes)
        except ReplayError:
            file.unlink(missing_ok=True)
            raise
        controlled = None if controlling is None else controlling.result()
        undoing.pop_all()
    with RecordReader(file) as forked:
        began, end = forked[0], forked[-1]
        notes, unused = (*notes, *guided.notes), guided.unused
        if unused and isinstance(began, Run):  # answers of this fork or of an earlier fork
            given = [each for each in began.origin.changes if each.answer]
            listed = ", ".join(f"{each.answer} after step {each.step}" for each in given if each.answer in unused)
            notes += (f"{len(unused)} of the {len(given)} given answers weren't used: {listed}",)
        succeeded = getattr(end, "succeeded", False)
        return Fork(file, step, len(forked), succeeded, notes, controlled, unused)


def changes_of(
    log: RecordReader, step: int, given: Sequence[str], world: str | None, answers: Sequence[str], seed: int | None
) -> list[Change]:
    """Return settings, answers and a seed of :func:`fork` as changes after a step."""
    changes = settings_of(log, step, given, world)
    changes += [Change(step=step, answer=checked_answer(log, step, text)) for text in answers]
    if seed is not None:
        if not 0 <= seed <= MAX_SEED:
            raise BadChange(f"seed {seed}", f"a seed is a whole number from 0 to {MAX_SEED}")
        changes.insert(0, Change(step=step, seed=str(seed)))
    if changes and step == len(log) - 1 and log.closed:
        raise BadChange(change_text(changes[0]), f"step {step} is the last step; fork at an earlier step")
    return changes


def resume(
    log: RecordReader,
    file: Path,
    *,
    plan: str | Path | None = None,
    arguments: Sequence[str] | None = None,
    recorded_source: bool = False,
    begun: Callable[[], None] = lambda: None,
) -> Fork:
    """Continue a plan whose process was killed: a fork at the last step of its recording.

    If the plan has ended or still runs, ReplayError is raised. :func:`fork` describes the other errors.
    """
    if log.closed:
        raise ReplayError(f"{log.path}: this run has ended; use fork to run it again from a step")
    if log.live:
        raise ReplayError(f"{log.path}: this run is still running")
    return fork(log, len(log) - 1, file, plan=plan, arguments=arguments, recorded_source=recorded_source, begun=begun)
