"""Windows and pages in which viewers show what they are sent."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import quote

import rerun as rr

from recorder.viewer.connection import HOST, PAGE_PORT, PORT, RECORDS_PORT, ViewerGone, address, answers, free_port
from recorder.viewer.web_page import Page

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

APPLICATION: Final = "pycram"  # viewers remember a layout for each application
_LOOK_AGAIN: Final = 0.2  # s between two looks for a viewer
_TRIES: Final = 5
_PATIENCE: Final = 5.0  # s for a server to begin
WRITING: Final = 60.0  # s for rows to be written into a file
_SWITCH: Final = "RERUN"  # the variable that silences programs which log to viewers


@contextlib.contextmanager
def stream_to_viewer(*, part: bool = False) -> Iterator[rr.RecordingStream]:
    """What rows are sent by; also where the environment has viewers switched off, as this one was asked for.

    Args:
        part: whether it says nothing of itself, as of a part of what goes another way.
    """
    switched = os.environ.pop(_SWITCH, None)
    try:
        yield rr.RecordingStream(APPLICATION, send_properties=not part)
    finally:
        if switched is not None:
            os.environ[_SWITCH] = switched


@contextlib.contextmanager
def stream_to_file(file: Path, *, part: bool = False) -> Iterator[rr.RecordingStream]:
    """What rows are sent by into a file; at the end of its block all are there.

    Args:
        file: where they go; replaced.
        part: see :func:`stream_to_viewer`.

    Raises:
        OSError: they can't be written.
    """
    with stream_to_viewer(part=part) as stream:
        stream.save(file)
        yield stream
        try:
            stream.flush(timeout_sec=WRITING)
        except RuntimeError as error:  # the library has one type for all, and has said why
            raise OSError(str(error)) from error
        stream.disconnect()


def serve_page(stream: rr.RecordingStream) -> str:
    """Serves what a stream gets, and the viewer as a page to see it with; needs no network.

    All servers live in this process. Pages that are opened late get everything from the beginning.

    Args:
        stream: where rows are sent to.

    Returns:
        The address of the page.

    Raises:
        ViewerGone: nothing can be served.
    """
    records = _on_free_port(RECORDS_PORT, lambda port: _serve_records(stream, port))
    source = _on_free_port(0, lambda port: rr.serve_web_viewer(web_port=port, open_browser=False))
    page = _on_free_port(PAGE_PORT, lambda port: Page(port, source, records))
    return f"http://{HOST}:{page}/?hide_welcome_screen&url={quote(address(records), safe='')}"


def _serve_records(stream: rr.RecordingStream, port: int) -> None:
    stream.set_sinks(rr.GrpcServerSink(bind_ip=HOST, port=port))
    stream.flush(timeout_sec=_PATIENCE)  # only now it says whether it has the port


def _on_free_port(wanted: int, serve: Callable[[int], object]) -> int:
    """Serves on the wanted port, or on another where somebody was quicker."""
    for _ in range(_TRIES):
        port = free_port(wanted)
        try:
            serve(port)
        except (OSError, RuntimeError):  # the latter is the library's type for all that can be
            continue
        return port
    raise ViewerGone("the page can't be served: no port is free")


def open_window() -> str:
    """Starts a viewer that outlives this process, and waits until it is there; one that is open already is taken.

    Returns:
        Its address.

    Raises:
        ViewerGone: it ended at once, for example because there is no screen.
    """
    if answers(address(PORT)):
        return address(PORT)
    port = free_port(PORT)
    with tempfile.TemporaryFile() as said:
        viewer = subprocess.Popen(  # noqa: S603  the viewer that came with the library
            [sys.executable, "-m", "rerun_cli", "--port", str(port), "--bind", HOST, "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,  # Ctrl-C is for the plan
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )
        pause = threading.Event()
        while not answers(address(port)):
            if viewer.poll() is not None:
                raise ViewerGone(f"the viewer didn't open ({_last_line(said)})")
            pause.wait(_LOOK_AGAIN)
    return address(port)


def _last_line(said: IO[bytes]) -> str:
    said.seek(0)
    lines = said.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it didn't say why")
