"""Forks a run: the plan runs again, guided by the recording up to a step, and goes on from there, live.

So the plan's variables, blocks and branches are what they were, not only its world. From that step on something may be
different: the plan itself, as an edited file whose records up to there are the same; the world; the answer of a query;
the seed.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Change, Query, Run
from recorder.records.values import LEFT_OUT
from replay.errors import Damaged, ReplayError
from replay.file.record_reader import RecordReader
from replay.retrace.changes import BadChange, parse_answer, seed_change, settings as settings_of, text_of
from replay.retrace.plan_process import PlanProcess
from replay.retrace.retrace import compared, reads_before

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from replay.retrace.guide import FirstDifference
    from replay.retrace.retrace import Retracing


class NotForked(ReplayError):
    """The plan does something else before the step at which it was to leave the recording."""

    def __init__(self, step: int, difference: FirstDifference) -> None:
        reads = "".join(f"; {each}" for each in reads_before(difference))
        super().__init__(f"it is another run before step {step}: at step {difference.step} {difference.text}{reads}")
        self.step = step  # where it was to leave
        self.difference = difference  # the first record that came out differently


@dataclass(frozen=True, slots=True)
class Fork:
    """A run that was forked from another one."""

    file: Path  # its recording, which is whole: it has the steps before the fork as well
    step: int  # the last one that both have
    records: int  # of its recording
    succeeded: bool  # whether the plan ended well
    notes: tuple[str, ...]  # what else is different from when the first one was recorded
    #: the plan run again without the change, compared with the first recording to its end; None if it wasn't.
    control: Retracing | None = None


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
    """Run a plan again to a step of its recording, and on from there into a new recording.

    What the plan does outside of its worlds (files, network) up to that step happens again; what it prints up to there
    is held back, the rest goes to stderr. It has no input.

    Args:
        log: the recording.
        step: the last step that is the same.
        file: the new recording; what is there is replaced.
        plan: another file than the recorded one: an edited plan.
        arguments: other arguments than the recorded ones.
        settings: what is set after that step, as ``milk.position=1,2,0.9``; see :mod:`replay.retrace.changes`.
        world: the world of the objects that are set; by default the open one that was opened last.
        answers: of the next queries after that step that fit, as ``reachable_object(milk)=false``.
        seed: of random numbers and of the order of branches from that step on.
        control: whether the plan is run again without the change as well, to its end: what differs in the fork is due
            to the change if that comes out as recorded.
        recorded_source: whether the source that is attached to the recording runs, instead of that on the disk.
        begun: called when all is checked, and the plan is about to run.

    Raises:
        CantRetrace: the plan isn't there, the recording doesn't tell how it was run, or a window, real time or the
            system rule out that it does the same; nothing has run.
        BadChange, NoSuchName: a setting or an answer can't be; nothing has run.
        NotForked: the plan did something else before that step; there is no new recording.
        Damaged: steps up to that one are lost; nothing has run.
        ReplayError: there is no folder for the new recording; nothing has run.
    """
    log.check()  # what is lost is known only then
    gap = next((gap for gap in log.lost() if gap.start <= step), None)
    if gap is not None:
        raise Damaged(log.path, f"what led to step {step}", f"step {gap.start} is lost; fork before it")
    if not file.absolute().parent.is_dir():
        raise ReplayError(f"{file}: there is no folder {file.parent}; make the folder first")
    process = PlanProcess(log, plan, arguments, until=step, recorded_source=recorded_source)
    changes = _changes(log, step, settings, world, answers, seed)
    unchanged = _unchanged(log, arguments, recorded_source=recorded_source) if control else None
    notes = tuple(process.notes())
    begun()
    with ThreadPoolExecutor() as beside, ExitStack() as undoing:
        if unchanged is not None:  # else an interrupted block waits for its thread, and that for the control's plan
            undoing.callback(unchanged.stop)
        controlling = None if unchanged is None else beside.submit(compared, unchanged, log)
        _go_on(process, step, file, changes)
        controlled = None if controlling is None else controlling.result()
        undoing.pop_all()
    with RecordReader(file) as forked:
        end = forked[-1]
        notes += tuple(_unasked(forked))
        return Fork(file, step, len(forked), getattr(end, "succeeded", False), notes, controlled)


def _go_on(process: PlanProcess, step: int, file: Path, changes: Sequence[Change]) -> None:
    """Run the plan to its end; there is no new recording if it didn't come to the step as it did."""
    try:
        difference = process.run(file=file, changes=changes).difference
        if difference is not None:
            raise NotForked(step, difference)
    except ReplayError:
        file.unlink(missing_ok=True)
        raise


def _changes(
    log: RecordReader, step: int, given: Sequence[str], world: str | None, answers: Sequence[str], seed: int | None
) -> list[Change]:
    """Return the changes of a fork, checked."""
    changes = settings_of(log, step, given, world)
    for text in answers:
        parse_answer(text)
        changes.append(Change(step=step, answer=text))
    if seed is not None:
        changes.insert(0, seed_change(step, seed))
    if changes and step == len(log) - 1 and log.closed:
        raise BadChange(text_of(changes[0]), f"step {step} is the last one: nothing comes after it")
    return changes


def _unchanged(log: RecordReader, arguments: Sequence[str] | None, *, recorded_source: bool) -> PlanProcess:
    """Return the plan as it was, to its end; the arguments that are given count where the recorded ones lack some."""
    began = log[0]
    lacking = isinstance(began, Run) and any(LEFT_OUT in text for text in began.arguments)
    return PlanProcess(log, None, arguments if lacking else None, recorded_source=recorded_source)


def _unasked(forked: RecordReader) -> Iterator[str]:
    """Yield in words that answers, of this fork or of those before it, weren't asked for."""
    given = sum(record.by_fork for record in forked.records(Query))
    recorded = forked[0]
    wanted = [each for each in recorded.origin.changes if each.answer] if isinstance(recorded, Run) else []
    if given < len(wanted):
        listed = ", ".join(f"{change.answer} after step {change.step}" for change in wanted)
        yield f"{len(wanted) - given} of the {len(wanted)} given answers weren't asked for: {listed}"


def resume(
    log: RecordReader,
    file: Path,
    *,
    plan: str | Path | None = None,
    arguments: Sequence[str] | None = None,
    recorded_source: bool = False,
    begun: Callable[[], None] = lambda: None,
) -> Fork:
    """Have a plan whose process was killed go on where it was: a fork at the last step of its recording.

    Raises:
        ReplayError: it wasn't killed: it has ended, or still runs.
        CantRetrace, NotForked, Damaged: as :func:`fork`.
    """
    if log.closed:
        raise ReplayError(f"{log.path}: this run has come to its end; fork runs it again from a step")
    if log.live:
        raise ReplayError(f"{log.path}: this run still goes on")
    return fork(log, len(log) - 1, file, plan=plan, arguments=arguments, recorded_source=recorded_source, begun=begun)
