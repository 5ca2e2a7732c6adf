"""The process in which a debugged plan runs: ``python -P -m replay.debug JSON``, from :mod:`.copies`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from pycram.projection.child import die_with
from replay.debug.standing_clock import StandingClock
from replay.debug.stops import Course, StoppingSink
from replay.file.record_reader import RecordReader
from replay.retrace.process import run_plan

if TYPE_CHECKING:
    from collections.abc import Sequence


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
    spacing: float | None,
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
        spacing: seconds of processor time between checkpoints; None for no checkpoints.
    """
    os.setsid()  # Ctrl-C at the prompt isn't the plan's
    die_with(parent)
    clock = StandingClock()
    clock.install()
    recorded = RecordReader(log)
    sink = StoppingSink(recorded, address, Path(folder) / recorded.path.name, clock, Course(until), spacing)
    run_plan(plan, arguments, seed, recorded, lambda _: sink, by_program=by_program)
    sink.close()
    os._exit(0)
