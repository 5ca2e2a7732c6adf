"""The command line: ``pycram demo`` and ``pycram run`` record any plan, ``pycram describe`` describes robots."""

from __future__ import annotations

import argparse
import contextlib
import runpy
import shlex
import sys
import threading
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from pycram.foundation.failures import PlanFailure, PycramError
from pycram.models import robot_urdfs
from recorder import RecordingError, record
from recorder.packages import NotInstalled, versions
from recorder.records import format_error
from recorder.tracing.interrupts import interrupted_by, terminable
from recorder.viewer.address import Kind, Target

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder import Recording

_WITH_ROBOTS = "set_the_table"  # the demo that any of the robots in the box runs
_SUCCEEDED, _FAILED, _WRONG_USAGE, _INTERRUPTED, _TERMINATED = 0, 1, 2, 130, 143  # exit codes


def demos() -> Path:
    """Return the folder with the demos."""
    here = Path(__file__).parent
    installed = here / "demos"
    return installed if installed.is_dir() else here.parent / "demos"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command, by default with the process' arguments, and return its exit code.

    Returns:
        0 if the plan succeeded, 1 if it failed, 2 for wrong usage, 130 if Ctrl-C interrupted it, 143 if SIGTERM did;
        else the plan's own.
    """
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
    if options.command == "demo" and options.robot:
        if options.name != _WITH_ROBOTS:
            parser.error(f"--robot goes with the demo {_WITH_ROBOTS}")
        arguments = ["--robot", options.robot, *arguments]
    log = Path(options.log) if options.log else Path(f"{plan.stem}.mcap")
    return run(plan, log, arguments, options.rerun)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="pycram", description="Runs robot plans and records everything that happens.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True)
    names = sorted(file.stem for file in demos().glob("*.py"))
    demo = commands.add_parser("demo", help="run a demo", description="Runs a demo.")
    demo.add_argument("name", nargs="?", default="set_the_table", choices=names, help="which (default: set_the_table)")
    robots = sorted(Path(name).stem for name in robot_urdfs.NAMES)
    demo.add_argument("--robot", choices=robots, help=f"which robot does it, in {_WITH_ROBOTS} (default: pr2)")
    plan = commands.add_parser(
        "run", help="run a plan", description="Runs a plan: any Python file. Arguments after -- go to the plan."
    )
    plan.add_argument("plan", metavar="PLAN.py", help="the plan")
    for recorded in (demo, plan):
        recorded.add_argument("--log", metavar="FILE", help="the recording (default: PLAN.mcap in this folder)")
        recorded.add_argument(
            "--rerun",
            metavar="VIEWER",
            type=_viewer,
            help="show it live: --rerun opens a viewer, --rerun=connect or =connect:URL uses a running one, "
            "--rerun=serve serves a page for the browser",
        )
    describe = commands.add_parser(
        "describe",
        help="describe a robot",
        description="Writes a first description of a robot, guessed from its URDF, to stdout; or checks a description.",
    )
    describe.add_argument("file", nargs="?", metavar="ROBOT.urdf", help="a URDF, or the name of a robot in the box")
    describe.add_argument("--check", metavar="ROBOT.toml", help="test this description: reach, fingers, stillness, ...")
    describe.add_argument("--picture", metavar="FILE", type=Path, help="also write a picture of the robot, parked")
    return parser


def _describe(options: argparse.Namespace) -> int:
    try:
        from pycram.describing import command  # noqa: PLC0415  needs the engine

        return command.run(options)
    except NotInstalled as error:
        print(f"pycram: {error}", file=sys.stderr)
        return _WRONG_USAGE


def _viewer(text: str) -> str:
    try:
        Target.parse(text)
    except RecordingError as error:
        raise argparse.ArgumentTypeError(f"{text!r} {error.cause}") from error
    return text


def run(plan: Path, log: Path, arguments: Sequence[str] = (), live: str | None = None) -> int:
    """Run a plan as a main program, record it, and return the exit code, as :func:`main` does.

    Args:
        plan: The Python file.
        log: The recording.
        arguments: Of the plan.
        live: The live viewer; see :func:`recorder.record`.
    """
    before = sys.argv, list(sys.path)
    sys.argv = [str(plan), *arguments]
    sys.path.insert(0, str(plan.parent.resolve()))
    file = log.absolute()  # a plan may change the working directory
    recording: Recording | None = None
    code = _SUCCEEDED
    try:
        with terminable(), record(file, live, name=plan.stem, arguments=arguments, source=plan) as recording:
            try:
                runpy.run_path(str(plan.absolute()), run_name="__main__")
            finally:
                _wait_for_threads()
    except RecordingError as error:
        print(f"pycram: {error}", file=sys.stderr)
        code = _WRONG_USAGE
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else _SUCCEEDED if end.code is None else _FAILED
        if not isinstance(end.code, int | None):
            print(end.code, file=sys.stderr)
    except NotInstalled as error:
        print(f"pycram: {error}", file=sys.stderr)
        return _WRONG_USAGE
    except PlanFailure as failure:
        traceback.print_exc()
        print(f"\npycram: the plan failed: {format_error(failure)}", file=sys.stderr)
        code = _FAILED
    except KeyboardInterrupt:
        terminated = interrupted_by() == "SIGTERM"
        print(f"\npycram: interrupted{' by SIGTERM' if terminated else ''}", file=sys.stderr)
        code = _TERMINATED if terminated else _INTERRUPTED
    except BaseException as error:  # noqa: BLE001  whatever the plan's own code raises
        traceback.print_exc()
        kind = "uses PyCRAM wrongly" if isinstance(error, PycramError) else "has an error"
        print(f"\npycram: the plan {kind}: {format_error(error)}", file=sys.stderr)
        code = _FAILED
    finally:
        sys.argv, sys.path[:] = before
    if recording is not None and file.is_file():
        _print_next_steps(log, file.stat().st_size / 1e6, code)
        if live == Kind.SERVE.value and code not in (_INTERRUPTED, _TERMINATED):
            _keep_page(recording)
    return code


def _keep_page(recording: Recording) -> None:
    """Serve the viewer's page until Ctrl-C, if the plan was started from a terminal."""
    if recording.viewer is None or not sys.stdin.isatty():
        return
    print("pycram: the page stays until Ctrl-C", file=sys.stderr)
    with contextlib.suppress(KeyboardInterrupt):
        recording.viewer.wait()


def _wait_for_threads() -> None:
    """Wait for threads that the plan has left running, as Python does at its end: they are part of the plan."""
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()


def _print_next_steps(log: Path, size: float, code: int) -> None:
    print(f"pycram: recorded to {log} ({size:.1f} MB). Next:", file=sys.stderr)
    for verb in ("info", "tree", "view") if code == _SUCCEEDED else ("why", "tree", "view"):
        print(f"  pycram-replay {verb} {shlex.quote(str(log))}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
