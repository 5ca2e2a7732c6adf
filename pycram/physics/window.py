"""PyBullet's window. If the window can't open, PyBullet ends the process, so the display is checked first."""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

from pycram.foundation.failures import DisplayError
from pycram.physics.engine import Engine

_POLL_PERIOD: Final = 1 / 30  # s


@contextmanager
def checked_display(open_windows: Sequence[str]) -> Iterator[None]:
    """Check that a window can open. The display stays open during the ``with`` block, for the window.

    Many display servers reset when their last client disconnects; they reject new clients during a reset.
    ``open_windows`` has the names of worlds with a window.

    Raises:
        DisplayError: There is no display, the display doesn't answer, or another world has PyBullet's only window.
    """
    if open_windows:
        raise DisplayError(f"PyBullet has only one window, and {open_windows[0]} uses it; end that world first")
    if sys.platform in ("darwin", "win32"):
        yield
        return
    display = os.environ.get("DISPLAY", "")
    if not display:
        raise DisplayError("DISPLAY is not set")
    problem = f"no X server answers at DISPLAY={display}"
    try:
        x11 = ctypes.CDLL("libX11.so.6")  # the library that PyBullet uses
    except OSError as error:
        raise DisplayError(f"{problem} ({error})") from error
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    opened = x11.XOpenDisplay(display.encode())
    if not opened:
        raise DisplayError(problem)
    try:
        yield
    finally:
        x11.XCloseDisplay(opened)


def watch(engine: Engine) -> None:
    """Keep a window open until a user closes it."""
    while engine.connected:
        engine.pump()
        time.sleep(_POLL_PERIOD)  # the engine reports no event when a user closes a window


def outlives_script(engine: Engine, world: str) -> None:
    """Keep a world's window open when the script ends (thesis 4.2.2), if a user at a terminal can close it."""
    atexit.register(_at_end, weakref.ref(engine), world, os.getpid())


def _at_end(reference: weakref.ref[Engine], world: str, process: int) -> None:
    engine = reference()
    if engine is None or not engine.connected or os.getpid() != process:  # a forked process has no window
        return
    if os.environ.get("CI") or sys.stdin is None or sys.stdin.closed or not sys.stdin.isatty():
        return  # nobody is there who could close the window
    print(f"pycram: the window of {world} stays open until you close it or press Ctrl-C", file=sys.stderr)
    with suppress(KeyboardInterrupt):
        watch(engine)
