"""The command line: ``pycram demo`` and ``pycram run`` record any plan, ``pycram describe`` describes robots.

The command starts itself again (:mod:`pycram.seeding`), so whatever takes long to load is imported where it is used.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pycram.running import INTERRUPTED, SUCCEEDED, WRONG_USAGE, run, tell
from pycram.seeding import MAX_SEED, chosen_seed, restart
from recorder.closed_output import discard, until_closed
from recorder.errors import RecordingError
from recorder.packages import NotInstalled, needed, versions

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_SWEEP = (
    "Runs a plan many times, with other seeds and parameters, and records each run into a folder. Started again, it "
    "does what is missing. Arguments after -- go to the plan."
)
_WITH_ROBOTS = ("breakfast", "set_the_table")  # the demos that any of the robots in the box runs


def demos() -> Path:
    """Return the folder with the demos."""
    here = Path(__file__).parent
    installed = here / "demos"
    return installed if installed.is_dir() else here.parent / "demos"


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
    parser = _parser()
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
    if options.explore is not None and seed is not None:
        return _explore(options, plan, log, arguments, values, seed)
    return run(
        plan,
        log,
        arguments,
        options.rerun,
        seed=seed,
        order=options.order,
        motion=options.motion,
        local_variables=not options.no_locals,
        overwrite=options.overwrite,
        durable=options.durable,
        debug=options.debug_on_failure,
        parameters=values,
    )


def _check_together(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Refuse options that don't go together."""
    if options.command == "demo" and options.robot and options.name not in _WITH_ROBOTS:
        parser.error(f"--robot goes with the demos {' and '.join(_WITH_ROBOTS)}")
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


