# PYTHON_ARGCOMPLETE_OK
"""The command line ``pycram``.

The command restarts itself (:mod:`pycram.running`), so functions import the modules that load slowly.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from pycram.running import INTERRUPTED, MAX_SEED, SUCCEEDED, WRONG_USAGE, RunSpec, chosen_seed, restart, run, tell
from recorder.errors import RecordingError, discard, similar_files, until_closed
from recorder.packages import NotInstalled, needed, versions
from recorder.terminal import Parser, complete, files_ending

_WITH_ROBOTS: Final = ("breakfast", "set_the_table")  # these demos run with any bundled robot
_SWEEP: Final = (
    "Runs a plan many times with different seeds and parameters, and records each run into a folder. A restarted sweep "
    "makes only the missing runs. Arguments after -- go to the plan."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command with the arguments ``argv``, or with the arguments of the process, and return its exit code.

    Returns:
        0 if the plan succeeded, 1 if it failed, 2 for wrong usage, 130 after Ctrl-C, 143 after SIGTERM, 129 after
        SIGHUP; or the plan's own exit code.
    """
    if argv is not None:
        return _run_command(argv)
    code = SUCCEEDED
    try:
        with until_closed():
            code = _run_command(argv)
        if code == INTERRUPTED:  # a second Ctrl-C ends the process immediately, without a traceback from the cleanup
            signal.signal(signal.SIGINT, signal.SIG_DFL)
    except OSError as error:
        discard(sys.stdout)
        tell(f"pycram: {error}")  # for example, the disk is full
        return WRONG_USAGE
    except KeyboardInterrupt:
        return INTERRUPTED
    return code


def _run_command(argv: Sequence[str] | None) -> int:
    parser = options_parser()
    complete(parser)
    given = list(sys.argv[1:] if argv is None else argv)
    cut = given.index("--") if "--" in given else len(given)
    given, arguments = given[:cut], given[cut + 1 :]  # argparse would mistake the plan's options for options of pycram
    # argparse would take the plan as the value of --rerun
    given = ["--rerun=spawn" if word == "--rerun" else word for word in given]
    if not given:
        parser.print_help(sys.stderr)
        return WRONG_USAGE
    if given == ["--version"]:
        print(f"pycram {versions()['pycram']}")
        return SUCCEEDED
    options, unknown = parser.parse_known_args(given)
    if unknown:
        parser.error(f"unrecognized arguments: {' '.join(unknown)}; the plan's own arguments come after --")
    if options.command in ("describe", "sweep", "tutorial"):
        checks = _checks(parser, options) if options.command == "sweep" else ()
        return _other_command(options, arguments, checks, again=argv is None)
    plan = demos() / f"{options.name}.py" if options.command == "demo" else Path(options.plan)
    if not plan.is_file():
        parser.error(f"{plan}: no such plan{similar_files(plan)}")
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
        plan,
        tuple(arguments),
        seed,
        options.order,
        options.motion,
        values,
        _checks(parser, options),
        options.check_only_record,
        local_variables=not options.no_locals,
    )
    if options.explore is not None:
        from pycram.exploration import command  # noqa: PLC0415  needs the engine

        return command.run(spec, options, log)
    return run(
        spec, log, options.rerun, overwrite=options.overwrite, durable=options.durable, debug=options.debug_on_failure
    )


def _other_command(options: argparse.Namespace, arguments: Sequence[str], checks: Sequence[str], *, again: bool) -> int:
    """Run ``sweep``, ``describe`` or ``tutorial``. If ``again`` is true, ``sweep`` first restarts this process."""
    if options.command == "tutorial":
        from pycram import tutorial  # noqa: PLC0415  only this command needs this import

        return tutorial.check(options.chapter)
    if options.command == "sweep" and again:
        restart(options.seed)
    try:
        if options.command == "describe":
            from pycram.describing import command as describing  # noqa: PLC0415  needs the engine

            return describing.run(options)
        with needed():
            from pycram.sweeping import command as sweeping  # noqa: PLC0415  needs the engine
        return sweeping.run(options, arguments, checks)
    except NotInstalled as error:
        tell(f"pycram: {error}")
        return WRONG_USAGE


def _check_together(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    if options.command == "demo" and options.robot and options.name not in _WITH_ROBOTS:
        parser.error(f"--robot is only for the demos {' and '.join(_WITH_ROBOTS)}")
    for name in ("depth", "limit", "json") if options.explore is None else ():
        if getattr(options, name):
            parser.error(f"--{name} is only for --explore")
    if options.explore is not None and (options.rerun or options.order):
        parser.error("--rerun and --order are for one run; --explore makes many runs")
    if options.explore is not None and options.debug_on_failure:
        parser.error("--debug-on-failure is for one run; --explore prints the --order of each failing run")


def _values(parser: argparse.ArgumentParser, plan: Path, given: Sequence[str]) -> dict[str, Any]:
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


def _checks(parser: argparse.ArgumentParser, options: argparse.Namespace) -> tuple[str, ...]:
    if not options.check:
        return ()
    from recorder.properties import BadProperty, parse_file  # noqa: PLC0415  slow to import

    try:
        return tuple(each.text for file in options.check for each in parse_file(file))
    except BadProperty as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename}: {error.strerror}")


