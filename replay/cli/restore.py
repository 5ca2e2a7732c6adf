"""``restore``: a live world as it was, for a script, in a shell, or in a window."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from recorder.records import STEPS_PER_SECOND
from replay.cli.console import print_json, remark, results_only, visible
from replay.cli.main import FINE
from replay.errors import ReplayError
from replay.explain.step_names import HINT

if TYPE_CHECKING:
    import argparse

    from pycram.world.world import BulletWorld
    from replay.recording import Recording
    from replay.state.json_data import Plain


def add(parser: argparse.ArgumentParser) -> None:
    """Takes the step, and what to do there."""
    parser.add_argument("step", metavar="STEP", help=HINT)
    doing = parser.add_mutually_exclusive_group()
    doing.add_argument("--script", metavar="FILE", help="run a Python file there; it finds world, and objects by name")
    doing.add_argument("--shell", action="store_true", help="talk Python there (what is done if nothing is said)")
    parser.add_argument("--gui", action="store_true", help="in PyBullet's window; alone: look at it until it is closed")
    parser.add_argument("--exact", action="store_true", help="make every change again, so that its future is the same")
    parser.add_argument("--world", metavar="NAME", help="this world (default: the one opened last)")
    parser.add_argument("--log", dest="target", metavar="FILE", help="record what happens there (default: nothing is)")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Restores the world and does there what is wanted."""
    from pycram.foundation.failures import DisplayError  # noqa: PLC0415  --help needn't wait for the engine
    from recorder import RecordingError, record  # noqa: PLC0415
    from replay.restore.world import world_at  # noqa: PLC0415

    script = None if options.script is None else Path(options.script)
    if script is not None and not script.is_file():
        raise ReplayError(f"{script}: no such file")
    target = None if options.target is None else Path(options.target)
    if target is not None and target.exists() and target.samefile(log.path):
        raise ReplayError(f"{target}: that is the recording itself; what happens there goes into another file")
    step = log.step(options.step)
    try:
        with results_only():
            world = world_at(log, step, options.world, exact=options.exact, mode="GUI" if options.gui else "DIRECT")
    except DisplayError as error:
        raise ReplayError(str(error)) from error
    try:
        with world, record(target, source=script) if target is not None else nullcontext():
            return _do(log, step, world, script, options)
    except RecordingError as error:
        raise ReplayError(str(error)) from error


def _do(log: Recording, step: int, world: BulletWorld, script: Path | None, options: argparse.Namespace) -> int:
    from replay.restore.session import names, run_script, shell, watch  # noqa: PLC0415  see run

    given = names(world, log, step)
    if script is not None:
        with results_only():
            return run_script(script, given)
    if options.json:
        print_json(_plain(step, world, exact=options.exact))
    elif options.gui and not options.shell:
        remark(f"{world.name}: close the window, or press Ctrl-C, to end")
        watch(world)
    else:
        told = ", ".join(name for name in given if name not in ("log", "step", "btr"))
        clock = f"{world.sim_step / STEPS_PER_SECOND:.3f} s simulated"
        banner = f"{world.name}, {clock}. There are {told}; log, step and btr."
        shell(given, visible(banner))
    return FINE


def _plain(step: int, world: BulletWorld, *, exact: bool) -> Plain:
    objects: dict[str, Plain] = {}
    for body in world.objects:
        position, orientation = body.get_position_and_orientation()
        objects[body.name] = {
            "position": list(position),
            "orientation": list(orientation),
            "joints": dict(body.get_joint_positions()),
        }
    return {"step": step, "world": world.name, "exact": exact, "objects": objects}