def _explore(
    options: argparse.Namespace,
    plan: Path,
    log: Path,
    arguments: Sequence[str],
    values: Mapping[str, Any],
    seed: int,
) -> int:
    from pycram import exploration  # noqa: PLC0415  needs the engine
    from pycram.exploration import command  # noqa: PLC0415  as above

    def run_once(order: str, file: Path) -> None:
        kept = not options.no_locals
        run(
            plan,
            file,
            arguments,
            seed=seed,
            order=order,
            motion=options.motion,
            local_variables=kept,
            overwrite=True,
            parameters=values,
        )

    return command.run(
        run_once,
        str(plan),
        arguments,
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="pycram", description="Runs robot plans and records everything that happens.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True)
    names = sorted(file.stem for file in demos().glob("*.py"))
    demo = commands.add_parser("demo", help="run a demo", description="Runs a demo.")
    demo.add_argument("name", nargs="?", default="set_the_table", choices=names, help="which (default: set_the_table)")
    robots = sorted(file.stem for file in (Path(__file__).parent / "models" / "robots").glob("*.toml"))
    where = " and ".join(_WITH_ROBOTS)
    demo.add_argument("--robot", choices=robots, help=f"which robot does it, in {where} (default: pr2)")
    plan = commands.add_parser(
        "run", help="run a plan", description="Runs a plan: any Python file. Arguments after -- go to the plan."
    )
    plan.add_argument("plan", metavar="PLAN.py", help="the plan")
    for recorded in (demo, plan):
        recorded.add_argument(
            "--log",
            metavar="FILE",
            help="the recording (default: {plan}.mcap in this folder); {plan}, {time} and {seed} stand for the plan's "
            "name, the time of its start and its seed. A recording that is there stays: then it is PLAN.2.mcap",
        )
        recorded.add_argument("--overwrite", action="store_true", help="replace a recording that is there")
        recorded.add_argument(
            "--durable", action="store_true", help="lose no record to a power cut either: each chunk waits for the disk"
        )
        recorded.add_argument(
            "--seed",
            metavar="N",
            type=_seed,
            help="seed of random, NumPy and the order of sets, 0 to 4294967295 (default: drawn; info tells it)",
        )
        recorded.add_argument(
            "--set", metavar="NAME=VALUE", action="append", default=[], help="the value of a parameter of the plan"
        )
        recorded.add_argument(
            "--order",
            metavar="ORDER",
            type=_order,
            default="",
            help="another order of branches than the seed draws, as --explore tells it",
        )
        recorded.add_argument(
            "--motion",
            choices=("simulated", "continuous"),
            default="",
            help="how motions are carried out where the plan doesn't say: at once (simulated, the default), or in "
            "simulated time, on paths without collision (continuous)",
        )
        recorded.add_argument(
            "--explore",
            metavar="N",
            type=_count,
            help="run it in N orders of its branches, and tell those that end differently, and what decides. "
            "Exit code 0: all succeed, and end alike. 1: else",
        )
        recorded.add_argument(
            "--depth", metavar="D", type=_count, help="of the races that --explore finds (default: 3)"
        )
        recorded.add_argument(
            "--limit", metavar="SECONDS", type=_seconds, help="that a run of --explore may take (default: 60)"
        )
        recorded.add_argument("--json", action="store_true", help="print what --explore finds as JSON")
        recorded.add_argument(
            "--no-locals", action="store_true", help="leave the plan's local variables out of recorded failures"
        )
        recorded.add_argument(
            "--rerun",
            metavar="VIEWER",
            type=_viewer,
            help="show it live: --rerun opens a viewer, --rerun=connect or =connect:URL uses a running one, "
            "--rerun=serve serves a page for the browser",
        )
        recorded.add_argument(
            "--debug-on-failure",
            action="store_true",
            help="when the plan fails, open the debugger at the failure: its frames, and the way back from there",
        )
    _add_sweep(commands.add_parser("sweep", help="run a plan many times", description=_SWEEP))
    describe = commands.add_parser(
        "describe",
        help="describe a robot or furniture",
        description="Writes a first description of a robot, guessed from its URDF, to stdout, or checks a description; "
        "of furniture, the surfaces, containers, joints and handles that are found in its URDF.",
    )
    describe.add_argument("file", nargs="?", metavar="FILE.urdf", help="a URDF, or the name of one in the box")
    describe.add_argument("--check", metavar="ROBOT.toml", help="test this description: reach, fingers, stillness, ...")
    describe.add_argument(
        "--picture",
        metavar="FILE",
        type=Path,
        help="also write a picture of the robot, parked; of furniture with its surfaces",
    )
    return parser


def _add_sweep(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN.py", help="the plan")
    parser.add_argument("--runs", metavar="N", type=_count, required=True, help="how many, numbered from 0")
    parser.add_argument("-o", "--output", metavar="FOLDER", required=True, help="where the recordings go")
    parser.add_argument("--seed", metavar="N", type=_seed, default=0, help="run I has the seed N + I (default: 0)")
    parser.add_argument("-j", "--jobs", metavar="N", type=_count, default=0, help="at once (default: one on each core)")
    parser.add_argument(
        "--set", metavar="NAME=VALUES", action="append", default=[], help="values of a parameter, as arm=left,right"
    )
    parser.add_argument(
        "--sample",
        metavar="NAME=DISTRIBUTION",
        action="append",
        default=[],
        help="a parameter that is drawn: uniform(a,b), normal(mean,deviation), integers(a,b), choice(a,b,...)",
    )
    parser.add_argument(
        "--limit", metavar="SECONDS", type=_seconds, default=300.0, help="that a run may take (default: 300)"
    )
    parser.add_argument("--memory", metavar="MB", type=_count, default=0, help="that a run may take (default: any)")
    parser.add_argument("--motion", choices=("simulated", "continuous"), default="", help="as for run")
    parser.add_argument("--no-locals", action="store_true", help="as for run")
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        nargs="?",
        const="",
        help="run on the Ray cluster at an address, or on one of this machine; FOLDER is shared by all nodes, or a URL "
        "that fsspec knows",
    )


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


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) > MAX_SEED:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 to {MAX_SEED}")
    return int(text)


def _count(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < threading.TIMEOUT_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} is no time in seconds, more than 0")
    return value


def _order(text: str) -> str:
    from pycram.foundation.failures import BadArgument  # noqa: PLC0415  heavy
    from pycram.scheduling.order import order_of  # noqa: PLC0415  heavy

    try:
        order_of(text, None)
    except BadArgument as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no order: expected {error.expected}") from error
    return text


def _viewer(text: str) -> str:
    from recorder.viewer.address import Target  # noqa: PLC0415  heavy

    try:
        Target.parse(text)
    except RecordingError as error:
        raise argparse.ArgumentTypeError(f"{text!r} {error.cause}") from error
    return text


if __name__ == "__main__":
    sys.exit(main())
