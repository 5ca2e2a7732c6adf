"""``verify``: whether a recording is consistent, and its changes, made again, have the recorded effects."""

from __future__ import annotations

import math
import sys
import time
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from replay.cli.console import native_output_to_stderr, print_result
from replay.cli.main import FAILED, FINE

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from replay.recording import Recording
    from replay.restore.verify import Verification
    from replay.state.deviation import Deviation
    from replay.state.integrity import Problem

_PERIOD: Final = 0.2  # s between progress messages


def add(parser: argparse.ArgumentParser) -> None:
    """Describe the exit codes."""
    parser.epilog = "Exit code 0: it is sound. 1: it isn't. 3: its readable part is, but it is incomplete."


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the verdict."""
    from replay.restore.verify import verify  # noqa: PLC0415  --help needn't wait for the engine

    start = time.perf_counter()
    with native_output_to_stderr(), _progress(len(log)) as progress:
        verification = verify(log, progress)
    seconds = time.perf_counter() - start
    print_result(lambda: _plain(verification, seconds), _lines(verification, seconds), as_json=options.json)
    return FINE if verification.sound else FAILED


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[int], None] | None]:
    """Yield a function that prints the progress; None if stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    printed = time.monotonic()

    def report(step: int) -> None:
        nonlocal printed
        if time.monotonic() - printed > _PERIOD:
            printed = time.monotonic()
            print(f"\rstep {step} of {steps}", end="", file=sys.stderr, flush=True)

    try:
        yield report
    finally:
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def _lines(verification: Verification, seconds: float) -> Iterator[str]:
    problem = verification.problem
    if problem is not None:
        yield from _problem(problem)
        return
    yield f"sound  {_count(verification.steps, 'step')} without a gap"
    ended = f"{verification.unfinished} of them not ended then" if verification.unfinished else "each begun and ended"
    yield f"       {_count(verification.tasks, 'task')}, {ended}"
    yield f"       {_count(verification.keyframes, 'keyframe')} equal to the fold of the records before"
    yield f"       {_count(verification.files, 'file')} as attached"
    changes, worlds = _count(verification.changes, "change"), _count(verification.worlds, "world")
    changes = f"{changes} in {worlds}, made again in {seconds:.1f} s,"
    if verification.exact:
        yield f"exact  {changes} had the recorded effects, bit for bit"
    else:
        largest = f"within {verification.largest.size:.3g}" if verification.largest else "bit for bit"
        yield f"near   {changes} had the recorded effects {largest}"
    if verification.largest is not None:
        yield f"       largest deviation: {verification.largest}"
    if verification.environment:
        same = "" if verification.largest is None else "; not comparable bit for bit"
        yield f"note   the environment is a different one: {', '.join(verification.environment)}{same}"
    if verification.late:
        yield f"note   {', '.join(verification.late)} began before the recording: physics in it is not compared"
    if verification.dragged:
        where = ", ".join(verification.dragged)
        yield f"note   in {where} something was dragged by hand: from there on, physics in it is not compared"


def _problem(problem: Problem) -> Iterator[str]:
    where = "" if problem.step is None else f"step {problem.step}: "
    yield f"not sound: {where}{problem.cause}"
    if problem.deviation is not None:
        yield f"  {problem.deviation}"
    if problem.task:
        yield f"  in {' > '.join(problem.task)}"


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _plain(verification: Verification, seconds: float) -> dict[str, object]:
    data = asdict(verification) | {"sound": verification.sound, "exact": verification.exact, "seconds": seconds}
    data["largest"] = _deviation(verification.largest)
    if verification.problem is not None:
        data["problem"]["deviation"] = _deviation(verification.problem.deviation)
    return data


def _deviation(deviation: Deviation | None) -> dict[str, object] | None:
    if deviation is None:
        return None
    return asdict(deviation) | {"size": deviation.size if math.isfinite(deviation.size) else None}
