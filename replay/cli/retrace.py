"""Verbs that run a plan again: ``retrace`` compares the records, ``fork`` and ``resume`` write a new recording."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from recorder.mcap_sink import free_path
from replay.cli.console import print_message, print_result
from replay.cli.main import FAILED, FINE, INCOMPLETE, USAGE
from replay.errors import ReplayError, Unreadable
from replay.history.steps import HINT
from replay.recording import Recording
from replay.report import phrases

if TYPE_CHECKING:
    from replay.retrace.fork import Fork
    from replay.retrace.retrace import Retracing

AGAIN: Final = "effects outside of the plan's worlds (files, network) happen again"
_MAX_FIELDS: Final = 4  # maximum number of fields that are listed
_MAX_CALLERS: Final = 4


def add_source_and_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the choice of the source, and the plan's arguments."""
    parser.add_argument("--recorded-source", action="store_true", help="run the recorded source, not the files on disk")
    parser.add_argument(
        "--arguments",
        nargs=argparse.REMAINDER,
        help="the plan's arguments (default: the recorded arguments); must be the last option",
    )


def _chosen(options: argparse.Namespace) -> dict[str, Any]:
    return {name: getattr(options, name) for name in ("plan", "arguments", "recorded_source")}


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "Exit code 0: all plans match their recordings. 1: a plan differs. 2: a plan can't be run. "
        "3: a recording is damaged."
    )
    parser.add_argument("more", metavar="LOG", nargs="*", help="further recordings to retrace")
    parser.add_argument("--plan", metavar="FILE", help="run this file (default: the recorded plan)")
    parser.add_argument(
        "--answers",
        choices=("asked", "recorded"),
        default="asked",
        help="'asked' (default) repeats each query and compares the answers; 'recorded' (faster) uses recorded answers",
    )
    add_source_and_arguments(parser)


def run(log: Recording, options: argparse.Namespace) -> int:
    """Retrace the recordings one after the other; return the highest exit code."""
    results: list[dict[str, object]] = []
    code = _retrace(log, options, results)
    for name in options.more:
        try:
            with Recording(name) as other:
                code = max(code, _retrace(other, options, results))
                if other.problems:
                    print_message(f"{name} is incomplete: {other.problems}")
                    code = max(code, INCOMPLETE)
        except ReplayError as error:
            code = max(code, _report_not_run(name, error, results))
    if options.json:
        print_result(lambda: results, (), as_json=True)
    return code


def _retrace(log: Recording, options: argparse.Namespace, results: list[dict[str, object]]) -> int:
    from replay.retrace.plan_process import CantRetrace  # noqa: PLC0415  as below
    from replay.retrace.retrace import retrace  # noqa: PLC0415  needs the executor

    try:
        result = retrace(log, answers=options.answers, **_chosen(options))
    except CantRetrace as error:
        return _report_not_run(str(log.path), error, results)
    results.append({"file": str(log.path), **_facts(result)})
    if not options.json:
        print_result(dict, _lines(result, f"{log.path}: "), as_json=False)
    return FINE if result.identical else FAILED


def _report_not_run(name: str, error: ReplayError, results: list[dict[str, object]]) -> int:
    print_message(str(error))
    results.append({"file": name, "error": str(error)})
    return INCOMPLETE if isinstance(error, Unreadable) else USAGE


def _facts(result: Retracing) -> dict[str, object]:
    return {**asdict(result), "plan": str(result.plan), "identical": result.identical}


def _lines(result: Retracing, of: str) -> Iterator[str]:
    """Yield the result as text. The text ``of`` comes before the name of the plan."""
    difference = result.difference
    of += phrases.path(str(result.plan))
    if difference is None:
        taken = f", with {result.taken} recorded answers" if result.taken else ""
        where = f"{result.equal} records" if result.equal == result.steps else f"first {result.equal} records"
        yield f"identical  {of} made the same {where} again in {result.seconds:.1f} s{taken}"
    else:
        yield f"different  {of} from step {difference.step} on: {difference.text.replace(*_short(difference.line))}"
        yield from (f"           called from {_short(caller)[1]}" for caller in difference.callers[:_MAX_CALLERS])
        for name, (before, now) in list(difference.fields.items())[:_MAX_FIELDS]:
            yield f"           {name}: recorded {phrases.short(str(before))}, now {phrases.short(str(now))}"
        left = len(difference.fields) - _MAX_FIELDS
        if left > 0:
            yield f"           and {left} more fields"
    yield from (f"note       {note}" for note in result.notes)


def _short(line: str) -> tuple[str, str]:
    """Return a line of the plan; its path is relative if possible."""
    file, _, number = line.rpartition(":")
    return (line, f"{phrases.path(file)}:{number}") if file else ("\0", "")


