"""The process in which a plan runs again: ``python -P -m replay.retrace JSON``, from :mod:`.plan_process`.

Its result is one line of JSON on the file descriptor that it is given: stdout and stderr are the plan's. When it is
only to compare, it ends there, wherever the plan is then. A fork goes on, into a recording of its own.
"""

from __future__ import annotations

import contextlib
import json
import os
import runpy
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pycram import cli
from recorder.mcap.sink import McapSink
from recorder.recording import redirected
from recorder.records import escaped
from recorder.tracing.process_identity import process
from replay.file.record_reader import RecordReader
from replay.retrace.guide import Guide

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from recorder.records import Record, Run
    from recorder.records.asset import AssetFile
    from recorder.tracing.journal import Sink
    from replay.retrace.guide import Difference

_STDOUT, _STDERR = 1, 2


class _Nowhere:
    """A sink for what a program records beside the recording in question."""

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        """Drop a record."""

    def attach(self, asset: AssetFile) -> None:
        """Drop a file."""

    def flush(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class _Fork:
    """A sink that writes a recording of its own, guided by another one to its step.

    Attributes:
        path: the recording's.
    """

    def __init__(self, guide: Guide, file: McapSink) -> None:
        self._guide = guide
        self._file = file
        self.path = file.path

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self._file.write(topic, record, payload)
        self._guide.write(topic, record, payload)

    def attach(self, asset: AssetFile) -> None:
        self._file.attach(asset)

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        self._guide.close()
        self._file.close()


def main(
    log: str,
    plan: str,
    arguments: Sequence[str],
    seed: int | None,
    *,
    by_program: bool,
    result: int,
    output: int,
    until: int | None,
    file: str | None,
    folder: str,
) -> None:
    """Run a plan again.

    Args:
        log: the recording.
        plan: the plan's file.
        arguments: of the plan.
        seed: of random numbers; None to leave them as they are.
        by_program: whether the plan begins the recording itself.
        result: the file descriptor for the result.
        output: the file descriptor for what a fork prints.
        until: the last step that is compared; None for all.
        file: the fork's recording; None to end when all is compared.
        folder: for the recordings of its projections, where it is only compared.
    """
    recorded = RecordReader(log)

    def report(equal: int, difference: Difference | None) -> None:
        found = None if difference is None else asdict(difference)
        os.write(result, json.dumps({"equal": equal, "difference": found}).encode() + b"\n")
        if file is None or difference is not None:
            os._exit(0)
        for stream, descriptor in ((sys.__stdout__, _STDOUT), (sys.__stderr__, _STDERR)):
            if stream is not None:
                stream.flush()
            os.dup2(output, descriptor)  # what the plan prints from here on is new

    guide = Guide(recorded, report, until, Path(folder) / recorded.path.name)
    began = recorded[0]

    def sink_of(run: Run) -> Guide | _Fork:
        if file is None:
            return guide
        run.origin.recording, run.origin.wall_time_ns = recorded.path.name, began.wall_time_ns
        run.origin.step = len(recorded) - 1 if until is None else until
        metadata = {"plan": run.name, "plan_arguments": " ".join(run.arguments), "started_ns": str(time.time_ns())}
        return _Fork(guide, McapSink(Path(file), metadata))

    run_plan(plan, arguments, seed, recorded, sink_of, by_program=by_program, file=Path(file or os.devnull))
    guide.close()


def run_plan(
    plan: str,
    arguments: Sequence[str],
    seed: int | None,
    recorded: RecordReader,
    sink_of: Callable[[Run], Sink],
    *,
    by_program: bool,
    file: Path = Path(os.devnull),
) -> None:
    """Run a plan as a program, whatever it ends with.

    Args:
        plan: the plan's file.
        arguments: of the plan.
        seed: of random numbers; None to leave them as they are.
        recorded: the recording that it has made.
        sink_of: gives the sink for the recording that is meant, of those that the plan makes.
        by_program: whether the plan begins the recording itself.
        file: where it would be recorded.
    """
    owner, guided = process(), False

    def redirect(run: Run) -> Sink | None:
        nonlocal guided
        if run.by_program != by_program or process() != owner:  # a projection makes a recording of its own
            return None
        if guided or not _is_meant(run, recorded[0], plan):
            return _Nowhere()
        guided = True
        return sink_of(run)

    with redirected(redirect):
        if by_program:
            sys.argv = [plan, *arguments]
            sys.path.insert(0, str(Path(plan).parent.resolve()))
            with contextlib.suppress(BaseException):  # whatever it raises: the recording has it
                runpy.run_path(plan, run_name="__main__")
        else:
            cli.run(Path(plan), file, arguments, seed=seed)


def _is_meant(run: Run, began: Record, plan: str) -> bool:
    """Whether a recording that a plan begins is the one that was made before, by their first records."""
    named = run.name in (getattr(began, "name", ""), escaped(Path(plan).stem))
    return named and run.number == (getattr(began, "number", 0) or 1)  # an older release's: the first
