"""``fork``: the plan runs again up to a step, and goes on from there, live, into a new recording."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from recorder.mcap.output_file import free_path
from replay.cli import formatting
from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE
from replay.explain.step_names import HINT

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.recording import Recording
    from replay.retrace.fork import Fork

AGAIN = "what it does outside of its worlds (files, network) happens again"


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step, the edited plan and the new recording."""
    parser.epilog = (
        "Exit code 0: the plan succeeded. 1: it failed. 2: it can't be run, or isn't the same up to the step."
    )
    parser.add_argument("--at", metavar="STEP", required=True, help=f"the last step that is the same: {HINT}")
    parser.add_argument("--plan", metavar="FILE", help="an edited plan, which does the same up to that step")
    parser.add_argument("-o", dest="target", metavar="FILE", help="the new recording (default: LOG.fork.mcap)")
    add_arguments(parser)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the plan's arguments."""
    parser.add_argument(
        "--arguments", nargs=argparse.REMAINDER, help="all that follow are the plan's (default: the recorded ones)"
    )


def run(log: Recording, options: argparse.Namespace) -> int:
    """Fork, and print where the new recording is."""
    from replay.retrace.fork import fork  # noqa: PLC0415  needs the executor

    step = log.step(options.at)
    target = new_file(log, options.target, "fork")
    print_message(f"the plan runs again up to step {step}; {AGAIN}")
    return tell(log, fork(log, step, target, plan=options.plan, arguments=options.arguments), as_json=options.json)


def new_file(log: Recording, given: str | None, kind: str) -> Path:
    """Return the path of a new recording, which is none that is there."""
    return free_path(Path(given) if given is not None else log.path.with_suffix(f".{kind}{log.path.suffix}"))


def tell(log: Recording, forked: Fork, *, as_json: bool) -> int:
    """Print what has become of the plan, and return the exit code."""
    facts = {**asdict(forked), "file": str(forked.file), "parent": str(log.path)}
    print_result(lambda: facts, _lines(log, forked), as_json=as_json)
    return FINE if forked.succeeded else FAILED


def _lines(log: Recording, forked: Fork) -> Iterator[str]:
    ended = "succeeded" if forked.succeeded else "failed"
    file = formatting.path(str(forked.file))
    yield f"{file}: {forked.records} records, the first {forked.step + 1} as in {log.path}; the plan {ended}"
    yield from (f"note  {note}" for note in forked.notes)
