"""``debug``: a prompt at a step of a recording, in the plan's own frame; forwards, and back."""

from __future__ import annotations

import linecache
from typing import TYPE_CHECKING

from replay.cli.console import print_message
from replay.cli.fork import AGAIN
from replay.cli.main import FINE
from replay.cli.retrace import add_source_and_arguments
from replay.errors import ReplayError
from replay.history.failures import uncaught_failure
from replay.history.steps import HINT

if TYPE_CHECKING:
    import argparse

    from replay.recording import Recording

EXPECTS_INCOMPLETE = True  # it guides the plan as far as it goes


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step, the plan, and whether copies wait."""
    parser.epilog = "Commands are pdb's; help lists them. Lines of a script on stdin are commands, too."
    parser.add_argument(
        "step", metavar="STEP", nargs="?", help=f"where to begin (default: the failure, else the start): {HINT}"
    )
    parser.add_argument("--plan", metavar="FILE", help="the plan's file, where it is another one than was recorded")
    parser.add_argument(
        "--no-checkpoints", action="store_true", help="keep no copies of the plan: going back runs it again"
    )
    add_source_and_arguments(parser)


def run(log: Recording, options: argparse.Namespace) -> int:
    """Run the plan to the step, and take commands until the end of the input."""
    from replay.cli.debug_prompt import Prompt  # noqa: PLC0415  needs the executor
    from replay.debug.guided_plan import GuidedPlan  # noqa: PLC0415
    from replay.debug.session import Session  # noqa: PLC0415
    from replay.retrace.plan_process import last_own_step  # noqa: PLC0415

    if options.json:
        raise ReplayError("debug is a prompt, whose answers are text; the other verbs have --json")
    failed = uncaught_failure(log) is not None
    step = log.step(options.step if options.step is not None else "failure" if failed else 0)
    if options.step is None:
        step = min(step, last_own_step(log))
    with GuidedPlan(
        log,
        options.plan,
        options.arguments,
        checkpoints=not options.no_checkpoints,
        recorded_source=options.recorded_source,
    ) as plan:
        for file, source in plan.recorded_files.items():  # the prompt lists it, whatever there is on the disk
            lines = source.decode("utf-8", "replace").splitlines(keepends=True)
            linecache.cache[str(file)] = len(source), None, lines, str(file)
        session = Session(log, plan)
        print_message(f"the plan runs again up to step {min(step, plan.last)}; {AGAIN}")
        for note in plan.notes:
            print_message(f"note: {note}")
        if step > plan.last:
            print_message(f"the plan reaches only step {plan.last}: {plan.parted}")
        prompt = Prompt(session)
        prompt.begin(min(step, plan.last))
        prompt.run()
    return FINE
