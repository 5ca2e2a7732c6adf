"""A session in the past: what a script or a shell finds when a world has been restored for it."""

from __future__ import annotations

import code
import contextlib
import keyword
import re
import runpy
import sys
import time
import traceback
from typing import TYPE_CHECKING, Final

from pycram import bullet_world_reasoning as btr

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pycram.world.world import BulletWorld
    from replay.file.log import Log

_FRAME: Final = 1 / 30  # s between looks whether a window is still there
_DONE, _FAILED = 0, 1


def names(world: BulletWorld, log: Log, step: int) -> dict[str, object]:
    """The names that are there: objects by theirs, and what one needs beside them.

    Args:
        world: the restored world.
        log: the recording.
        step: the step.

    Returns:
        ``world``, ``robot``, ``objects`` (all of them by name), ``log``, ``step``, ``btr`` (the reasoning queries), and
        each object under its own name, with an underscore for what can't stand in one.
    """
    objects = {body.name: body for body in world.objects}
    found: dict[str, object] = {}
    for name, body in objects.items():
        word = re.sub(r"\W", "_", name)
        if word.isidentifier() and not keyword.iskeyword(word):
            found.setdefault(word, body)
    return found | {
        "world": world,
        "robot": world.robot,
        "objects": objects,
        "log": log,
        "step": step,
        "btr": btr,
    }


def run_script(script: Path, given: Mapping[str, object]) -> int:
    """Runs a Python file as a program of its own, with names in it from the start.

    Args:
        script: the file.
        given: the names.

    Returns:
        The exit code: the script's own, or 1 if it raised.
    """
    before = sys.argv, list(sys.path)
    sys.argv = [str(script)]
    sys.path.insert(0, str(script.parent.resolve()))
    try:
        runpy.run_path(str(script), init_globals=dict(given), run_name="__main__")
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


def shell(given: Mapping[str, object], banner: str) -> None:
    """Talks Python with the user until the end of the input.

    Args:
        given: the names.
        banner: what to say first, on stderr.
    """
    local = dict(given)
    if sys.stdin.isatty():
        with contextlib.suppress(ImportError):  # where it isn't, lines can't be edited
            import readline  # noqa: PLC0415
            import rlcompleter  # noqa: PLC0415

            readline.set_completer(rlcompleter.Completer(local).complete)
            readline.parse_and_bind("tab: complete")
        code.interact(banner, local=local, exitmsg="")
        return
    prompts = getattr(sys, "ps1", None), getattr(sys, "ps2", None)
    sys.ps1 = sys.ps2 = ""  # nobody sees them, and they would stand among the results
    try:
        code.interact(banner, local=local, exitmsg="")
    finally:
        for name, prompt in zip(("ps1", "ps2"), prompts, strict=True):
            if prompt is None:
                delattr(sys, name)
            else:
                setattr(sys, name, prompt)


def watch(world: BulletWorld) -> None:
    """Keeps a window open until it is closed by hand, or by Ctrl-C.

    Args:
        world: one with a window.
    """
    while world.engine.connected:
        world.engine.pump()
        time.sleep(_FRAME)
