"""Quiet: native code prints what nobody asked for, past Python, to the file descriptors of stdout and stderr."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def quiet(*descriptors: int) -> Iterator[None]:
    """Drops what native code prints (greetings, progress): stdout belongs to results, stderr to people.

    Args:
        descriptors: the file descriptors that lead nowhere meanwhile, for the whole process.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [(number, os.dup(number)) for number in descriptors]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in descriptors:
            os.dup2(nowhere, number)
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # C buffers what goes to a pipe or a file
        for number, copy in kept:
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)