def recording_path(template: str, plan: str, seed: int | None) -> Path:
    """Return a recording's path: the template with its placeholders filled in; raise ValueError for other braces."""
    started = time.strftime("%Y-%m-%d_%H-%M-%S")
    try:
        return Path(template.format(plan=plan, time=started, seed="" if seed is None else seed))
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise ValueError(
            f"--log {template}: placeholders are {{plan}}, {{time}} and {{seed}}; write a brace as {{{{ or }}}}"
        ) from error


def demos() -> Path:
    """Return the folder with the demos."""
    here = Path(__file__).parent
    installed = here / "demos"
    return installed if installed.is_dir() else here.parent / "demos"


#: Two examples for each command: the arguments, and the effect.
EXAMPLES: Final = {
    "demo": (("", "set the table"), ("breakfast --robot tiago_pro", "prepare breakfast with the robot TIAGo Pro")),
    "run": (
        ("plan.py --seed 7 --log run.mcap", "run a plan, and record it into run.mcap"),
        ("plan.py --explore 100", "run the plan in 100 orders of its branches"),
    ),
    "sweep": (
        ("plan.py --runs 100 -o runs", "100 runs with other seeds, recorded into a folder"),
        ("plan.py --runs 20 -o runs --set arm=left,right", "20 runs; half of them with each value of arm"),
    ),
    "describe": (
        ("my_robot.urdf", "guess the description of a robot"),
        ("kitchen.urdf --picture kitchen.png", "list and draw the surfaces and doors of furniture"),
    ),
    "tutorial": (
        ("check 3", "check exercise_3_1.py and exercise_3_2.py in this folder"),
        ("check 6", "check the exercises of chapter 6"),
    ),
}


def options_parser() -> Parser:
    """Return the parser of the command line."""
    parser = Parser(
        prog="pycram",
        description="Runs robot plans and records everything that happens. 'pycram COMMAND --help' shows examples.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True)
    names = sorted(file.stem for file in demos().glob("*.py"))

    def add_command(name: str, help_text: str, description: str) -> Parser:
        return commands.add_parser(
            name,
            help=help_text,
            description=description,
            examples=lambda: [(f"pycram {name} {arguments}".rstrip(), effect) for arguments, effect in EXAMPLES[name]],
            completers={"PLAN.py": files_ending(".py"), "FILE.urdf": files_ending(".urdf")},
        )

    demo = add_command("demo", "run a demo", "Runs a demo.")
    demo.add_argument(
        "name", nargs="?", default="set_the_table", choices=names, help="the demo (default: set_the_table)"
    )
    robots = sorted(file.stem for file in (Path(__file__).parent / "models" / "robots").glob("*.toml"))
    demo.add_argument("--robot", choices=robots, help=f"the robot, in {' and '.join(_WITH_ROBOTS)} (default: pr2)")
    plan = add_command("run", "run a plan", "Runs a plan: any Python file. Arguments after -- go to the plan.")
    plan.add_argument("plan", metavar="PLAN.py", help="the plan")
    for recorded in (demo, plan):
        _add_recording(recorded)
    _add_sweep(add_command("sweep", "run a plan many times", _SWEEP))
    describe = add_command(
        "describe",
        "describe a robot or furniture",
        "For a robot, guesses a first description from its URDF and prints it, or checks a description. "
        "For furniture, lists the surfaces, containers, joints and handles in its URDF.",
    )
    describe.add_argument("file", nargs="?", metavar="FILE.urdf", help="the URDF file, or the name of a bundled URDF")
    describe.add_argument("--check", metavar="ROBOT.toml", help="test this description: reach, fingers, stillness, ...")
    describe.add_argument(
        "--gripper",
        choices=("suction", "two-finger"),
        help="the gripper for each arm without a gripper: a suction cup, or two fingers, which the command adds to a "
        "copy of the URDF, FILE_with_gripper.urdf",
    )
    describe.add_argument(
        "--picture",
        metavar="FILE",
        type=Path,
        help="also write a picture of the parked robot, or of the furniture with its surfaces",
    )
    tutorial = add_command(
        "tutorial",
        "check exercises of the tutorial",
        "Runs your solutions of a chapter's exercises, and checks their recordings. Exit code 1: an exercise is wrong.",
    )
    tutorial.add_argument("action", choices=("check",), help="what to do")
    tutorial.add_argument("chapter", metavar="CHAPTER", type=int, choices=range(1, 8), help="the chapter, 1 to 7")
    return parser


def _add_recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--log",
        metavar="FILE",
        help="the recording (default: {plan}.mcap in this folder); {plan}, {time} and {seed} stand for the plan's "
        "name, its start time and its seed. If this file exists, pycram writes PLAN.2.mcap",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing recording")
    parser.add_argument(
        "--durable", action="store_true", help="lose no record on power loss: wait for the disk after each chunk"
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=_seed,
        help="seed of random, NumPy and the order of sets, 0 to 4294967295 (default: a random seed, which "
        "'pycram-replay info' prints)",
    )
    parser.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="set a parameter of the plan to a value"
    )
    parser.add_argument(
        "--order",
        metavar="ORDER",
        type=_order,
        default="",
        help="use an order of branches that --explore printed, instead of the seed's order",
    )
    parser.add_argument(
        "--motion",
        choices=("simulated", "continuous"),
        default="",
        help="how motions are executed, unless the plan names an environment: instantaneously (simulated, the "
        "default), or in simulated time on collision-free paths (continuous)",
    )
    parser.add_argument(
        "--explore",
        metavar="N",
        type=_count,
        help="run the plan in N orders of its branches; report each different end, and the order of branches that "
        "causes this end. The exit code is 0 if all runs succeed and end alike, else 1",
    )
    parser.add_argument(
        "--depth", metavar="D", type=_count, help="maximum depth of the races that --explore finds (default: 3)"
    )
    parser.add_argument(
        "--limit", metavar="SECONDS", type=_seconds, help="time limit of each run of --explore (default: 60)"
    )
    parser.add_argument("--json", action="store_true", help="print the results of --explore as JSON")
    parser.add_argument(
        "--check",
        metavar="FILE",
        action="append",
        default=[],
        help="watch the properties in this file (docs/reference/properties.md); a violation fails the plan",
    )
    parser.add_argument(
        "--check-only-record", action="store_true", help="record violations of --check, without failing the plan"
    )
    parser.add_argument(
        "--no-locals", action="store_true", help="leave the plan's local variables out of recorded failures"
    )
    parser.add_argument(
        "--rerun",
        metavar="VIEWER",
        type=_viewer,
        help="show the run live: --rerun opens a viewer, --rerun=connect or =connect:URL uses a running viewer, "
        "--rerun=serve serves a page for the browser",
    )
    parser.add_argument(
        "--debug-on-failure",
        action="store_true",
        help="if the plan fails, open the debugger at the failure; the debugger can step backwards",
    )