def add_fork(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "Exit code 0: the plan succeeded. 1: the plan failed. 2: the plan can't be run, or differs before the step; "
        "or a decision of --answer wasn't made. "
        "With --control, the exit code is 0 if the control run matches the recording, and 1 if it differs."
    )
    parser.add_argument(
        "--at", metavar="STEP", help=f"the last unchanged step (default: the last step before --plan differs): {HINT}"
    )
    parser.add_argument("--plan", metavar="FILE", help="an edited plan, which must act as recorded up to the step")
    parser.add_argument(
        "--set",
        metavar="WHAT=VALUE",
        action="append",
        default=[],
        help="set a value after the step; repeatable. Objects: milk.position=1,2,0.9, also orientation and color. "
        "Joints: pr2.torso_lift_joint=0.2. Hands: milk.hand=left, or none. Gravity: gravity=0,0,-9.8. Fluents: "
        "battery=20; if the name has a dot, fluent:left.battery=20",
    )
    parser.add_argument("--world", metavar="NAME", help="world of the values (default: the last opened world)")
    parser.add_argument(
        "--answer",
        metavar="DECISION=VALUE",
        action="append",
        default=[],
        help="force the next matching decision: the answer of a query, 'reachable_object(milk, ...)=false'; a recorded "
        "candidate by name or number, 'grasp(milk)=top', 'best_seen(...)=#2'; a slot or a solution, "
        "'pick-up.arm(milk)=left', 'transporting(milk)=#2'; the order of branches, 'order(...)=[cook, serve]'; a "
        "limit, 'timeout(...)=30'; a call that isn't made, 'remove(milk)=skip'; repeatable",
    )
    parser.add_argument("--seed", metavar="N", type=int, help="seed of random numbers and branch orders after the step")
    parser.add_argument("--control", action="store_true", help="also retrace the plan without the changes")
    parser.add_argument("-o", dest="target", metavar="FILE", help="the new recording (default: LOG.fork.mcap)")
    add_source_and_arguments(parser)


def run_fork(log: Recording, options: argparse.Namespace) -> int:
    from replay.retrace.fork import fork  # noqa: PLC0415  needs the executor

    step = log.step(options.at) if options.at is not None else _last_equal(log, options)
    forked = fork(
        log,
        step,
        _free_file(log, options.target, "fork"),
        settings=options.set,
        world=options.world,
        answers=options.answer,
        seed=options.seed,
        control=options.control,
        begun=lambda: print_message(f"the plan runs again up to step {step}; {AGAIN}"),
        **_chosen(options),
    )
    return _print_fork(log, forked, as_json=options.json)


def _last_equal(log: Recording, options: argparse.Namespace) -> int:
    """Run an edited plan up to its first difference, and return the step before the difference."""
    from replay.retrace.retrace import retrace  # noqa: PLC0415  needs the executor

    if options.plan is None:
        raise ReplayError("give the last unchanged step with --at STEP (optional with --plan FILE)")
    found = retrace(log, plan=options.plan, arguments=options.arguments, answers="recorded")
    if not found.difference or not found.difference.step:
        what = "differs from the start" if found.difference else "makes the same records"
        raise ReplayError(f"{options.plan} {what}")
    return found.difference.step - 1


def _free_file(log: Recording, given: str | None, kind: str) -> Path:
    return free_path(Path(given) if given is not None else log.path.with_suffix(f".{kind}{log.path.suffix}"))


def _print_fork(log: Recording, forked: Fork, *, as_json: bool) -> int:
    control = forked.control
    facts = {
        **asdict(forked),
        "file": str(forked.file),
        "parent": str(log.path),
        "control": control and _facts(control),
    }
    print_result(lambda: facts, _fork_lines(log, forked), as_json=as_json)
    if forked.unused:
        return USAGE
    if control is not None:
        return FINE if control.identical else FAILED
    return FINE if forked.succeeded else FAILED


def _fork_lines(log: Recording, forked: Fork) -> Iterator[str]:
    ended = "succeeded" if forked.succeeded else "failed"
    file = phrases.path(str(forked.file))
    yield f"{file}: {forked.records} records, the first {forked.step + 1} equal to {log.path}; the plan {ended}"
    yield from (f"note  {note}" for note in forked.notes)
    if forked.control is not None:
        notes = tuple(note for note in forked.control.notes if note not in forked.notes)
        yield from _lines(replace(forked.control, notes=notes), "without the change: ")


def add_resume(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "Exit code 1: the plan failed. 2: the plan can't run, or differs from its recording."
    parser.add_argument("--plan", metavar="FILE", help="the plan's file, if it was moved after the recording")
    parser.add_argument("-o", dest="target", metavar="FILE", help="the new recording (default: LOG.resumed.mcap)")
    add_source_and_arguments(parser)


def run_resume(log: Recording, options: argparse.Namespace) -> int:
    from replay.retrace.fork import resume  # noqa: PLC0415  needs the executor

    target = _free_file(log, options.target, "resumed")
    again = f"the plan runs again up to step {len(log) - 1}, the last recorded step; {AGAIN}"
    resumed = resume(log, target, begun=lambda: print_message(again), **_chosen(options))
    return _print_fork(log, resumed, as_json=options.json)
