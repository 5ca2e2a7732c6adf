"""The command ``pycram sweep``, which prints progress to stderr and a summary at the end."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import UsageError
from pycram.plan_parameters import listed, sampled
from pycram.running import FAILED, INTERRUPTED, SUCCEEDED, WRONG_USAGE, tell
from pycram.sweeping import RunOutcome, Sweep, sweep
from recorder.terminal import ProgressLines

if TYPE_CHECKING:
    from rich.progress import Progress

_SHOWN: Final = 5  # maximum number of printed failures
_WIDTH: Final = 160  # maximum number of characters of a printed failure
_NUMBER: Final = re.compile(r"\d+(\.\d+)?")  # failures that differ only in numbers are counted as one


def run(options: argparse.Namespace, arguments: Sequence[str], checks: Sequence[str] = ()) -> int:
    """Sweep with the given options. Return the exit code: 0 if all runs succeeded, 1 if some failed."""
    shown = _Shown(options.runs)
    try:
        with shown.bar or nullcontext():
            result = sweep(
                options.plan,
                options.runs,
                options.output,
                seed=options.seed,
                set=dict(map(listed, options.set)),
                sample=dict(map(sampled, options.sample)),
                cores=options.jobs,
                limit=options.limit,
                memory=options.memory * 10**6,
                arguments=arguments,
                motion=options.motion,
                locals=not options.no_locals,
                check=checks,
                ray=options.ray,
                progress=shown.update,
            )
    except UsageError as error:
        tell(f"pycram: {error}")
        return WRONG_USAGE
    print(*_lines(result, options.output, shown.seconds), sep="\n")
    if result.stopped:
        tell(f"pycram: stopped: {result.stopped}")
        return WRONG_USAGE
    if result.interrupted:
        return INTERRUPTED
    return FAILED if result.failed else SUCCEEDED


class _Shown:
    def __init__(self, runs: int) -> None:
        self.bar: Progress | None = _bar() if sys.stderr.isatty() else None
        self._lines = ProgressLines()
        self._runs = runs
        self._began = time.monotonic()
        self.seconds = 0.0

    def update(self, result: Sweep, outcome: RunOutcome | None) -> None:
        """Update the progress bar; if stderr isn't a terminal, print a line every 10 s."""
        now = time.monotonic()
        self._began = now if outcome is None else self._began
        self.seconds = now - self._began
        done = result.before + result.done
        if self.bar is None:
            if self._lines.due():
                tell(f"pycram: {done} of {self._runs} runs, {result.failed} failed")
            return
        if not self.bar.task_ids:
            self.bar.add_task("", total=self._runs, failed=0, rate="", completed=result.before)
        rate = f"{result.done / self.seconds:.1f} runs/s" if self.seconds else ""
        self.bar.update(self.bar.task_ids[0], completed=done, failed=result.failed, rate=rate)
        self.bar.refresh()


def _bar() -> Progress:
    from rich.console import Console  # noqa: PLC0415  only for terminals
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    return Progress(
        MofNCompleteColumn(),
        BarColumn(),
        TextColumn("{task.fields[rate]}, {task.fields[failed]} failed"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        auto_refresh=False,  # refreshing the bar needs a thread, which forks lack
    )


def _lines(result: Sweep, folder: str, seconds: float) -> Iterator[str]:
    there = f", {result.before} existed before" if result.before else ""
    rate = f" in {seconds:.0f} s, {result.done / seconds:.1f} a second" if result.done and seconds else ""
    yield f"{folder}: {result.done} runs{rate}{there}; {result.failed} failed"
    left = result.runs - result.before - result.done
    if left and not result.stopped:
        yield f"{left} runs are missing; the same command makes them"
    failures = sorted(result.failures, key=lambda each: each.number)  # in the order in which runs ended
    causes: dict[str, list[RunOutcome]] = {}
    for each in failures:
        causes.setdefault(_NUMBER.sub("#", each.failure), []).append(each)
    for alike in sorted(causes.values(), key=len, reverse=True)[:_SHOWN]:
        why = f"pycram-replay why {shlex.quote(f'{folder}/{alike[0].name}')}"
        line = " ".join("".join(each if each.isprintable() else " " for each in alike[0].failure).split())
        yield f"  {len(alike):4}  {line if len(line) <= _WIDTH else f'{line[: _WIDTH - 3]}...'}  {why}"
    if len(causes) > _SHOWN:
        yield f"        and {len(causes) - _SHOWN} more"
    for remark in result.remarks[:_SHOWN]:
        yield f"note: {remark}"
