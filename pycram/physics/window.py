"""PyBullet's window: checks whether one can open before PyBullet tries, which would end the whole process.

And where in the world its pixels are.
"""

from __future__ import annotations

import ctypes
import os
import socket
import sys
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.foundation.failures import DisplayError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_CONNECT_TIMEOUT: Final = 2.0  # s
_FAR: Final = 1e4  # m, where PyBullet's vectors of the picture reach


def check_display(open_windows: Sequence[str]) -> None:
    """Check that a window can open; ``open_windows`` names the worlds that have one already.

    Raises:
        DisplayError: There is no display, it doesn't answer, or PyBullet's one window is taken.
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
        raise DisplayError(f"DISPLAY={display} is not a display's address")
    if host in ("", "unix"):
        answers, why = _answers(display)
    else:
        answers, why = _listens(host, 6000 + int(screen))
    if not answers:
        raise DisplayError(f"no X server answers at DISPLAY={display}{why}")


def pick_ray(camera: Sequence[Any], x: float, y: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both ends of the line of sight through a pixel, in the world, m.

    Args:
        camera: The window's, as PyBullet describes it: width, height, ..., forward, horizontal, vertical, ...,
            distance, target. The vectors span the picture far away.
        x: Of the pixel, from the left.
        y: From above.
    """
    width, height, *_ = camera
    forward, horizontal, vertical, target = (np.array(camera[index], float) for index in (5, 6, 7, 11))
    eye = target - camera[10] * forward
    return eye, eye + _FAR * forward + (x / width - 0.5) * horizontal + (0.5 - y / height) * vertical


def _answers(display: str) -> tuple[bool, str]:
    """Open a display of this machine with the library that PyBullet uses; return whether it answers, else why not."""
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError as error:
        return False, f" ({error})"
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    opened = x11.XOpenDisplay(display.encode())
    if opened:
        x11.XCloseDisplay(opened)
    return bool(opened), ""


def _listens(host: str, port: int) -> tuple[bool, str]:
    """Connect to another machine's display; the library would wait for ever for one that doesn't answer."""
    try:
        socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT).close()
    except OSError as error:
        return False, f" ({error.strerror})"
    return True, ""
