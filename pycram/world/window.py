"""A world's window after the script: it stays until it is closed by hand (thesis 4.2.2), if anybody can do so."""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
import time
import weakref
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

_POLL_PERIOD: Final = 1 / 30  # s


def watch(world: BulletWorld) -> None:
    """Keep a world's window open until it is closed by hand, or by Ctrl-C."""
    while world.engine.connected:
        world.engine.pump()
        time.sleep(_POLL_PERIOD)


def outlives_script(world: BulletWorld) -> None:
    """Have a world's window stay when the script ends, if it was started at a terminal and the world is open then."""
    atexit.register(_at_end, weakref.ref(world), os.getpid())


def _at_end(reference: weakref.ref[BulletWorld], process: int) -> None:
    world = reference()
    if world is None or world.closed or os.getpid() != process:  # a fork has no window
        return
    if os.environ.get("CI") or sys.stdin is None or sys.stdin.closed or not sys.stdin.isatty():
        return  # nobody would close it
    print(f"pycram: {world.name}'s window stays until it is closed, or Ctrl-C", file=sys.stderr)
    with contextlib.suppress(KeyboardInterrupt):
        watch(world)
