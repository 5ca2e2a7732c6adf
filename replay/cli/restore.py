"""``restore``: a live world as it was, for a script, in a shell, or in a window."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from recorder.records import STEPS_PER_SECOND
from replay.cli.arguments import add_step, print_moment
from replay.cli.console import native_output_to_stderr, print_json, print_message, visible
from replay.cli.main import FINE
from replay.errors import ReplayError

if TYPE_CHECKING:
    import argparse

    from pycram.world.world import BulletWorld
    from recorder.records import Plain
    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Add the step, and what to do there."""
    add_step(parser)
    doing = parser.add_mutually_exclusive_group()
    doing.add_argument(
        "--script",
        metavar="FILE",
        help="run a Python file there, with the variables world, robot and the objects' names",
    )
    doing.add_argument("--shell", action="store_true", help="interactive Python there (the default)")
    parser.add_argument(
        "--gui", action="store_true", help="in PyBullet's window; without --script and --shell until it is closed"
    )
    parser.add_argument(
        "--exact", action="store_true", help="execute every change again, so that its future is the original's"
    )
    parser.add_argument("--world", metavar="NAME", help="this world (default: the one opened last)")
    parser.add_argument("--log", dest="target", metavar="FILE", help="record what happens there")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Restore the world, then run the script, the shell or the window."""
    from pycram.foundation.failures import DisplayError  # noqa: PLC0415  --help needn't wait for the engine
    from recorder import RecordingError, record  # noqa: PLC0415

    script = None if options.script is None else Path(options.script)
    if script is not None and not script.is_file():
        raise ReplayError(f"{script}: no such file")
    target = None if options.target is None else Path(options.target)
    if target is not None and target.exists() and target.samefile(log.path):
        raise ReplayError(f"{target}: that is the recording itself; name another file")
    step = log.step(options.step)
    try:
        with native_output_to_stderr():
            world = log.world_at(
                options.step, options.world, exact=options.exact, mode="GUI" if options.gui else "DIRECT"
            )
    except DisplayError as error:
        raise ReplayError(str(error)) from error
    print_moment(log, options.step, exact=options.exact)
    try:
        with world, record(target, source=script) if target is not None else nullcontext():
            return _do(log, step, world, script, options)
    except RecordingError as error:
        raise ReplayError(str(error)) from error


def _do(log: Recording, step: int, world: BulletWorld, script: Path | None, options: argparse.Namespace) -> int:
    from replay.restore.shell import run_script, shell, variables_of  # noqa: PLC0415  see run

    variables = variables_of(world, log, step)
    if script is not None:
        with native_output_to_stderr():
            return run_script(script, variables)
    if options.json:
        print_json(_plain(step, world, exact=options.exact))
    elif options.gui and not options.shell:
        from pycram.world.window import watch  # noqa: PLC0415  see run

        print_message(f"{world.name}: close the window, or press Ctrl-C, to end")
        watch(world)
    else:
        names = ", ".join(name for name in variables if name not in ("log", "step", "btr"))
        clock = f"{world.sim_step / STEPS_PER_SECOND:.3f} s simulated"
        banner = f"{world.name}, {clock}. Variables: {names}, log, step, btr."
        shell(variables, visible(banner))
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
