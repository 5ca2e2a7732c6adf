"""The outlet: while a world lives, what native code prints goes to stderr; stdout belongs to results."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_STDOUT, _STDERR = 1, 2


@contextmanager
def results_only() -> Iterator[None]:
    """Turns the file descriptor of stdout to stderr; Python's own ``sys.stdout`` goes on to where it went."""
    python = sys.stdout
    python.flush()
    kept = os.dup(_STDOUT)
    with ExitStack() as undoing:
        undoing.callback(os.close, kept)
        undoing.callback(os.dup2, kept, _STDOUT)
        if _is_descriptor(python):
            outlet = os.fdopen(os.dup(kept), "w", encoding=python.encoding, errors=python.errors, buffering=1)
            undoing.callback(outlet.close)
            undoing.callback(setattr, sys, "stdout", python)
            sys.stdout = outlet
        undoing.callback(ctypes.CDLL(None).fflush, None)  # C buffers what goes to a pipe or a file
        os.dup2(_STDERR, _STDOUT)
        yield


def _is_descriptor(stream: object) -> bool:
    """Whether Python's stdout is the descriptor; tests and notebooks put others in its place."""
    try:
        return stream.fileno() == _STDOUT  # type: ignore[attr-defined, no-any-return]
    except (AttributeError, OSError, ValueError):
        return False
