"""Room on the call stack: what has to be recorded whole isn't begun where a RecursionError would break it off."""

from __future__ import annotations

import sys
from typing import Final

#: Frames that recording takes at most, down to the file's compression.
FOR_RECORD: Final = 40
#: Frames that a task takes for its records, its block and its end.
FOR_TASK: Final = 120

_COUNTED: Final = 4  # what a frame may count in Python's limit, with the functions in C that called it
_outside = 0  # most frames below the first one of a greenlet so far; Python counts them for the greenlet too


def require(frames: int) -> None:
    """Raise RecursionError unless there is room for that many frames.

    Where the stack is shallow, as it mostly is, it takes as long as 6 calls; elsewhere as long as calls that deep.
    """
    shallow = (sys.getrecursionlimit() - frames) // _COUNTED - _outside
    if shallow > 0:
        try:
            sys._getframe(shallow)  # noqa: SLF001  inspect.stack() reads source files
        except ValueError:  # there are fewer
            return
    try:
        _call(frames)
    except RecursionError as error:
        raise RecursionError(*error.args) from None  # without the frames that were tried


def greenlets_begin() -> None:
    """Take note that greenlets begin here: Python counts the frames below for them, too, but doesn't show them."""
    global _outside  # noqa: PLW0603  too many frames do no harm: other threads look closer then
    below, frame = 0, sys._getframe()  # noqa: SLF001  as above
    while frame.f_back is not None:
        below, frame = below + 1, frame.f_back
    _outside = max(_outside, below)


def _call(frames: int) -> None:
    if frames:
        _call(frames - 1)
