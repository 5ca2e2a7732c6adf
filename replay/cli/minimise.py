"""``minimise`` writes a smaller plan with the recorded failure; ``test`` writes a pytest with the recorded failure."""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from recorder.packages import require
from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE
from replay.cli.retrace import AGAIN
from replay.errors import ReplayError
from replay.history.steps import HINT
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


def add_test(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 0: the test fails now, as it should. 1: the test doesn't fail, so it is useless."
    parser.add_argument(
        "step",
        metavar="STEP",
        nargs="?",
        help="write a test that rebuilds the scene before the failed motion of this step, and performs the motion "
        f"(default: a test that runs the plan): {HINT}",
    )
    add_output(parser, "file of the test (default: test_PLAN.py)")
    parser.add_argument("--holds", metavar="PROPERTY", action="append", default=[], help="also assert this property")


def run_test(log: Recording, options: argparse.Namespace) -> int:
    require("pytest")
    from replay.fix import written_test  # noqa: PLC0415  needs the executor
    from replay.retrace.guided_run import spec_of  # noqa: PLC0415  as above
    from replay.retrace.plan_process import PlanProcess  # noqa: PLC0415  as above

    process = PlanProcess(log)
    file = output(options, f"test_{process.program.stem}.py")
    if options.step is None:
        spec = spec_of(log, process.began, process.program, process.arguments)
        text = written_test.of_plan(log, spec, file, options.holds)
    else:
        task = log.why(options.step).task
        if task is None:
            raise ReplayError(f"no task failed at step {options.step}")
        text = written_test.of_moment(log, task.motion, options.holds)
    write(str(file), text.encode())
    print_message(f"{file} runs once")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(file)]
    red = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode == 1  # noqa: S603
    how = "fails now, as the run did" if red else "doesn't fail now, so the test is useless"
    print_result(lambda: {"file": str(file), "fails": red}, [f"{file}: {how}"], as_json=options.json)
    return FINE if red else FAILED
