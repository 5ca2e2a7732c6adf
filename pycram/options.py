"""Options of the command line ``pycram``; what the commands do is :mod:`pycram.cli`'s."""

from __future__ import annotations

import argparse
import threading
from pathlib import Path

from pycram.seeding import MAX_SEED
from recorder.errors import RecordingError

_SWEEP = (
    "Runs a plan many times, with other seeds and parameters, and records each run into a folder. Started again, it "
    "does what is missing. Arguments after -- go to the plan."
)
WITH_ROBOTS = ("breakfast", "set_the_table")  # the demos that any of the robots in the box runs


def demos() -> Path:
    """Return the folder with the demos."""
    here = Path(__file__).parent
    installed = here / "demos"
    return installed if installed.is_dir() else here.parent / "demos"


def options_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(prog="pycram", description="Runs robot plans and records everything that happens.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True)
    names = sorted(file.stem for file in demos().glob("*.py"))
    demo = commands.add_parser("demo", help="run a demo", description="Runs a demo.")
    demo.add_argument("name", nargs="?", default="set_the_table", choices=names, help="which (default: set_the_table)")
    robots = sorted(file.stem for file in (Path(__file__).parent / "models" / "robots").glob("*.toml"))
    where = " and ".join(WITH_ROBOTS)
    demo.add_argument("--robot", choices=robots, help=f"which robot does it, in {where} (default: pr2)")
    plan = commands.add_parser(
        "run", help="run a plan", description="Runs a plan: any Python file. Arguments after -- go to the plan."
    )
    plan.add_argument("plan", metavar="PLAN.py", help="the plan")
    for recorded in (demo, plan):
        _add_recording(recorded)
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


def _add_recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--log",
        metavar="FILE",
        help="the recording (default: {plan}.mcap in this folder); {plan}, {time} and {seed} stand for the plan's "
        "name, the time of its start and its seed. A recording that is there stays: then it is PLAN.2.mcap",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace a recording that is there")
    parser.add_argument(
        "--durable", action="store_true", help="lose no record to a power cut either: each chunk waits for the disk"
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=_seed,
        help="seed of random, NumPy and the order of sets, 0 to 4294967295 (default: drawn; info tells it)",
    )
    parser.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="the value of a parameter of the plan"
    )
    parser.add_argument(
        "--order",
        metavar="ORDER",
        type=_order,
        default="",
        help="another order of branches than the seed draws, as --explore tells it",
    )
    parser.add_argument(
        "--motion",
        choices=("simulated", "continuous"),
        default="",
        help="how motions are carried out where the plan doesn't say: at once (simulated, the default), or in "
        "simulated time, on paths without collision (continuous)",
    )
    parser.add_argument(
        "--explore",
        metavar="N",
        type=_count,
        help="run it in N orders of its branches, and tell those that end differently, and what decides. "
        "Exit code 0: all succeed, and end alike. 1: else",
    )
    parser.add_argument("--depth", metavar="D", type=_count, help="of the races that --explore finds (default: 3)")
    parser.add_argument(
        "--limit", metavar="SECONDS", type=_seconds, help="that a run of --explore may take (default: 60)"
    )
    parser.add_argument("--json", action="store_true", help="print what --explore finds as JSON")
    parser.add_argument(
        "--no-locals", action="store_true", help="leave the plan's local variables out of recorded failures"
    )
    parser.add_argument(
        "--rerun",
        metavar="VIEWER",
        type=_viewer,
        help="show it live: --rerun opens a viewer, --rerun=connect or =connect:URL uses a running one, "
        "--rerun=serve serves a page for the browser",
    )
    parser.add_argument(
        "--debug-on-failure",
        action="store_true",
        help="when the plan fails, open the debugger at the failure: its frames, and the way back from there",
    )


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
    from recorder.viewer.connection import Target  # noqa: PLC0415  heavy

    try:
        Target.parse(text)
    except RecordingError as error:
        raise argparse.ArgumentTypeError(f"{text!r} {error.cause}") from error
    return text
