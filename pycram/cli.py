"""The command line: ``pycram demo`` and ``pycram run`` record any plan, ``pycram describe`` describes robots.

The command starts itself again (:mod:`pycram.seeding`), so whatever takes long to load is imported where it is used.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import runpy
import shlex
import signal
import subprocess
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

import recorder
from pycram.seeding import MAX_SEED, chosen_seed, restart, seed_random_numbers
from recorder.closed_output import discard, until_closed
from recorder.errors import RecordingError
from recorder.packages import NotInstalled, needed, versions
from recorder.tracing.interrupts import Terminated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder import Recording

_PAGE = "serve"  # of --rerun
_WITH_ROBOTS = ("breakfast", "set_the_table")  # the demos that any of the robots in the box runs
_SUCCEEDED, _FAILED, _WRONG_USAGE, _INTERRUPTED = 0, 1, 2, 130  # exit codes


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
    code = _SUCCEEDED
    try:
        with until_closed():
            code = _run_command(argv)
        if code == _INTERRUPTED:  # another one ends the process at once, and leaves no traceback of tidying up
            signal.signal(signal.SIGINT, signal.SIG_DFL)
    except OSError as error:
        discard(sys.stdout)
        _tell(f"pycram: {error}")  # such as a full disk
        return _WRONG_USAGE
    except KeyboardInterrupt:
        return _INTERRUPTED
    return code


def _run_command(argv: Sequence[str] | None) -> int:
    parser = _parser()
    given = list(sys.argv[1:] if argv is None else argv)
    cut = given.index("--") if "--" in given else len(given)
    given, arguments = given[:cut], given[cut + 1 :]  # argparse would parse the plan's options as ours
    given = ["--rerun=spawn" if word == "--rerun" else word for word in given]  # and the plan as the option's value
    if given == ["--version"]:
        print(f"pycram {versions()['pycram']}")
        return _SUCCEEDED
    options, unknown = parser.parse_known_args(given)
    if unknown:
        parser.error(f"unrecognized arguments: {' '.join(unknown)}; the plan's own arguments come after --")
    if options.command == "describe":
        return _describe(options)
    plan = demos() / f"{options.name}.py" if options.command == "demo" else Path(options.plan)
    if not plan.is_file():
        parser.error(f"{plan}: no such plan")
    _check_together(parser, options)
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
        return _explore(options, plan, log, arguments, seed)
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


def _explore(options: argparse.Namespace, plan: Path, log: Path, arguments: Sequence[str], seed: int) -> int:
    from pycram import exploration  # noqa: PLC0415  needs the engine
    from pycram.exploration import command  # noqa: PLC0415  as above

    def run_once(order: str, file: Path) -> None:
        kept = not options.no_locals
        run(plan, file, arguments, seed=seed, order=order, motion=options.motion, local_variables=kept, overwrite=True)

    return command.run(
        run_once,
        str(plan),
        arguments,
        options.explore,
        seed=seed,
        motion=options.motion,
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


def _describe(options: argparse.Namespace) -> int:
    try:
        from pycram.describing import command  # noqa: PLC0415  needs the engine

        return command.run(options)
    except NotInstalled as error:
        print(f"pycram: {error}", file=sys.stderr)
        return _WRONG_USAGE


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


def run(
    plan: Path,
    log: Path,
    arguments: Sequence[str] = (),
    live: str | None = None,
    *,
    seed: int | None = None,
    order: str = "",
    motion: str = "",
    local_variables: bool = True,
    overwrite: bool = False,
    durable: bool = False,
    debug: bool = False,
) -> int:
    """Run a plan as a main program, record it, and return the exit code, as :func:`main` does.

    Args:
        plan: The Python file.
        log: The recording; one that is there stays, and the next free name is taken.
        arguments: Of the plan.
        live: The live viewer; see :func:`recorder.record`.
        seed: Of random numbers; None to leave them as they are.
        order: Of branches; "" for the one that the seed draws.
        motion: The execution environment where the plan names none; "" for "simulated".
        local_variables: Whether failures hold the plan's local variables.
        overwrite: Whether a recording that is there is replaced.
        durable: Whether records survive the loss of power.
        debug: Whether the debugger opens where the plan has failed.
    """
    before = sys.argv, list(sys.path)
    sys.argv = [str(plan), *arguments]
    sys.path.insert(0, str(plan.parent.resolve()))
    folder, file = Path.cwd(), log.absolute()  # a plan may change the working directory
    recording: Recording | None = None
    code = _SUCCEEDED
    error: BaseException | None = None
    seed_random_numbers(seed)
    try:
        with needed():
            from pycram.motions.environments import set_default  # noqa: PLC0415  --version and --help need no executor
            from pycram.scheduling.schedule import seed_order  # noqa: PLC0415  as above
        seed_order(seed, order)
        set_default(motion)
        recorded = recorder.record(
            file,
            live,
            name=plan.stem,
            arguments=arguments,
            source=plan,
            seed=seed,
            order=order,
            environment=motion,
            output=True,
            locals=local_variables,
            overwrite=overwrite,
            durable=durable,
        )
        with recorded as recording:
            try:
                runpy.run_path(str(plan.absolute()), run_name="__main__")
            finally:
                _wait_for_threads()
    except BaseException as raised:  # noqa: BLE001  whatever the plan's own code raises
        error = raised
        code = _report(raised)
    finally:
        sys.argv, sys.path[:] = before
    if recording is not None and recording.path.is_file() and not (_was_lost(error) or isinstance(error, NotInstalled)):
        _print_next_steps(_shown(recording.path, folder, log), recording.path.stat().st_size / 1e6, code)
        if live == _PAGE and not isinstance(error, KeyboardInterrupt | Terminated):
            _keep_page(recording)
        if debug and code == _FAILED:
            _debug(recording.path)
    return code


def _report(error: BaseException) -> int:
    """Print how a plan ended, and return the exit code."""
    from pycram.foundation.failures import PlanFailure, PycramError  # noqa: PLC0415  heavy
    from recorder.records import format_error  # noqa: PLC0415  heavy

    match error:
        case RecordingError() | NotInstalled():
            _tell(f"pycram: {error}")
            return _WRONG_USAGE
        case Terminated():
            _tell(f"\npycram: interrupted by {error.signal}")
            return int(error.code or 0)
        case SystemExit():
            if isinstance(error.code, int | None):
                return error.code or _SUCCEEDED
            _tell(str(error.code))
            return _FAILED
        case KeyboardInterrupt():
            _tell("\npycram: interrupted")
            return _INTERRUPTED
    _tell("".join(traceback.format_exception(error)).rstrip())
    kind = "uses PyCRAM wrongly" if isinstance(error, PycramError) else "has an error"
    how = "failed" if isinstance(error, PlanFailure) else kind
    _tell(f"\npycram: the plan {how}: {format_error(error)}")
    return _FAILED


def _tell(text: str) -> None:
    """Print a message, if anybody reads it: how a plan ended doesn't depend on that."""
    with until_closed():
        print(text, file=sys.stderr)


