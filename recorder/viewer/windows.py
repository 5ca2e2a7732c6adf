"""Windows and pages in which viewers show what they are sent."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from typing import IO, Final
from urllib.parse import quote

import rerun as rr

from recorder.viewers import HOST, PAGE_PORT, PORT, address, answers, free_port

APPLICATION: Final = "pycram"  # viewers remember a layout for each application
_LOOK_AGAIN: Final = 0.2  # s between two looks for a viewer


class ViewerGone(Exception):
    """The viewer has ended, or didn't begin."""


def serve_page(stream: rr.RecordingStream) -> str:
    """Serves what a stream gets, and the viewer as a page to see it with; needs no network.

    Both servers live in this process. Pages that are opened late get everything from the beginning.

    Args:
        stream: where rows are sent to.

    Returns:
        The address of the page.
    """
    port = free_port(PORT)
    stream.set_sinks(rr.GrpcServerSink(bind_ip=HOST, port=port))
    page = free_port(PAGE_PORT)
    rr.serve_web_viewer(web_port=page, open_browser=False, connect_to=address(port))
    return f"http://{HOST}:{page}/?url={quote(address(port), safe='')}"


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
