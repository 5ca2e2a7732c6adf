"""Redirection of file descriptors, because native code bypasses ``sys.stdout`` and ``sys.stderr``."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress


@contextmanager
def redirected(*descriptors: int, to: int) -> Iterator[None]:
    """Redirect file descriptors of the whole process during the ``with`` block."""
    sys.stdout.flush()
    sys.stderr.flush()
    with ExitStack() as restoring:
        for descriptor in descriptors:
            copy = os.dup(descriptor)
            restoring.callback(os.close, copy)
            restoring.callback(os.dup2, copy, descriptor)
        with suppress(TypeError):  # Windows needs the name of its C library
            restoring.callback(ctypes.CDLL(None).fflush, None)  # the C library buffers its output to a pipe or a file
        for descriptor in descriptors:
            os.dup2(to, descriptor)
        yield


@contextmanager
def silenced(*descriptors: int) -> Iterator[None]:
    """Drop output of native code, such as greetings, during the ``with`` block."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        with redirected(*descriptors, to=nowhere):
            yield
    finally:
        os.close(nowhere)
