"""Serves a page and the records that it shows to browsers of one user of this machine.

It listens on the loopback only, which other machines don't reach; but other users of this one do, and so does every
page that one of its browsers shows. So each request has to

- name this server as its ``Host``: a name of somebody else's that was made to lead here (DNS rebinding) is refused;
- hold the token that only the address of the page has;
- come from the page itself, where a browser says from where (``Origin``); no other page may read the answer.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Final, Protocol
from urllib.parse import urlsplit

from recorder.viewer.address import HOST

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

RECORDS: Final = "records.rrd"
INDEX: Final = "index.html"
_REQUEST_TIMEOUT: Final = 10.0  # s for a client to say what it wants
_TYPES: Final = {
    "html": "text/html",
    "js": "text/javascript",
    "wasm": "application/wasm",
    "ico": "image/x-icon",
}
_HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
        "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob:; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the token is part of the address
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class Records(Protocol):
    """The records that a page shows, as they come."""

    def pieces(self) -> Iterable[bytes]:
        """All from the beginning, and then what comes; waits for it."""


class PageServer(ThreadingHTTPServer):
    """Serves the page from threads of its own until it is closed, or this process ends.

    Args:
        port: where; 0 for one that is free.
        files: gives the content of each file of the page, when one is asked for.
        records: what the page shows, at ``RECORDS`` beside the files.

    Attributes:
        host: its own name and port, as browsers give it.
        token: what requests have to hold.

    Raises:
        OSError: the port isn't free.
    """

    daemon_threads = True
    allow_reuse_address = False  # a port that somebody has isn't free

    def __init__(self, port: int, files: Callable[[], dict[str, bytes]], records: Records) -> None:
        super().__init__((HOST, port), _Request)
        self.files, self.records = files, records
        self.host = f"{HOST}:{self.server_port}"
        self.token = secrets.token_urlsafe(16)
        threading.Thread(target=self.serve_forever, name="page", daemon=True).start()

    @property
    def address(self) -> str:
        """Of the folder that the page is in; whoever has it, may read."""
        return f"http://{self.host}/{self.token}/"

    def server_bind(self) -> None:
        """Binds, without looking up this machine's name on the network."""
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    def handle_error(self, request: object, client_address: object) -> None:
        """Says nothing: standard error is the plan's, and clients may send what they like."""


class _Request(BaseHTTPRequestHandler):
    server: PageServer
    timeout = _REQUEST_TIMEOUT

    def do_GET(self) -> None:
        """Sends a file, or the records."""
        if self.headers.get_all("Host") != [self.server.host]:
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST)
            return
        if self.headers.get("Origin", f"http://{self.server.host}") != f"http://{self.server.host}":
            self._refuse(HTTPStatus.FORBIDDEN)
            return
        token, _, name = urlsplit(self.path).path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode("latin-1", "replace"), self.server.token.encode()):
            self._refuse(HTTPStatus.FORBIDDEN)
            return
        self.connection.settimeout(None)  # a browser in the background takes its time
        with contextlib.suppress(ConnectionError):  # it went away
            self._send(name or INDEX)

    def _send(self, name: str) -> None:
        if name == RECORDS:
            self._begin("application/octet-stream", None)
            for piece in self.server.records.pieces():
                self.wfile.write(piece)
            return
        content = self.server.files().get(name)
        if content is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self._begin(_TYPES[name.rpartition(".")[2]], len(content))
        self.wfile.write(content)

    def _begin(self, media_type: str, size: int | None) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", media_type)
        if size is not None:  # else the end of the connection is that of the content
            self.send_header("Content-Length", str(size))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def _refuse(self, status: HTTPStatus) -> None:
        """Answers without a content; it says nothing about what is here."""
        self.close_connection = True
        with contextlib.suppress(OSError):
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  the library's name
        """Logs nothing: standard error is the plan's."""
