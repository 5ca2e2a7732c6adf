"""Signals that arrive before a chosen line of chosen modules: what survives one at each line survives one at any moment."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import FrameType

# The tracer stands on the stack between the line and the handler of Ctrl-C, which asks whose code it has interrupted.
__name__ = "pycram.signal_at_line"
REPO = Path(__file__).parent.parent


def modules(*paths: str) -> frozenset[str]:
    """Return the files of modules, and of the modules in folders.

    Args:
        paths: in the repository.

    Raises:
        FileNotFoundError: There is no module at one of them.
    """
    found: set[str] = set()
    for path in paths:
        files = [REPO / path] if path.endswith(".py") else list((REPO / path).rglob("*.py"))
        if not files or not all(file.is_file() for file in files):
            raise FileNotFoundError(f"no module at {path}: it has moved, and its lines would not be tried")
        found.update(map(str, files))
    return frozenset(found)


def reached(line: int, number: int, action: Callable[[], None], traced: Iterable[str]) -> bool:
    """Run an action, and raise a signal before a line is run; return whether it came that far.

    Args:
        line: which, counted from 1 as they are run.
        number: the signal.
        action: what is run.
        traced: the files whose lines count.
    """
    left = line
    files = frozenset(traced)

    def trace(frame: FrameType, event: str, _: object) -> object:
        nonlocal left
        if frame.f_code.co_filename not in files:
            return None
        if event == "line":
            left -= 1
            if left == 0:
                signal.raise_signal(number)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        action()
    finally:
        sys.settrace(before)
    return left <= 0
