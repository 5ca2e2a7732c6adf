"""Scripts, shells and windows in a restored world."""

from __future__ import annotations

import code
import contextlib
import keyword
import re
import runpy
import sys
import traceback
from typing import TYPE_CHECKING

from pycram import bullet_world_reasoning as btr

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pycram.world.world import BulletWorld
    from replay.file.record_reader import RecordReader

_DONE, _FAILED = 0, 1


def variables_of(world: BulletWorld, log: RecordReader, step: int) -> dict[str, object]:
    """Return the variables of a session: objects by their names, with underscores for what can't be in an identifier.

    Beside them ``world``, ``robot``, ``objects`` (by name), ``log``, ``step`` and ``btr`` (the reasoning queries).
    """
    objects = {body.name: body for body in world.objects}
    variables: dict[str, object] = {}
    for name, body in objects.items():
        identifier = re.sub(r"\W", "_", name)
        if identifier.isidentifier() and not keyword.iskeyword(identifier):
            variables.setdefault(identifier, body)
    return variables | {"world": world, "robot": world.robot, "objects": objects, "log": log, "step": step, "btr": btr}


def run_script(script: Path, variables: Mapping[str, object]) -> int:
    """Run a Python file as a program, with variables given; return its exit code, or 1 if it raised."""
    before = sys.argv, list(sys.path)
    sys.argv = [str(script)]
    sys.path.insert(0, str(script.parent.resolve()))
    try:
        runpy.run_path(str(script), init_globals=dict(variables), run_name="__main__")
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
        return end.code if isinstance(end.code, int) else _FAILED if end.code else _DONE
    except Exception:  # noqa: BLE001  whatever the script raises is the user's to see
        traceback.print_exc()
        return _FAILED
    finally:
        sys.argv, sys.path[:] = before
    return _DONE


def shell(variables: Mapping[str, object], banner: str) -> None:
    """Run an interactive Python shell until the end of the input; the banner is printed on stderr."""
    local = dict(variables)
    if sys.stdin.isatty():
        with contextlib.suppress(ImportError):  # where it isn't, lines can't be edited
            import readline  # noqa: PLC0415
            import rlcompleter  # noqa: PLC0415

            readline.set_completer(rlcompleter.Completer(local).complete)
            readline.parse_and_bind("tab: complete")
        code.interact(banner, local=local, exitmsg="")
        return
    prompts = getattr(sys, "ps1", None), getattr(sys, "ps2", None)
    sys.ps1 = sys.ps2 = ""  # invisible to the user, and they would be mixed into the results
    try:
        code.interact(banner, local=local, exitmsg="")
    finally:
        for name, prompt in zip(("ps1", "ps2"), prompts, strict=True):
            if prompt is None:
                delattr(sys, name)
            else:
                setattr(sys, name, prompt)
