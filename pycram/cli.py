"""The command line: ``pycram demo`` and ``pycram run`` record any plan, ``pycram describe`` describes robots.

The command starts itself again (:mod:`pycram.seeding`), so whatever takes long to load is imported where it is used.
"""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pycram.options import WITH_ROBOTS, demos, options_parser
from pycram.running import INTERRUPTED, SUCCEEDED, WRONG_USAGE, RunSpec, run, tell
from pycram.seeding import chosen_seed, restart
from recorder.closed_output import discard, until_closed
from recorder.packages import NotInstalled, needed, versions

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command, by default with the process' arguments, and return its exit code.

    Returns:
        0 if the plan succeeded, 1 if it failed, 2 for wrong usage, 130 if Ctrl-C interrupted it, 143 if SIGTERM did,
        129 if SIGHUP did; else the plan's own.
    """
    if argv is not None:
        return _run_command(argv)
    code = SUCCEEDED
    try:
        with until_closed():
            code = _run_command(argv)
        if code == INTERRUPTED:  # another one ends the process at once, and leaves no traceback of tidying up
            signal.signal(signal.SIGINT, signal.SIG_DFL)
    except OSError as error:
        discard(sys.stdout)
        tell(f"pycram: {error}")  # such as a full disk
        return WRONG_USAGE
    except KeyboardInterrupt:
        return INTERRUPTED
    return code


def _run_command(argv: Sequence[str] | None) -> int:
    parser = options_parser()
    given = list(sys.argv[1:] if argv is None else argv)
    cut = given.index("--") if "--" in given else len(given)
    given, arguments = given[:cut], given[cut + 1 :]  # argparse would parse the plan's options as ours
    given = ["--rerun=spawn" if word == "--rerun" else word for word in given]  # and the plan as the option's value
    if given == ["--version"]:
        print(f"pycram {versions()['pycram']}")
        return SUCCEEDED
    options, unknown = parser.parse_known_args(given)
    if unknown:
        parser.error(f"unrecognized arguments: {' '.join(unknown)}; the plan's own arguments come after --")
    if options.command == "describe":
        return _describe(options)
    if options.command == "sweep":
        return _sweep(options, arguments, again=argv is None)
    plan = demos() / f"{options.name}.py" if options.command == "demo" else Path(options.plan)
    if not plan.is_file():
        parser.error(f"{plan}: no such plan")
    _check_together(parser, options)
    values = _values(parser, plan, options.set)
    if options.command == "demo" and options.robot:
        arguments = ["--robot", options.robot, *arguments]
    seeded = options.seed is not None or options.explore is not None or argv is None
    seed = chosen_seed(options.seed) if seeded else None
    if argv is None and seed is not None:
        restart(seed)
    try:
        log = recording_path(options.log or "{plan}.mcap", plan.stem, seed)
    except ValueError as error:
        parser.error(str(error))
    spec = RunSpec(
        plan, tuple(arguments), seed, options.order, options.motion, values, local_variables=not options.no_locals
    )
    if options.explore is not None and seed is not None:
        return _explore(options, spec, log, seed)
    return run(
        spec,
        log,
        options.rerun,
        overwrite=options.overwrite,
        durable=options.durable,
        debug=options.debug_on_failure,
    )


def _check_together(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Refuse options that don't go together."""
    if options.command == "demo" and options.robot and options.name not in WITH_ROBOTS:
        parser.error(f"--robot goes with the demos {' and '.join(WITH_ROBOTS)}")
    for name in ("depth", "limit", "json") if options.explore is None else ():
        if getattr(options, name):
            parser.error(f"--{name} goes with --explore")
    if options.explore is not None and (options.rerun or options.order):
        parser.error("--rerun and --order are for one run; --explore makes many")
    if options.explore is not None and options.debug_on_failure:
        parser.error("--debug-on-failure is for one run; --explore tells the --order of those that fail")


def _values(parser: argparse.ArgumentParser, plan: Path, given: Sequence[str]) -> dict[str, Any]:
    """Return the values of a plan's parameters, if it has them."""
    if not given:
        return {}
    from pycram.foundation.failures import UsageError  # noqa: PLC0415  heavy
    from pycram.plan_parameters import check, value_of  # noqa: PLC0415  as above

    try:
        values = dict(map(value_of, given))
        check(plan, values)
    except (UsageError, SyntaxError) as error:
        parser.error(str(error))
    return values


def _explore(options: argparse.Namespace, spec: RunSpec, log: Path, seed: int) -> int:
    from pycram import exploration  # noqa: PLC0415  needs the engine
    from pycram.exploration import command  # noqa: PLC0415  as above

    def run_once(order: str, file: Path) -> None:
        run(replace(spec, order=order), file, overwrite=True)

    return command.run(
        run_once,
        str(spec.plan),
        spec.arguments,
        options.explore,
        seed=seed,
        motion=options.motion,
        values=options.set,
        depth=options.depth or exploration.DEPTH,
        limit=options.limit or exploration.LIMIT,
        file=log,
        overwrite=options.overwrite,
        as_json=options.json,
    )


def recording_path(template: str, plan: str, seed: int | None) -> Path:
    """Return the path of a recording: the template with its placeholders filled in.

    Raises:
        ValueError: It has an unknown placeholder, or a brace too many.
    """
    started = time.strftime("%Y-%m-%d_%H-%M-%S")
    try:
        return Path(template.format(plan=plan, time=started, seed="" if seed is None else seed))
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise ValueError(
            f"--log {template}: placeholders are {{plan}}, {{time}} and {{seed}}; a brace itself is {{{{ or }}}}"
        ) from error


def _sweep(options: argparse.Namespace, arguments: Sequence[str], *, again: bool) -> int:
    if again:
        restart(options.seed)
    try:
        with needed():
            from pycram.sweeping import command  # noqa: PLC0415  needs the engine

        return command.run(options, arguments)
    except NotInstalled as error:
        tell(f"pycram: {error}")
        return WRONG_USAGE


def _describe(options: argparse.Namespace) -> int:
    try:
        from pycram.describing import command  # noqa: PLC0415  needs the engine

        return command.run(options)
    except NotInstalled as error:
        print(f"pycram: {error}", file=sys.stderr)
        return WRONG_USAGE


if __name__ == "__main__":
    sys.exit(main())
