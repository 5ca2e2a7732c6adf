"""A web page that shows the viewer in browsers of this machine.

It works without a network, and where there is one it contacts nobody there. The viewer's library serves the page, but
as one that gets a font and examples from elsewhere and reports its use. So browsers get it from a server here: without
these links, and with a policy that forbids other connections.
"""

from __future__ import annotations

import re
import shutil
import threading
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

import rerun as rr

from recorder.viewer.address import HOST, ViewerGone, address, free_port

if TYPE_CHECKING:
    from collections.abc import Callable

_PAGE_PORT: Final = 9090  # of pages, and where these get their records from: not what would be taken for a viewer
_RECORDS_PORT: Final = 9877
_MAX_TRIES: Final = 5  # for a free port
_START_TIMEOUT: Final = 5.0  # s for a server
_FOREIGN_LINK: Final = re.compile(rb'<link[^>]*href="https?://[^>]*>')
_HEADERS: Final = ("Content-Type", "Content-Length", "rerun-final-length")  # that are passed on
_POLICY: Final = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob: {records}"
)


def serve_page(stream: rr.RecordingStream) -> str:
    """Serves what a stream gets, and the viewer as a page; returns the page's address.

    All servers live in this process. Pages that are opened late get everything from the beginning.

    Raises:
        ViewerGone: nothing can be served.
    """
    records = _on_free_port(_RECORDS_PORT, lambda port: _serve_records(stream, port))
    source = _on_free_port(0, lambda port: rr.serve_web_viewer(web_port=port, open_browser=False))
    page = _on_free_port(_PAGE_PORT, lambda port: Page(port, source, records))
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
