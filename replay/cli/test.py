"""``test``: write a test for pytest that fails like the recorded run, and passes when the plan is repaired."""

from __future__ import annotations

import argparse
import subprocess
import sys

from recorder.packages import require
from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE
from replay.cli.minimise import add_output, output
from replay.errors import ReplayError
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report.report import write


def add(parser: argparse.ArgumentParser) -> None:
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


def run(log: Recording, options: argparse.Namespace) -> int:
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
