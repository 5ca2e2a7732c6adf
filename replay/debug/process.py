"""The process in which a debugged plan runs: ``python -P -m replay.debug JSON``, from :mod:`.copies`."""

from __future__ import annotations

import gc
import os
from pathlib import Path
from typing import TYPE_CHECKING

from pycram.projection.child import die_with
from pycram.reasoning.queries.query import answered_by
from recorder.records import Change
from replay.debug.standing_clock import StandingClock
from replay.debug.stops import Course, StoppingSink
from replay.file.record_reader import RecordReader
from replay.retrace.process import run_plan

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any


def main(
    log: str,
    plan: str,
    arguments: Sequence[str],
    seed: int | None,
    *,
    by_program: bool,
    address: str,
    parent: int,
    folder: str,
    until: int,
    spacing: int | None,
    changes: Sequence[Mapping[str, Any]],
    moved: tuple[str, str] | None,
) -> None:
    """Run a plan up to a step.

    Args:
        log: the recording.
        plan: the plan's file.
        arguments: of the plan.
        seed: of random numbers; None to leave them as they are.
        by_program: whether the plan begins the recording itself.
        address: the prompt's socket.
        parent: the prompt's process, with which this one ends.
        folder: for the recordings of its projections.
        until: the first step at which it stops.
        spacing: nanoseconds of the recording between checkpoints; None for no checkpoints.
        changes: the fields of what was changed after its steps, where the recorded run is a fork.
        moved: the folder that the plan's recorded source was written to, and the one that it came from.
    """
    gc.freeze()  # to collect garbage is to write to all that is looked through: copies would no longer share it
    os.setsid()  # Ctrl-C at the prompt isn't the plan's
    die_with(parent)
    clock = StandingClock()
    clock.install()
    recorded = RecordReader(log)
    changed = [Change(**each) for each in changes]
    path = Path(folder) / recorded.path.name
    sink = StoppingSink(recorded, address, path, clock, Course(until), spacing, changed, moved)
    with answered_by(sink.answers):
        run_plan(plan, arguments, seed, recorded, lambda _: sink, sink.foreseen, by_program=by_program)
    sink.close()
    os._exit(0)
