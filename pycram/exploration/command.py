"""``pycram run --explore N PLAN``: the results of an exploration, as text and as JSON."""

from __future__ import annotations

import json
import os
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.exploration import NotExplorable, explore_runs
from pycram.exploration.runs import SUCCEEDED
from recorder.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pycram.exploration import EndingGroup, Exploration
    from pycram.exploration.runs import Ending, Runner
    from pycram.scheduling.order import Standing

_SUCCEEDED, _FAILED, _WRONG_USAGE, _INTERRUPTED = 0, 1, 2, 130  # exit codes
_MAX_TOLD: Final = 6  # differences of states, and precedences
_WIDTH: Final = 200  # characters of a failure


def run(
    runner: Runner,
    plan: str,
    arguments: Sequence[str],
    count: int,
    *,
    seed: int,
    motion: str = "",
    values: Sequence[str] = (),
    depth: int,
    limit: float,
    file: Path,
    overwrite: bool,
    as_json: bool,
) -> int:
    """Explore a plan, print what was found, and return the exit code.

    Args:
        runner: Runs the plan once.
        plan: Its file, as the user gave it.
        arguments: Of the plan.
        count: Number of orders.
        seed: Of the runs.
        motion: Execution environment; "" for the plan's.
        values: Of the plan's parameters, as NAME=VALUE.
        depth: Of the races.
        limit: Seconds of wall-clock time for each run.
        file: Recordings are named after it.
        overwrite: Whether existing recordings are replaced.
        as_json: Whether to print JSON.
    """
    # what plans import, once for all runs
    from pycram import bullet_world_reasoning, event, fluent, language, process_module  # noqa: F401, PLC0415

    def show(done: int) -> None:
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{done} of {count} orders " if done < count else "\r\033[K")
            sys.stderr.flush()

    try:
        result = explore_runs(
            runner,
            count,
            depth=depth,
            limit=limit,
            plan=Path(plan),
            file=file,
            overwrite=overwrite,
            progress=show,
        )
    except (NotExplorable, RecordingError) as error:
        print(f"pycram: {error}", file=sys.stderr)
        return _WRONG_USAGE
    given = [word for value in values for word in ("--set", value)]
    command = ["pycram", "run", *(["--motion", motion] if motion else []), *given, "--seed", str(seed)]
    rest = [plan, *(["--", *arguments] if arguments else [])]
    if as_json:
        print(json.dumps(_data(result, command, rest), indent=2))
    else:
        print(*_lines(result, plan, command, rest, depth), sep="\n")
    if result.interrupted:
        return _INTERRUPTED
    succeeded = all(found.ending.kind == SUCCEEDED for found in result.found)
    return _SUCCEEDED if succeeded and result.alike else _FAILED


def _data(result: Exploration, command: list[str], rest: list[str]) -> dict[str, object]:
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
                "differences": list(found.ending.differences(result.found[0].ending)),
                "order": found.order,
                "decides": [{"branch": each.first._asdict(), "before": each.second._asdict()} for each in found.made],
                "command": shlex.join([*command, "--order", found.order, *rest]),
                "recording": None if found.recording is None else str(found.recording),
            }
            for found in result.found
        ],
    }


def _lines(result: Exploration, plan: str, command: list[str], rest: list[str], depth: int) -> Iterator[str]:
    if result.interrupted:
        yield f"interrupted after {result.runs} runs; so far:"
    if not result.runs:
        return
    different = f"{result.orders} different order{'s' if result.orders != 1 else ''}"
    yield f"{plan}: {result.runs} runs with seed {command[-1]} in {different}, for races of depth {depth}"
    if result.alike:
        never = " There is no other order: two branches were never ready at once." if result.orders == 1 else ""
        yield f"all end alike: {_words(result.found[0].ending)}.{never}"
        return
    yield ""
    yield "  #  runs  ends"
    for number, found in enumerate(result.found, 1):
        yield f"{number:3}  {found.count:4}  {_words(found.ending, result.found[0].ending)}"
    if not result.deterministic:
        yield ""
        yield "The plan is not deterministic: in the same order it ends differently. Does it read the clock, or the"
        yield "network, or draw its own random numbers? pycram-replay retrace FILE names the first record that differs."
    for number, found in enumerate(result.found, 1):
        yield ""
        if number > 1 and found.made:
            yield f"{number}: it ends so instead of as 1 when"
            yield from _decisive(found)
        else:
            yield f"{number}: {'in the order in which branches were added' if number == 1 else 'for example'}"
        yield "  " + shlex.join([*command, "--order", found.order, *rest])
        if found.recording is not None:
            name = shlex.quote(_shown(found.recording))
            yield f"  pycram-replay {'info' if found.ending.kind == SUCCEEDED else 'why'} {name}"


def _words(ending: Ending, first: Ending | None = None) -> str:
    """Return an ending in words; if it and the first succeeded, with their differences."""
    words = ending.kind
    if ending.failure:
        failure = " ".join(ending.failure.split())
        words += f": {failure if len(failure) <= _WIDTH else failure[: _WIDTH - 3] + '...'}"
    if ending.line:
        words += f" at {_shown_line(ending.line)}"
    if first is None or first is ending or ending.kind != SUCCEEDED or first.kind != SUCCEEDED:
        return words
    otherwise = list(ending.differences(first))
    more = [f"{len(otherwise) - _MAX_TOLD} more"] if len(otherwise) > _MAX_TOLD else []
    return f"{words}, but {', '.join([*otherwise[:_MAX_TOLD], *more])}"


def _decisive(found: EndingGroup) -> Iterator[str]:
    for number, each in enumerate(found.made[:_MAX_TOLD]):
        yield f"  {'and ' if number else ''}{_standing(each.first)} runs before {_standing(each.second)}"
    if found.made[_MAX_TOLD:]:
        yield f"  and {len(found.made) - _MAX_TOLD} more such"


def _standing(branch: Standing) -> str:
    return f"{branch.branch} at {_shown_line(f'{branch.file}:{branch.line}')}"


def _shown_line(line: str) -> str:
    file, _, number = line.rpartition(":")
    return f"{_shown(Path(file))}:{number}"


def _shown(file: Path) -> str:
    """Return a path relative to the working directory, if it is below that."""
    here = os.path.relpath(file)
    return str(file) if here.startswith("..") else here
