"""``verify``: whether a recording is consistent, and its changes, made again, have the recorded effects."""

from __future__ import annotations

import math
import sys
import time
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from replay.cli.console import native_output_to_stderr, print_json, print_text
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
    """Add nothing."""
    parser.epilog = "Exit code 0: it is sound. 1: it isn't. 3: its readable part is, but it is incomplete."


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the verdict."""
    from replay.restore.verify import verify  # noqa: PLC0415  --help needn't wait for the engine

    start = time.perf_counter()
    with native_output_to_stderr(), _progress(len(log)) as progress:
        verdict = verify(log, progress)
    seconds = time.perf_counter() - start
    if options.json:
        print_json(_plain(verdict, seconds))
    else:
        for line in _lines(verdict, seconds):
            print_text(line)
    return FINE if verdict.sound else FAILED


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[int], None] | None]:
    """Yield a function that prints the progress; None if stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    said = time.monotonic()

    def say(step: int) -> None:
        nonlocal said
        if time.monotonic() - said > _PERIOD:
            said = time.monotonic()
            print(f"\rstep {step} of {steps}", end="", file=sys.stderr, flush=True)

    try:
        yield say
    finally:
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def _lines(verdict: Verification, seconds: float) -> Iterator[str]:
    problem = verdict.problem
    if problem is not None:
        yield from _problem(problem)
        return
    yield f"sound  {_count(verdict.steps, 'step')} without a gap"
    yield f"       {_count(verdict.tasks, 'task')}, each begun and ended"
    yield f"       {_count(verdict.keyframes, 'keyframe')} equal to the fold of the records before"
    yield f"       {_count(verdict.files, 'file')} as attached"
    made = f"{_count(verdict.changes, 'change')} in {_count(verdict.worlds, 'world')}, made again in {seconds:.1f} s,"
    if verdict.exact:
        yield f"exact  {made} had the recorded effects, bit for bit"
    else:
        largest = f"within {verdict.largest.size:.3g}" if verdict.largest else "bit for bit"
        yield f"near   {made} had the recorded effects {largest}"
    if verdict.largest is not None:
        yield f"       largest deviation: {verdict.largest}"
    if verdict.environment:
        same = "" if verdict.largest is None else "; not comparable bit for bit"
        yield f"note   the environment is a different one: {', '.join(verdict.environment)}{same}"
    if verdict.late:
        yield f"note   {', '.join(verdict.late)} began before the recording: physics in it is not compared"


def _problem(problem: Problem) -> Iterator[str]:
    where = "" if problem.step is None else f"step {problem.step}: "
    yield f"not sound: {where}{problem.cause}"
    if problem.deviation is not None:
        yield f"  {problem.deviation}"
    if problem.task:
        yield f"  in {' > '.join(problem.task)}"


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _plain(verdict: Verification, seconds: float) -> dict[str, object]:
    data = asdict(verdict) | {"sound": verdict.sound, "exact": verdict.exact, "seconds": seconds}
    data["largest"] = _deviation(verdict.largest)
    if verdict.problem is not None:
        data["problem"]["deviation"] = _deviation(verdict.problem.deviation)
    return data


def _deviation(deviation: Deviation | None) -> dict[str, object] | None:
    if deviation is None:
        return None
    return asdict(deviation) | {"size": deviation.size if math.isfinite(deviation.size) else None}