def _was_lost(error: BaseException | None) -> bool:
    """Whether the recording failed, before the plan did or when it was closed after that."""
    return isinstance(error, RecordingError) or (error is not None and isinstance(error.__context__, RecordingError))


def _shown(file: Path, folder: Path, log: Path) -> Path:
    """Return the path of a recording as the user wrote it."""
    return file if log.is_absolute() else Path(os.path.relpath(file, folder))


def _keep_page(recording: Recording) -> None:
    """Serve the viewer's page until Ctrl-C, if the plan was started from a terminal."""
    if recording.viewer is None or not sys.stdin.isatty():
        return
    _tell("pycram: the page stays until Ctrl-C")
    with contextlib.suppress(KeyboardInterrupt):
        recording.viewer.wait()


def _debug(log: Path) -> None:
    """Open the debugger, which runs the plan again to its failure: it is above all that runs plans."""
    subprocess.run([sys.executable, "-P", "-m", "replay", "debug", str(log)], check=False)  # noqa: S603  ours


def _wait_for_threads() -> None:
    """Wait for threads that the plan has left running, as Python does at its end: they are part of the plan."""
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()


def _print_next_steps(log: Path, size: float, code: int) -> None:
    _tell(f"pycram: recorded to {log} ({size:.1f} MB). Next:")
    for verb in ("info", "tree", "view") if code == _SUCCEEDED else ("why", "tree", "view"):
        _tell(f"  pycram-replay {verb} {shlex.quote(str(log))}")


if __name__ == "__main__":
    sys.exit(main())
