"""``minimise``: write a smaller plan that fails like the recorded plan."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from replay.cli.console import print_message, print_result
from replay.cli.retrace import AGAIN
from replay.errors import ReplayError
from replay.recording import Recording
from replay.report.report import write


def add(parser: argparse.ArgumentParser) -> None:
    add_output(parser, "file of the smaller plan (default: PLAN_small.py)")
    add_trials(parser, budget=200)


def add_output(parser: argparse.ArgumentParser, words: str) -> None:
    """Add the path of a written plan or test."""
    parser.add_argument("-o", dest="file", metavar="FILE", help=words)
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")


def output(options: argparse.Namespace, default: str) -> Path:
    """Return the path of a file that will be written; raise ReplayError if the file exists, and may not be replaced."""
    file = Path(options.file or default)
    if file.exists() and not options.overwrite:
        raise ReplayError(f"{file} exists; name another file with -o, or add --overwrite")
    return file


def add_trials(parser: argparse.ArgumentParser, budget: int) -> None:
    """Add the options that ``minimise`` and ``fix`` share."""
    parser.add_argument(
        "--budget", metavar="RUNS", type=int, default=budget, help=f"largest number of whole runs (default: {budget})"
    )
    parser.add_argument(
        "--allow-effects",
        action="store_true",
        help="also try a plan that writes files outside of its folder, starts processes or opens sockets",
    )


def run(log: Recording, options: argparse.Namespace) -> None:
    from replay.fix.minimise import minimise  # noqa: PLC0415  needs the executor
    from replay.fix.trials import Trials  # noqa: PLC0415  as above

    with Trials(log, allow_effects=options.allow_effects) as trials:
        file = output(options, f"{trials.program.stem}_small.py")
        print_message(f"{trials.program.name} runs again, up to {options.budget} times; {AGAIN}")
        found = minimise(trials, options.budget)
    write(str(file), found.text.encode())
    left = f"{found.lines[1]} of {found.lines[0]} lines, {found.objects[1]} of {found.objects[0]} objects"
    lines = [f"{file}: {left}, after {found.runs} runs", f"  the smaller plan fails in the same way: {found.failure}"]
    if found.exhausted:
        lines.append("  the search ended at --budget; with more runs, the plan may become smaller")
    print_result(lambda: asdict(found) | {"file": str(file)}, lines, as_json=options.json)
