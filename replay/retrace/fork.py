"""Forks a run: the plan runs again, guided by the recording up to a step, and goes on from there, live.

So the plan's variables, blocks and branches are what they were, not only its world. From that step on the plan may be
another one: an edited file whose records up to there are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from replay.errors import Damaged, ReplayError
from replay.file.record_reader import RecordReader
from replay.retrace.plan_process import PlanProcess

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from replay.retrace.guide import Difference


class NotForked(ReplayError):
    """The plan does something else before the step at which it was to leave the recording.

    Attributes:
        step: where it was to leave.
        difference: the first record that came out differently.
    """

    def __init__(self, step: int, difference: Difference) -> None:
        super().__init__(f"it is another run before step {step}: at step {difference.step} {difference.text}")
        self.step = step
        self.difference = difference


@dataclass(frozen=True, slots=True)
class Fork:
    """A run that was forked from another one.

    Attributes:
        file: its recording, which is whole: it has the steps before the fork as well.
        step: the last one that both have.
        records: of its recording.
        succeeded: whether the plan ended well.
        notes: what else is different from when the first one was recorded.
    """

    file: Path
    step: int
    records: int
    succeeded: bool
    notes: tuple[str, ...]


def fork(
    log: RecordReader,
    step: int,
    file: Path,
    *,
    plan: str | Path | None = None,
    arguments: Sequence[str] | None = None,
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

    Raises:
        CantRetrace: the plan isn't there, or the recording doesn't tell how it was run; nothing has run.
        NotForked: the plan did something else before that step; there is no new recording.
        Damaged: steps up to that one are lost; nothing has run.
        ReplayError: there is no folder for the new recording; nothing has run.
    """
    gap = next((gap for gap in log.lost() if gap.start <= step), None)
    if gap is not None:
        raise Damaged(log.path, f"what led to step {step}", f"step {gap.start} is lost; fork before it")
    if not file.absolute().parent.is_dir():
        raise ReplayError(f"{file}: there is no folder {file.parent}; make the folder first")
    process = PlanProcess(log, plan, arguments)
    notes = tuple(process.notes())
    try:
        outcome = process.run(until=step, file=file)
    except ReplayError:
        file.unlink(missing_ok=True)
        raise
    if outcome.difference is not None:
        file.unlink(missing_ok=True)
        raise NotForked(step, outcome.difference)
    with RecordReader(file) as forked:
        end = forked[-1]
        return Fork(file, step, len(forked), getattr(end, "succeeded", False), notes)


def resume(
    log: RecordReader, file: Path, *, plan: str | Path | None = None, arguments: Sequence[str] | None = None
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
    return fork(log, len(log) - 1, file, plan=plan, arguments=arguments)
