"""``restore``: a live world at a step, for a script, in a shell, or in a window."""

from __future__ import annotations

import argparse
import code
import contextlib
import keyword
import re
import runpy
import sys
import traceback
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from recorder.records import STEPS_PER_SECOND
from replay.cli.console import native_output_to_stderr, print_json, print_message, print_moment, visible
from replay.cli.main import FAILED, FINE
from replay.errors import ReplayError
from replay.file.record_reader import RecordReader
from replay.history.steps import HINT
from replay.recording import Recording

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("step", metavar="STEP", help=HINT)
    doing = parser.add_mutually_exclusive_group()
    doing.add_argument("--script", metavar="FILE", help="run a Python file, with variables for world and objects")
    doing.add_argument("--shell", action="store_true", help="open interactive Python (default)")
    parser.add_argument(
        "--gui",
        action="store_true",
        help="show PyBullet's window; without --script and --shell, wait until the user closes it",
    )
    parser.add_argument(
        "--exact",
        action="store_true",
        help="repeat every change exactly, so that later changes have the same effects as in the original",
    )
    parser.add_argument("--world", metavar="NAME", help="world to restore (default: the last opened world)")
    parser.add_argument("--log", dest="target", metavar="FILE", help="record the session into this file")


def run(log: Recording, options: argparse.Namespace) -> int:
    from pycram.foundation.failures import DisplayError  # noqa: PLC0415  imports the engine
    from recorder import RecordingError, record  # noqa: PLC0415

    script = None if options.script is None else Path(options.script)
    if script is not None and not script.is_file():
        raise ReplayError(f"{script}: no such file")
    target = None if options.target is None else Path(options.target)
    if target is not None and target.exists() and target.samefile(log.path):
        raise ReplayError(f"{target} is the recording itself; name another file")
    step = log.step(options.step)
    try:
        with native_output_to_stderr():
            mode: Literal["GUI", "DIRECT"] = "GUI" if options.gui else "DIRECT"
            world = log.world_at(options.step, options.world, exact=options.exact, mode=mode)
    except DisplayError as error:
        raise ReplayError(str(error)) from error
    print_moment(log, options.step, exact=options.exact)
    try:
        with world, record(target, source=script) if target is not None else nullcontext():
            variables = variables_of(world, log, step)
            if script is not None:
                with native_output_to_stderr():
                    return run_script(script, variables)
            if options.json:
                print_json(_data(step, world, exact=options.exact))
            elif options.gui and not options.shell:
                from pycram.physics.window import watch  # noqa: PLC0415  see run

                print_message(f"{world.name}: to end, close the window or press Ctrl-C")
                watch(world.engine)
            else:
                names = ", ".join(name for name in variables if name not in ("log", "step", "btr"))
                clock = f"{world.sim_step / STEPS_PER_SECOND:.3f} s simulated"
                shell(variables, visible(f"{world.name}, {clock}. Variables: {names}, log, step, btr."))
            return FINE
    except RecordingError as error:
        raise ReplayError(str(error)) from error


def _data(step: int, world: BulletWorld, *, exact: bool) -> dict[str, object]:
    objects = {}
    for body in world.objects:
        position, orientation = body.get_position_and_orientation()
        objects[body.name] = {"position": position, "orientation": orientation, "joints": body.get_joint_positions()}
    return {"step": step, "world": world.name, "exact": exact, "objects": objects}


def variables_of(world: BulletWorld, log: RecordReader, step: int) -> dict[str, object]:
    """Return the variables of a session: ``world``, ``robot``, ``objects``, ``log``, ``step``, ``btr`` (queries).

    Each object is also a variable. In the variable's name, underscores replace characters that identifiers can't
    contain.
    """
    from pycram import bullet_world_reasoning as btr  # noqa: PLC0415  imports the engine

    objects = {body.name: body for body in world.objects}
    variables: dict[str, object] = {}
    for name, body in objects.items():
        identifier = re.sub(r"\W", "_", name)
        if identifier.isidentifier() and not keyword.iskeyword(identifier):
            variables.setdefault(identifier, body)
    return variables | {"world": world, "robot": world.robot, "objects": objects, "log": log, "step": step, "btr": btr}


def run_script(script: Path, variables: Mapping[str, object]) -> int:
    """Run a Python file as a program with variables. Return the program's exit code, or 1 after an exception."""
    before = sys.argv, list(sys.path)
    sys.argv = [str(script)]
    sys.path.insert(0, str(script.parent.resolve()))
    try:
        runpy.run_path(str(script), init_globals=dict(variables), run_name="__main__")
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
        return end.code if isinstance(end.code, int) else FAILED if end.code else FINE
    except Exception:  # noqa: BLE001  the script may raise any exception
        traceback.print_exc()
        return FAILED
    finally:
        sys.argv, sys.path[:] = before
    return FINE


def shell(variables: Mapping[str, object], banner: str) -> None:
    """Run an interactive Python shell until the end of the input, and print the banner on stderr."""
    local = dict(variables)
    if not sys.stdin.isatty():
        code.interact(banner, lambda _: input(), local, exitmsg="")  # on stdout, prompts would mix with the results
        return
    with contextlib.suppress(ImportError):  # readline is imported so that lines can be edited
        import readline  # noqa: PLC0415
        import rlcompleter  # noqa: PLC0415

        readline.set_completer(rlcompleter.Completer(local).complete)
        readline.parse_and_bind("tab: complete")
    code.interact(banner, local=local, exitmsg="")
