"""``fork``: the plan runs again up to a step, and goes on from there, live, into a new recording."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from recorder.mcap_sink import free_path
from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE
from replay.cli.retrace import add_source_and_arguments, facts_of, lines_of
from replay.history.steps import HINT
from replay.report import phrases

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from replay.recording import Recording
    from replay.retrace.fork import Fork

AGAIN = "its effects outside of its worlds (files, network) happen again"


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step, what is to be changed, the control and the new recording."""
    parser.epilog = (
        "Exit code 0: the plan succeeded. 1: it failed. 2: it can't be run, or isn't the same up to the step. With "
        "--control, 0: the control came out as recorded. 1: it didn't."
    )
    parser.add_argument("--at", metavar="STEP", required=True, help=f"the last step that is the same: {HINT}")
    parser.add_argument("--plan", metavar="FILE", help="an edited plan, which does the same up to that step")
    parser.add_argument(
        "--set",
        metavar="WHAT=VALUE",
        action="append",
        default=[],
        help="set something after that step: milk.position=1,2,0.9 (also orientation, color), a joint as "
        "pr2.torso_lift_joint=0.2, a fluent as battery=20 (fluent:left.battery=20 if its name has a dot); repeatable",
    )
    parser.add_argument("--world", metavar="NAME", help="in this world (default: the one opened last)")
    parser.add_argument(
        "--answer",
        metavar="QUERY=ANSWER",
        action="append",
        default=[],
        help="the next such query gets that answer: 'reachable_object(milk, ...)=false', 'blocking(...)=[bowl]'; "
        "repeatable",
    )
    parser.add_argument("--seed", metavar="N", type=int, help="from there on, draw random numbers and order from this")
    parser.add_argument(
        "--control", action="store_true", help="also run the plan without the change, and compare it to its end"
    )
    parser.add_argument("-o", dest="target", metavar="FILE", help="the new recording (default: LOG.fork.mcap)")
    add_source_and_arguments(parser)


def run(log: Recording, options: argparse.Namespace) -> int:
    """Fork, and print where the new recording is."""
    from replay.retrace.fork import fork  # noqa: PLC0415  needs the executor

    step = log.step(options.at)
    target = new_file(log, options.target, "fork")
    forked = fork(
        log,
        step,
        target,
        plan=options.plan,
        arguments=options.arguments,
        settings=options.set,
        world=options.world,
        answers=options.answer,
        seed=options.seed,
        control=options.control,
        recorded_source=options.recorded_source,
        begun=lambda: print_message(f"the plan runs again up to step {step}; {AGAIN}"),
    )
    return tell(log, forked, as_json=options.json)


def new_file(log: Recording, given: str | None, kind: str) -> Path:
    """Return the path of a new recording, which is none that is there."""
    return free_path(Path(given) if given is not None else log.path.with_suffix(f".{kind}{log.path.suffix}"))


def tell(log: Recording, forked: Fork, *, as_json: bool) -> int:
    """Print what has become of the plan, and return the exit code."""
    control = forked.control
    facts = {
        **asdict(forked),
        "file": str(forked.file),
        "parent": str(log.path),
        "control": control and facts_of(control),
    }
    print_result(lambda: facts, _lines(log, forked), as_json=as_json)
    if control is not None:
        return FINE if control.identical else FAILED
    return FINE if forked.succeeded else FAILED


def _lines(log: Recording, forked: Fork) -> Iterator[str]:
    ended = "succeeded" if forked.succeeded else "failed"
    file = phrases.path(str(forked.file))
    yield f"{file}: {forked.records} records, the first {forked.step + 1} as in {log.path}; the plan {ended}"
    yield from (f"note  {note}" for note in forked.notes)
    if forked.control is not None:
        notes = tuple(note for note in forked.control.notes if note not in forked.notes)
        yield from lines_of(replace(forked.control, notes=notes), "without the change: ")
