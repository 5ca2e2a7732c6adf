"""PyBullet's window: checks whether one can open before PyBullet tries, which would end the whole process.

And where in the world its pixels are.
"""

from __future__ import annotations

import ctypes
import os
import socket
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pycram.foundation.failures import DisplayError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

_CONNECT_TIMEOUT: Final = 2.0  # s
_FAR: Final = 1e4  # m, where PyBullet's vectors of the picture reach


@contextmanager
def checked_display(open_windows: Sequence[str]) -> Iterator[None]:
    """Check that a window can open, which is to be done in the ``with`` block.

    The display stays open in the block: many servers reset when their last client leaves, and refuse others meanwhile.

    Args:
        open_windows: Names of the worlds that have one already.

    Raises:
        DisplayError: There is no display, it doesn't answer, or PyBullet's one window is taken.
    """
    if open_windows:
        raise DisplayError(f"PyBullet has one window, and {open_windows[0]} has it; end that world first")
    if sys.platform in ("darwin", "win32"):
        yield
        return
    display = os.environ.get("DISPLAY", "")
    if not display:
        raise DisplayError("DISPLAY is not set")
    host, _, number = display.rpartition(":")
    screen = number.partition(".")[0]
    if not screen.isdigit():
        raise DisplayError(f"DISPLAY={display} is not a display's address")
    with _opened(display) if host in ("", "unix") else _connected(host, 6000 + int(screen)) as problem:
        if problem is not None:
            raise DisplayError(f"no X server answers at DISPLAY={display}{problem}")
        yield


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


@contextmanager
def _opened(display: str) -> Iterator[str | None]:
    """Open a display of this machine with the library that PyBullet uses; yield None, or why it doesn't answer."""
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError as error:
        yield f" ({error})"
        return
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    opened = x11.XOpenDisplay(display.encode())
    try:
        yield None if opened else ""
    finally:
        if opened:
            x11.XCloseDisplay(opened)


@contextmanager
def _connected(host: str, port: int) -> Iterator[str | None]:
    """Connect to another machine's display; the library would wait for ever for one that doesn't answer."""
    try:
        connection = socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT)
    except OSError as error:
        yield f" ({error.strerror})"
        return
    with connection:
        yield None
