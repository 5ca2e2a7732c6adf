"""Rerun streams that rows are sent to: to a viewer, or into an ``.rrd`` file."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder.tracing.interrupts import Uninterrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

APPLICATION: Final = "pycram"  # viewers remember a layout for each application
_WRITE_TIMEOUT: Final = 60.0  # s for rows to get into a file
_SWITCH: Final = "RERUN"  # the variable that silences programs which log to viewers


@contextlib.contextmanager
def stream_to_viewer(connect: Callable[[rr.RecordingStream], None] | None = None) -> Iterator[rr.RecordingStream]:
    """A stream for rows; also where the environment has viewers switched off, as this one was asked for.

    Args:
        connect: Gives the stream its sink, before a Ctrl-C is raised.
    """
    switched = os.environ.pop(_SWITCH, None)
    try:
        with Uninterrupted():  # one that Ctrl-C leaves half made or without a sink makes the library complain on stderr
            stream = rr.RecordingStream(APPLICATION)
            if connect is not None:
                connect(stream)
        yield stream
    finally:
        if switched is not None:
            os.environ[_SWITCH] = switched


@contextlib.contextmanager
def stream_to_file(file: Path) -> Iterator[rr.RecordingStream]:
    """A stream for rows into a file, which is replaced and is complete at the end of the block.

    Raises:
        OSError: they can't be written.
    """
    with stream_to_viewer(lambda stream: stream.save(file)) as stream:
        yield stream
        try:
            stream.flush(timeout_sec=_WRITE_TIMEOUT)
        except RuntimeError as error:  # the library has one type for all, and a message with the cause
            raise OSError(str(error)) from error
        stream.disconnect()
