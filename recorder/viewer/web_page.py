"""A web page that shows the viewer in browsers of this machine, to the user who has its address.

Other users and pages of other servers must not get records. Each request must therefore contain the secret token of the
address, name this server as its ``Host`` (against DNS rebinding), and have no other ``Origin`` than the page. The files
of the page come from the viewer's program, which serves them to everybody, and so runs only until they are read.
"""

from __future__ import annotations

import contextlib
import html
import os
import re
import secrets
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from http import HTTPStatus
from http.client import HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Final
from urllib.parse import quote, urlsplit
from urllib.request import ProxyHandler, build_opener

import rerun as rr
import rerun_cli

from recorder.viewer.connection import HOST, ViewerGone, free_port

_PORT: Final = 9090  # preferred port of pages
_MAX_TRIES: Final = 5
_START_TIMEOUT: Final = 5.0  # timeout in s for writing the file
_PIECE: Final = 1 << 20  # maximum number of bytes in one write
_FOREIGN_LINK: Final = re.compile(rb'<link[^>]*href="https?://[^>]*>')


class WebPage:
    """A page with the viewer and a stream's rows, until this process ends; raises ViewerGone if it can't be served."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        try:
            self._records = GrowingFile(stream)
        except (OSError, RuntimeError) as error:  # the library raises RuntimeError for every error
            raise ViewerGone(f"the page can't be served: {error}") from error
        for _ in range(_MAX_TRIES):
            try:
                server = PageServer(free_port(_PORT), cache(read_viewer_files), self._records.pieces)
                break
            except OSError:  # another program has taken the port in the meantime
                continue
        else:
            raise ViewerGone("the page can't be served: no port is free")
        #: The address of the page. The address contains a secret token; don't share it.
        self.address = f"{server.address}?hide_welcome_screen&url={quote(server.address + RECORDS, safe='')}"

    def flush(self) -> None:
        """Send the stream's new rows to the pages."""
        self._stream.flush()
        self._records.notify()


@contextlib.contextmanager
def private_link(address: str) -> Iterator[str]:
    """Yield the address of a private file that redirects browsers to a page. The file exists during the ``with`` block.

    Other users can see the arguments of a browser's process, but can't read this file.
    """
    with tempfile.NamedTemporaryFile("w", prefix="pycram-page-", suffix=".html") as file:
        file.write(f'<!doctype html><meta http-equiv="refresh" content="0;url={html.escape(address)}">')
        file.flush()
        yield Path(file.name).as_uri()


