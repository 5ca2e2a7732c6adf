"""Room on the call stack: what has to be recorded whole isn't begun where a RecursionError would break it off."""

from __future__ import annotations

from typing import Final

#: Frames that recording takes at most, down to the file's compression.
FOR_RECORD: Final = 40
#: Frames that a task takes for its records, its block and its end.
FOR_TASK: Final = 120


def require(frames: int) -> None:
    """Raise RecursionError unless there is room for that many frames; takes about 20 ns for each."""
    if frames:
        require(frames - 1)