def _add_sweep(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PLAN.py", help="the plan")
    parser.add_argument("--runs", metavar="N", type=_count, required=True, help="number of runs, numbered from 0")
    parser.add_argument("-o", "--output", metavar="FOLDER", required=True, help="the folder for the recordings")
    parser.add_argument("--seed", metavar="N", type=_seed, default=0, help="run I gets the seed N + I (default: 0)")
    parser.add_argument(
        "-j", "--jobs", metavar="N", type=_count, default=0, help="number of parallel runs (default: one per core)"
    )
    parser.add_argument(
        "--set",
        metavar="NAME=VALUES",
        action="append",
        default=[],
        help="values of a parameter, such as arm=left,right",
    )
    parser.add_argument(
        "--sample",
        metavar="NAME=DISTRIBUTION",
        action="append",
        default=[],
        help="draw the parameter from uniform(a,b), normal(mean,deviation), integers(a,b) or choice(a,b,...)",
    )
    parser.add_argument(
        "--limit", metavar="SECONDS", type=_seconds, default=300.0, help="time limit of each run (default: 300)"
    )
    parser.add_argument(
        "--memory", metavar="MB", type=_count, default=0, help="memory limit of each run (default: none)"
    )
    parser.add_argument("--motion", choices=("simulated", "continuous"), default="", help="as for run")
    parser.add_argument("--check", metavar="FILE", action="append", default=[], help="as for run")
    parser.add_argument("--no-locals", action="store_true", help="as for run")
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        nargs="?",
        const="",
        help="run on the Ray cluster at this address, or on a local cluster. FOLDER is a folder that all nodes share, "
        "or a URL that fsspec supports",
    )


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) > MAX_SEED:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to {MAX_SEED}")
    return int(text)


def _count(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < threading.TIMEOUT_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time in seconds greater than 0")
    return value


def _order(text: str) -> str:
    if not text:  # the default
        return text
    from pycram.foundation.failures import BadArgument  # noqa: PLC0415  heavy
    from pycram.scheduling.order import order_of  # noqa: PLC0415  heavy

    try:
        order_of(text, None)
    except BadArgument as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not an order: expected {error.expected}") from error
    return text


def _viewer(text: str) -> str:
    from recorder.viewer.connection import Target  # noqa: PLC0415  heavy

    try:
        Target.parse(text)
    except RecordingError as error:
        raise argparse.ArgumentTypeError(f"{text!r} {error.cause}") from error
    return text


if __name__ == "__main__":
    sys.exit(main())