class GrowingFile:
    """The records of a stream, in a file without a name."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._grown = threading.Condition()
        with tempfile.TemporaryDirectory(prefix="pycram-page-") as folder:
            file = Path(folder) / RECORDS
            stream.set_sinks(rr.FileSink(file))
            stream.flush(timeout_sec=_START_TIMEOUT)
            self._file = file.open("rb", buffering=0)

    def notify(self) -> None:
        """Tell readers that the file may have grown."""
        with self._grown:
            self._grown.notify_all()

    def pieces(self) -> Iterator[bytes]:
        """Yield the content from the beginning, then all content that is added; never end."""
        at = 0
        while True:
            with self._grown:
                self._grown.wait_for(lambda at=at: os.fstat(self._file.fileno()).st_size > at)  # type: ignore[misc]
            piece = os.pread(self._file.fileno(), _PIECE, at)
            at += len(piece)
            yield piece


RECORDS: Final = "records.rrd"
INDEX: Final = "index.html"
_REQUEST_TIMEOUT: Final = 10.0  # timeout in s for a client to send its request
_TYPES: Final = {"html": "text/html", "js": "text/javascript", "wasm": "application/wasm", "ico": "image/x-icon"}
_HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
        "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob:; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # not logged, because addresses contain the token
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class PageServer(ThreadingHTTPServer):
    """A server of the page with threads of its own; raises OSError if the port is occupied. Port 0 is any free port.

    ``files`` returns the contents of the page's files. ``pieces`` yields the content of ``RECORDS`` for a browser.
    """

    daemon_threads = True
    allow_reuse_address = False  # an occupied port must be an error

    def __init__(self, port: int, files: Callable[[], dict[str, bytes]], pieces: Callable[[], Iterable[bytes]]) -> None:
        super().__init__((HOST, port), _Request)
        self.files, self.pieces = files, pieces
        self.host = f"{HOST}:{self.server_port}"  # name and port of the server, as requests name it
        self.token = secrets.token_urlsafe(16)  # the token, which each request must contain
        threading.Thread(target=self.serve_forever, name="page", daemon=True).start()

    @property
    def address(self) -> str:
        """The address of the page's folder. Everybody who has this address can read the records."""
        return f"http://{self.host}/{self.token}/"

    def server_bind(self) -> None:
        """Bind without looking up the name of this machine on the network."""
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing, because standard error belongs to the plan."""


class _Request(BaseHTTPRequestHandler):
    server: PageServer
    timeout = _REQUEST_TIMEOUT

    def do_GET(self) -> None:
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
        self.connection.settimeout(None)  # a browser in the background reads slowly
        with contextlib.suppress(ConnectionError):  # the browser has closed the connection
            self._send(name or INDEX)

    def _send(self, name: str) -> None:
        if name == RECORDS:
            self._begin("application/octet-stream", None)
            for piece in self.server.pieces():
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
        if size is not None:  # as there is no size, the content ends with the connection
            self.send_header("Content-Length", str(size))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def _refuse(self, status: HTTPStatus) -> None:
        """Send an answer without content, so that strangers get no information."""
        self.close_connection = True
        with contextlib.suppress(OSError):
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  the library's name
        """Log nothing, because standard error belongs to the plan."""


NAMES: Final = (INDEX, "re_viewer.js", "re_viewer_bg.wasm", "favicon.ico")
_PROGRAM: Final = Path(rerun_cli.__file__).with_name("rerun")
_TIMEOUT: Final = 20.0  # timeout in s for an answer of the program
_ADDRESS: Final = re.compile(rb"web-viewer at http://127\.0\.0\.1:(\d+)")
# With an address of records, the program only serves the page. CI=1 turns the program's usage statistics off.
_OPTIONS: Final = ("--serve-web", "--bind", HOST, "--web-viewer-port", "0", f"rerun+http://{HOST}:1/proxy")
_ENVIRONMENT: Final = {"CI": "1", "NO_COLOR": "1", "RUST_LOG": "re_sdk=info"}
_END_WITH_PARENT: Final = """
import ctypes, os, signal, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
os.execv(sys.argv[1], sys.argv[1:])
"""


def read_viewer_files() -> dict[str, bytes]:
    """Return the content of the files ``NAMES``. Raise ViewerGone if the viewer's program doesn't serve the files."""
    files: dict[str, bytes] = {}
    with subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", _END_WITH_PARENT, str(_PROGRAM), *_OPTIONS],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ | _ENVIRONMENT,
    ) as process:
        overdue = threading.Timer(_TIMEOUT, process.kill)
        overdue.daemon = True
        overdue.start()
        try:
            port = _port(process)
            opener = build_opener(ProxyHandler({}))
            for name in NAMES:
                with opener.open(f"http://{HOST}:{port}/{'' if name == INDEX else name}", timeout=_TIMEOUT) as reply:
                    files[name] = reply.read()
        except (OSError, HTTPException) as error:
            raise ViewerGone(f"the viewer's page can't be read ({error})") from error
        finally:
            overdue.cancel()
            process.kill()
    files[INDEX] = _FOREIGN_LINK.sub(b"", files[INDEX])
    return files


def _port(process: subprocess.Popen[bytes]) -> int:
    """Return the port that the program has printed. A port that was free before may now belong to another server."""
    said = b""
    for line in process.stderr or ():
        said = line
        if address := _ADDRESS.search(line):
            return int(address[1])
    raise OSError(said.decode(errors="replace").strip() or "the program didn't start")
