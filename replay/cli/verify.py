"""``verify``: whether a recording agrees with itself, and its changes, made again, have the effects on record."""

from __future__ import annotations

import math
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_json, results_only, tell
from replay.cli.main import FAILED, FINE

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from replay.recording import Recording
    from replay.restore.verify import Verdict
    from replay.state.deviation import Deviation
    from replay.state.integrity import Problem
    from replay.state.json_data import Plain

_PERIOD: Final = 0.2  # s between words of progress


def add(parser: argparse.ArgumentParser) -> None:
    """Takes nothing more."""
    parser.epilog = "Exit code 0: it is sound. 1: it isn't. 3: what there is of it is, but it is incomplete."


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the verdict."""
    from replay.restore.verify import verify  # noqa: PLC0415  --help needn't wait for the engine

    start = time.perf_counter()
    with results_only(), _progress(len(log)) as progress:
        verdict = verify(log, progress)
    seconds = time.perf_counter() - start
    if options.json:
        print_json(_plain(verdict, seconds))
    else:
        for line in _lines(verdict, seconds):
            tell(line)
    return FINE if verdict.sound else FAILED


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[int], None] | None]:
    """What shows how far it is, where somebody can see it."""
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


def _lines(verdict: Verdict, seconds: float) -> Iterator[str]:
    problem = verdict.problem
    if problem is not None:
        yield from _told(problem)
        return
    yield f"sound  {_count(verdict.steps, 'step')} without a gap"
    yield f"       {_count(verdict.tasks, 'task')}, each begun and ended"
    yield f"       {_count(verdict.keyframes, 'keyframe')} as the records before add up to"
    yield f"       {_count(verdict.files, 'file')} as attached"
    made = f"{_count(verdict.changes, 'change')} in {_count(verdict.worlds, 'world')}, made again in {seconds:.1f} s,"
    if verdict.exact:
        yield f"exact  {made} had the effects on record, bit for bit"
    else:
        largest = f"within {verdict.largest.size:.3g}" if verdict.largest else "bit for bit"
        yield f"near   {made} had the effects on record {largest}"
    if verdict.largest is not None:
        yield f"       farthest: {verdict.largest}"
    if verdict.environment:
        same = "" if verdict.largest is None else "; not comparable bit for bit"
        yield f"note   the environment is another: {', '.join(verdict.environment)}{same}"
    if verdict.late:
        yield f"note   {', '.join(verdict.late)} began before the recording: what physics did there isn't compared"


def _told(problem: Problem) -> Iterator[str]:
    where = "" if problem.step is None else f"step {problem.step}: "
    yield f"not sound: {where}{problem.cause}"
    if problem.deviation is not None:
        yield f"  {problem.deviation}"
    if problem.task:
        yield f"  in {' > '.join(problem.task)}"


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _plain(verdict: Verdict, seconds: float) -> Plain:
    problem = verdict.problem
    told: dict[str, Plain] = {
        "sound": verdict.sound,
        "exact": verdict.exact,
        "steps": verdict.steps,
        "tasks": verdict.tasks,
        "keyframes": verdict.keyframes,
        "files": verdict.files,
        "changes": verdict.changes,
        "worlds": verdict.worlds,
        "late": list(verdict.late),
        "environment": list(verdict.environment),
        "largest": _deviation(verdict.largest),
        "seconds": seconds,
        "problem": None,
    }
    if problem is not None:
        told["problem"] = {
            "step": problem.step,
            "cause": problem.cause,
            "deviation": _deviation(problem.deviation),
            "task": list(problem.task),
        }
    return told


def _deviation(deviation: Deviation | None) -> Plain:
    if deviation is None:
        return None
    size = deviation.size if math.isfinite(deviation.size) else None
    recorded, found = (
        str(value) if isinstance(value, float) and not math.isfinite(value) else value  # which JSON doesn't have
        for value in (deviation.recorded, deviation.found)
    )
    return {"field": deviation.field, "recorded": recorded, "found": found, "size": size}
