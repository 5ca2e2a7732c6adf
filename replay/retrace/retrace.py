"""Retraces a recording: runs the plan's code again, and compares what happens with the recording, record by record.

The same plan, seed, arguments and working directory give the same records in the same order. So the first difference is
due to what has changed since: the plan, PyCRAM, the engine, or what the plan reads of the world outside.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from replay.retrace.outside import likely_reasons
from replay.retrace.plan_process import PlanProcess

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from replay.file.record_reader import RecordReader
    from replay.retrace.guide import Difference


@dataclass(frozen=True, slots=True)
class Retracing:
    """The result of retracing a recording.

    Attributes:
        plan: the file that was run.
        steps: of the recording.
        equal: number of records, from the first on, that came out the same.
        difference: the first one that didn't; None if all did, or those up to where the recording was cut or damaged.
        notes: what else is different from when it was recorded, and may be why.
        seconds: how long it took.
        taken: number of queries whose answers were taken from the recording, instead of being asked again.
    """

    plan: Path
    steps: int
    equal: int
    difference: Difference | None
    notes: tuple[str, ...]
    seconds: float
    taken: int = 0

    @property
    def identical(self) -> bool:
        """Whether no record came out differently."""
        return self.difference is None


def retrace(
    log: RecordReader,
    *,
    plan: str | Path | None = None,
    arguments: Sequence[str] | None = None,
    answers: Literal["asked", "recorded"] = "asked",
    recorded_source: bool = False,
) -> Retracing:
    """Run a recorded plan again in a process of its own, and compare record by record up to the first difference.

    The plan acts as it did then: what it does outside of its worlds (files, network) happens again. It has no input,
    and what it prints is not shown.

    Args:
        log: the recording.
        plan: another file than the recorded one.
        arguments: other arguments than the recorded ones.
        answers: "asked" to ask reasoning queries again and compare their answers; "recorded" to take these from the
            recording, which is faster: then it is compared what is asked, and when.
        recorded_source: whether the source that is attached to the recording runs, instead of that on the disk.

    Raises:
        CantRetrace: the plan isn't there, the recording doesn't tell how it was run, or a window, real time or the
            system rule out that it does the same; nothing has run.
    """
    process = PlanProcess(log, plan, arguments, recorded_source=recorded_source)
    return compared(process, log, take_answers=answers == "recorded")


def compared(process: PlanProcess, log: RecordReader, *, take_answers: bool = False) -> Retracing:
    """Run a plan again to the first difference from its recording."""
    notes = tuple(process.notes())
    start = time.perf_counter()
    outcome = process.run(take_answers=take_answers)
    seconds = time.perf_counter() - start
    if outcome.difference is not None:
        notes += tuple(likely_reasons(log, outcome.difference))
    return Retracing(process.program, len(log), outcome.equal, outcome.difference, notes, seconds, outcome.taken)
