"""The viewer's page, from this machine alone: it works without a network, and where there is one it asks nobody there.

The viewer's library serves the page, but as one that gets a font and examples from elsewhere and reports its use. So
browsers get it from here: without these links, and with a policy that forbids it to talk to others.
"""

from __future__ import annotations

import re
import shutil
import threading
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final

from recorder.viewer.connection import HOST

_ELSEWHERE: Final = re.compile(rb'<link[^>]*href="https?://[^>]*>')
_PASSED_ON: Final = ("Content-Type", "Content-Length", "rerun-final-length")
_POLICY: Final = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob: {records}"
)


class Page(ThreadingHTTPServer):
    """Serves the page from threads of its own while this process lives.

    Args:
        port: where; 0 for any that is free.
        source: port of the library's server.
        records: port where the page gets its records from.

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
            found = connection.getresponse()
            page = _ELSEWHERE.sub(b"", found.read()) if found.getheader("Content-Type") == "text/html" else None
            told = {name: value for name in _PASSED_ON if (value := found.getheader(name)) is not None}
            if page is not None:
                told["Content-Length"] = str(len(page))
            self.send_response(found.status)
            for name, value in (told | {"Content-Security-Policy": self.server.policy}).items():
                self.send_header(name, value)
            self.end_headers()
            if page is not None:
                self.wfile.write(page)
            else:
                shutil.copyfileobj(found, self.wfile)
        except (OSError, HTTPException):
            self.close_connection = True  # the browser went away, or asked for nonsense
        finally:
            connection.close()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  the library's name
        """Says nothing: the plan's standard error isn't the place."""
