"""``verify``: check that a recording is consistent, and that repeating its changes has the recorded effects."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator

from replay.cli.console import native_output_to_stderr, print_result, progress
from replay.cli.main import FAILED, FINE, INCOMPLETE
from replay.recording import Recording
from replay.report import report
from replay.report.phrases import plural
from replay.state.integrity import Deviation, Verification, verify_static


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 0: the recording is sound. 1: records differ. 3: the recording is damaged or incomplete."
    parser.add_argument("--static", action="store_true", help="check only the file and its records, without the engine")


def run(log: Recording, options: argparse.Namespace) -> int:
    start = time.perf_counter()
    with progress("step") as show:

        def show_step(step: int) -> None:
            show(step, len(log))

        if options.static:
            verification = verify_static(log, show_step)
        else:
            from replay.restore.verify import verify  # noqa: PLC0415  imports the engine

            with native_output_to_stderr():
                verification = verify(log, show_step)
    seconds = time.perf_counter() - start
    print_result(lambda: _data(verification, seconds), _lines(verification, seconds), as_json=options.json)
    if verification.damage or verification.incomplete:
        return INCOMPLETE
    return FINE if verification.sound else FAILED


def _lines(verification: Verification, seconds: float) -> Iterator[str]:
    problem = verification.problem
    if verification.damage:
        yield f"damaged: {verification.damage}"
    if problem is not None:
        where = "" if problem.step is None else f"step {problem.step}: "
        yield f"not sound: {where}{problem.cause}"
        if problem.deviation is not None:
            yield f"  {problem.deviation}"
        if problem.task:
            yield f"  in {' > '.join(problem.task)}"
    if verification.damage or problem is not None:
        return
    gap = f", up to the last record: {verification.incomplete}" if verification.incomplete else " without a gap"
    yield f"sound  {plural(verification.steps, 'step')}{gap}"
    ended = f"{verification.unfinished} of them unfinished" if verification.unfinished else "each started and finished"
    yield f"       {plural(verification.tasks, 'task')}, {ended}"
    yield f"       {plural(verification.keyframes, 'keyframe')} equal to the fold of the previous records"
    yield f"       {plural(verification.files, 'file')} with the recorded hashes"
    if verification.static:
        yield "note   models and changes weren't checked; run verify without --static"
        return
    changes, worlds = plural(verification.changes, "change"), plural(verification.worlds, "world")
    changes = f"{changes} in {worlds}, repeated in {seconds:.1f} s,"
    if verification.exact:
        yield f"exact  {changes} had the recorded effects, bit for bit"
    else:
        largest = f"effects within {verification.largest.size:.3g} of" if verification.largest else "exactly"
        yield f"near   {changes} had {largest} the recorded effects"
    if verification.largest is not None:
        yield f"       largest deviation: {verification.largest}"
    yield from _notes(verification)


def _notes(verification: Verification) -> Iterator[str]:
    if verification.environment:
        same = "" if verification.largest is None else "; not comparable bit for bit"
        yield f"note   the environment has changed since the recording: {', '.join(verification.environment)}{same}"
    if verification.late:
        yield f"note   {', '.join(verification.late)} began before the recording: the physics isn't compared"
    if verification.unknown:
        where = ", ".join(verification.unknown)
        yield f"note   a feature of a newer release changed {where}: the later physics isn't compared"
    if verification.dragged:
        where = ", ".join(verification.dragged)
        yield f"note   in {where}, somebody dragged an object by hand: the later physics isn't compared"


def _data(verification: Verification, seconds: float) -> dict[str, object]:
    facts = {"sound": verification.sound, "exact": verification.exact, "seconds": seconds}
    return report.fields_data(verification) | facts


@report.data.register(Deviation)
def _(deviation: Deviation) -> dict[str, object]:
    return report.fields_data(deviation) | {"size": deviation.size if math.isfinite(deviation.size) else None}
