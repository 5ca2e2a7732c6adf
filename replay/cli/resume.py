"""``resume``: a plan whose process was killed goes on where it was, into a new recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli.console import print_message
from replay.cli.fork import AGAIN, new_file, tell
from replay.cli.retrace import add_source_and_arguments

if TYPE_CHECKING:
    import argparse

    from replay.recording import Recording

EXPECTS_INCOMPLETE = True  # it makes the recording whole


def add(parser: argparse.ArgumentParser) -> None:
    """Add the new recording."""
    parser.epilog = "Exit code 0: the plan succeeded. 1: it failed. 2: it can't be run, or isn't the same up to there."
    parser.add_argument("--plan", metavar="FILE", help="the plan's file, where it is another one than was recorded")
    parser.add_argument("-o", dest="target", metavar="FILE", help="the new recording (default: LOG.resumed.mcap)")
    add_source_and_arguments(parser)


def run(log: Recording, options: argparse.Namespace) -> int:
    """Resume, and print where the new recording is."""
    from replay.retrace.fork import resume  # noqa: PLC0415  needs the executor

    target = new_file(log, options.target, "resumed")
    resumed = resume(
        log,
        target,
        plan=options.plan,
        arguments=options.arguments,
        recorded_source=options.recorded_source,
        begun=lambda: print_message(f"the plan runs again up to step {len(log) - 1}, where it was killed; {AGAIN}"),
    )
    return tell(log, resumed, as_json=options.json)
