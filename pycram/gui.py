"""PyBullet's window: whether one can open, before PyBullet tries (it would end the whole process).

The window has its own native thread inside PyBullet, which ends with its client; no thread of ours keeps it.
"""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from pycram.failures import DisplayError

if TYPE_CHECKING:
    from collections.abc import Sequence

_X_SOCKETS = Path("/tmp/.X11-unix")  # noqa: S108  where every X server listens
_TIMEOUT = 2.0  # s


def check_display(open_windows: Sequence[str]) -> None:
    """Makes sure that a window can open.

    Args:
        open_windows: names of the worlds that have one already.

    Raises:
        DisplayError: there is no display, it doesn't answer, or PyBullet's one window is taken.
    """
    if open_windows:
        raise DisplayError(f"PyBullet has one window, and {open_windows[0]} has it; end that world first")
    if sys.platform in ("darwin", "win32"):
        return
    display = os.environ.get("DISPLAY", "")
    if not display:
        raise DisplayError("DISPLAY is not set")
    host, _, number = display.rpartition(":")
    screen = number.partition(".")[0]
    if not screen.isdigit():
        raise DisplayError(f"DISPLAY={display} names no display")
    try:
        if host in ("", "unix"):
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
                connection.settimeout(_TIMEOUT)
                try:
                    connection.connect(str(_X_SOCKETS / f"X{screen}"))
                except OSError:
                    connection.connect(f"\0{_X_SOCKETS / f'X{screen}'}")  # the abstract socket of the same name
        else:
            socket.create_connection((host, 6000 + int(screen)), timeout=_TIMEOUT).close()
    except OSError as error:
        raise DisplayError(f"no X server answers at DISPLAY={display} ({error.strerror})") from error
