"""The command ``pycram run --explore N PLAN``, which prints the results of an exploration as text or JSON."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

from pycram import exploration, running
from pycram.running import RunSpec
from pycram.scheduling.order import BranchLine
from recorder.errors import RecordingError
from recorder.terminal import ProgressLines

_MAX_PRINTED: Final = 6  # maximum number of printed differences between states, and of printed precedences
_WIDTH: Final = 200  # maximum number of characters of a printed failure


def run(spec: RunSpec, options: argparse.Namespace, log: Path) -> int:
    """Explore a plan, print the results, and return the exit code; recordings are named like ``log``."""
    # import the modules that plans need before all runs
    from pycram import event, fluent, language, process_module  # noqa: F401, PLC0415
    from pycram.bullet_world_reasoning import blocking, contact, stable, visible  # noqa: F401, PLC0415

    def run_once(order: str, file: Path) -> None:
        running.run(replace(spec, order=order), file, overwrite=True)

    lines = ProgressLines()

    def show(done: int) -> None:
        if not sys.stderr.isatty():
            if lines.due():
                running.tell(f"pycram: {done} of {options.explore} orders")
        else:
            sys.stderr.write(f"\r{done} of {options.explore} orders " if done < options.explore else "\r\033[K")
            sys.stderr.flush()

    depth = options.depth or exploration.DEPTH
    try:
        result = exploration.explore_runs(
            run_once,
            options.explore,
            depth=depth,
            limit=options.limit or exploration.LIMIT,
            plan=spec.plan,
            file=log,
            overwrite=options.overwrite,
            progress=show,
        )
    except (exploration.NotExplorable, RecordingError) as error:
        running.tell(f"pycram: {error}")
        return running.WRONG_USAGE
    motion = ["--motion", spec.motion] if spec.motion else []
    given = [word for value in options.set for word in ("--set", value)]
    given += [word for file in options.check for word in ("--check", file)]
    given += ["--check-only-record"] * options.check_only_record
    command = ["pycram", "run", *motion, *given, "--seed", str(spec.seed)]
    rest = [str(spec.plan), *(["--", *spec.arguments] if spec.arguments else [])]
    if options.json:
        print(json.dumps(_data(result, command, rest), indent=2))
    else:
        print(*_lines(result, command, rest, depth), sep="\n")
    if result.interrupted:
        return running.INTERRUPTED
    succeeded = all(found.ending.kind == exploration.SUCCEEDED for found in result.found)
    return running.SUCCEEDED if succeeded and result.alike else running.FAILED


def _data(result: exploration.Exploration, command: list[str], rest: list[str]) -> dict[str, object]:
    return {
        "runs": result.runs,
        "orders": result.orders,
        "alike": result.alike,
        "deterministic": result.deterministic,
        "interrupted": result.interrupted,
        "endings": [
            {
                "runs": found.count,
                **asdict(found.ending),
                "differences": list(found.ending.differences(result.reference or result.found[0].ending)),
                "order": found.order,
                "decides": [{"branch": each.first._asdict(), "before": each.second._asdict()} for each in found.made],
                "command": shlex.join([*command, "--order", found.order, *rest]),
                "recording": None if found.recording is None else str(found.recording),
            }
            for found in result.found
        ],
    }


def _lines(result: exploration.Exploration, command: list[str], rest: list[str], depth: int) -> Iterator[str]:
    if result.interrupted:
        yield f"interrupted after {result.runs} runs; so far:"
    if not result.runs:
        return
    different = f"{result.orders} different order{'s' if result.orders != 1 else ''}"
    yield f"{rest[0]}: {result.runs} runs with seed {command[-1]} in {different}, for races of depth {depth}"
    if result.alike:
        never = " The plan has only one order: two branches were never ready at the same time."
        yield f"all end alike: {_words(result.found[0].ending)}.{never if result.orders == 1 else ''}"
        yield from _recording(result.found[0])
        return
    yield ""
    yield "  #  runs  ends"
    for number, found in enumerate(result.found, 1):
        yield f"{number:3}  {found.count:4}  {_words(found.ending, result.reference)}"
    if not result.deterministic:
        yield ""
        yield "The plan isn't deterministic: runs in the same order end differently. The plan may read the clock or the"
        yield "network, or have its own random generators. pycram-replay retrace FILE names the first differing record."
    for number, found in enumerate(result.found, 1):
        yield ""
        if number > 1 and found.made:
            yield f"{number}: the plan ends this way, and not as in 1, if"
            for place, each in enumerate(found.made[:_MAX_PRINTED]):
                yield f"  {'and ' if place else ''}{_standing(each.first)} runs before {_standing(each.second)}"
            if found.made[_MAX_PRINTED:]:
                yield f"  and {len(found.made) - _MAX_PRINTED} more"
        else:
            yield f"{number}: {'in the order in which branches were added' if number == 1 else 'for example'}"
        yield "  " + shlex.join([*command, "--order", found.order, *rest])
        yield from _recording(found)


def _recording(found: exploration.EndingGroup) -> Iterator[str]:
    if found.recording is not None:
        name = shlex.quote(_shown(found.recording))
        yield f"  pycram-replay {'info' if found.ending.kind == exploration.SUCCEEDED else 'why'} {name}"


def _words(ending: exploration.Ending, first: exploration.Ending | None = None) -> str:
    """Return an ending in words; for a successful ending, with its differences from the first successful ending."""
    words = ending.kind
    if ending.kind == exploration.DEADLOCK:
        return f"{words}: {ending.failure.partition('wake them: ')[2]}"
    if ending.failure:
        failure = " ".join(ending.failure.split())
        words += f": {failure if len(failure) <= _WIDTH else failure[: _WIDTH - 3] + '...'}"
    if ending.plan_line:
        words += f" at {_shown_line(ending.plan_line)}"
    if ending.line != ending.plan_line:
        words += f", in {_shown_line(ending.line)}"
    if first is None or first is ending or ending.kind != exploration.SUCCEEDED:
        return words
    otherwise = list(ending.differences(first))
    more = [f"{len(otherwise) - _MAX_PRINTED} more"] if len(otherwise) > _MAX_PRINTED else []
    return f"{words}, but {', '.join([*otherwise[:_MAX_PRINTED], *more])}"


def _standing(branch: BranchLine) -> str:
    return f"{branch.label or branch.branch} at {_shown_line(f'{branch.file}:{branch.line}')}"


def _shown_line(line: str) -> str:
    file, _, number = line.rpartition(":")
    return f"{_shown(Path(file))}:{number}"


def _shown(file: Path) -> str:
    """Return a path as text, relative if it is below the working directory."""
    here = os.path.relpath(file)
    return str(file) if here.startswith("..") else here
