"""Retraces a recording: runs the plan's code again, and compares what happens with the recording, record by record.

The same plan, seed, arguments and working directory give the same records in the same order. So the first difference is
due to what has changed since: the plan, PyCRAM, the engine, or what the plan reads of the world outside.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

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
    """

    plan: Path
    steps: int
    equal: int
    difference: Difference | None
    notes: tuple[str, ...]
    seconds: float

    @property
    def identical(self) -> bool:
        """Whether no record came out differently."""
        return self.difference is None


def retrace(log: RecordReader, *, plan: str | Path | None = None, arguments: Sequence[str] | None = None) -> Retracing:
    """Run a recorded plan again in a process of its own, and compare record by record up to the first difference.

    The plan acts as it did then: what it does outside of its worlds (files, network) happens again. It has no input,
    and what it prints is not shown.

    Args:
        log: the recording.
        plan: another file than the recorded one.
        arguments: other arguments than the recorded ones.

    Raises:
        CantRetrace: the plan isn't there, or the recording doesn't tell how it was run; nothing has run.
    """
    process = PlanProcess(log, plan, arguments)
    notes = tuple(process.notes())
    start = time.perf_counter()
    outcome = process.run()
    seconds = time.perf_counter() - start
    return Retracing(process.program, len(log), outcome.equal, outcome.difference, notes, seconds)
