"""Where rows are sent to: a viewer's window, a file, or a web page that shows the viewer.

The page comes from this machine alone: it works without a network, and where there is one it contacts nobody there. The
viewer's library serves the page, but as one that gets a font and examples from elsewhere and reports its use. So
browsers get it from a server here: without these links, and with a policy that forbids other connections.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import quote

import rerun as rr

from recorder.tracing.interrupts import Uninterrupted
from recorder.viewer.connection import (
    HOST,
    PAGE_PORT,
    POLL_PERIOD,
    PORT,
    RECORDS_PORT,
    ViewerGone,
    address,
    answers,
    free_port,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

APPLICATION: Final = "pycram"  # viewers remember a layout for each application
_MAX_TRIES: Final = 5  # for a free port
_START_TIMEOUT: Final = 5.0  # s for a server
_WRITE_TIMEOUT: Final = 60.0  # s for rows to get into a file
_SWITCH: Final = "RERUN"  # the variable that silences programs which log to viewers
_FOREIGN_LINK: Final = re.compile(rb'<link[^>]*href="https?://[^>]*>')
_HEADERS: Final = ("Content-Type", "Content-Length", "rerun-final-length")  # that are passed on
_POLICY: Final = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob: {records}"
)


@contextlib.contextmanager
def stream_to_viewer() -> Iterator[rr.RecordingStream]:
    """A stream for rows; also where the environment has viewers switched off, as this one was asked for."""
    switched = os.environ.pop(_SWITCH, None)
    try:
        with Uninterrupted():  # one that Ctrl-C has left half made is a complaint of the library's on stderr
            stream = rr.RecordingStream(APPLICATION)
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
    with stream_to_viewer() as stream:
        stream.save(file)
        yield stream
        try:
            stream.flush(timeout_sec=_WRITE_TIMEOUT)
        except RuntimeError as error:  # the library has one type for all, and a message with the cause
            raise OSError(str(error)) from error
        stream.disconnect()


def serve_page(stream: rr.RecordingStream) -> str:
    """Serves what a stream gets, and the viewer as a page; returns the page's address.

    All servers live in this process. Pages that are opened late get everything from the beginning.

    Raises:
        ViewerGone: nothing can be served.
    """
    records = _on_free_port(RECORDS_PORT, lambda port: _serve_records(stream, port))
    source = _on_free_port(0, lambda port: rr.serve_web_viewer(web_port=port, open_browser=False))
    page = _on_free_port(PAGE_PORT, lambda port: Page(port, source, records))
    return f"http://{HOST}:{page}/?hide_welcome_screen&url={quote(address(records), safe='')}"


def _serve_records(stream: rr.RecordingStream, port: int) -> None:
    stream.set_sinks(rr.GrpcServerSink(bind_ip=HOST, port=port))
    stream.flush(timeout_sec=_START_TIMEOUT)  # which raises if it hasn't got the port


def _on_free_port(preferred: int, serve: Callable[[int], object]) -> int:
    """Serves on the wanted port, or on another one that is free."""
    for _ in range(_MAX_TRIES):
        port = free_port(preferred)
        try:
            serve(port)
        except (OSError, RuntimeError):  # the latter is the library's type for all errors
            continue
        return port
    raise ViewerGone("the page can't be served: no port is free")


class Page(ThreadingHTTPServer):
    """Serves the page from threads of its own while this process lives.

    ``source`` is the port of the library's server, ``records`` the one where the page gets its records from.

    Raises:
        OSError: the port isn't free.
    """

    daemon_threads = True
    allow_reuse_address = False  # a port that somebody has isn't free

    def __init__(self, port: int, source: int, records: int) -> None:
        self.source = source
        self.policy = _POLICY.format(records=f"http://{HOST}:{records}")
        super().__init__((HOST, port), _Request)
        threading.Thread(target=self.serve_forever, name="page", daemon=True).start()


class _Request(BaseHTTPRequestHandler):
    server: Page

    def do_GET(self) -> None:
        """Passes a file on."""
        connection = HTTPConnection(HOST, self.server.source)
        try:
            connection.request("GET", self.path)
            reply = connection.getresponse()
            headers = {name: value for name in _HEADERS if (value := reply.getheader(name)) is not None}
            page = None
            if reply.getheader("Content-Type") == "text/html":
                page = _FOREIGN_LINK.sub(b"", reply.read())
                headers["Content-Length"] = str(len(page))
            self.send_response(reply.status)
            for name, value in (headers | {"Content-Security-Policy": self.server.policy}).items():
                self.send_header(name, value)
            self.end_headers()
            if page is not None:
                self.wfile.write(page)
            else:
                shutil.copyfileobj(reply, self.wfile)
        except (OSError, HTTPException):
            self.close_connection = True  # the browser went away, or asked for nonsense
        finally:
            connection.close()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  the library's name
        """Logs nothing: standard error is the plan's."""


def open_window() -> str:
    """Starts a viewer that outlives this process, unless one is open already; returns its address once it answers.

    Raises:
        ViewerGone: it ended at once, for example because there is no screen.
    """
    if answers(address(PORT)):
        return address(PORT)
    port = free_port(PORT)
    with tempfile.TemporaryFile() as stderr:
        viewer = subprocess.Popen(  # noqa: S603  the viewer that came with the library
            [sys.executable, "-m", "rerun_cli", "--port", str(port), "--bind", HOST, "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            start_new_session=True,  # Ctrl-C is for the plan
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )
        pause = threading.Event()
        while not answers(address(port)):
            if viewer.poll() is not None:
                raise ViewerGone(f"the viewer didn't open ({_last_line(stderr)})")
            pause.wait(POLL_PERIOD)
    return address(port)


def _last_line(stderr: IO[bytes]) -> str:
    stderr.seek(0)
    lines = stderr.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it didn't say why")
