"""The files of the viewer's page: the viewer as WebAssembly, which its library holds in its program.

The library gives them over HTTP only. Its own server of pages listens on all addresses of the machine; that of its
program can be told to listen on the loopback alone. So the program is started, asked, and ended again.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from http.client import OK, HTTPConnection, HTTPException
from pathlib import Path
from typing import Final

import rerun_cli

from recorder.viewer.address import HOST, ViewerGone

INDEX: Final = "index.html"
NAMES: Final = (INDEX, "re_viewer.js", "re_viewer_bg.wasm", "favicon.ico")
_PROGRAM: Final = Path(rerun_cli.__file__).with_name("rerun")
_TIMEOUT: Final = 20.0  # s for the program to answer
_ADDRESS: Final = re.compile(rb"web-viewer at http://127\.0\.0\.1:(\d+)")
# Given an address of records, the program serves the page and nothing else. CI keeps it from reporting its use.
_OPTIONS: Final = ("--serve-web", "--bind", HOST, "--web-viewer-port", "0", f"rerun+http://{HOST}:1/proxy")
_ENVIRONMENT: Final = {"CI": "1", "NO_COLOR": "1", "RUST_LOG": "re_sdk=info"}
_END_WITH_PARENT: Final = """
import ctypes, os, signal, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
os.execv(sys.argv[1], sys.argv[1:])
"""


def read_viewer_files() -> dict[str, bytes]:
    """Returns the content of each of ``NAMES``.

    Raises:
        ViewerGone: the library's program doesn't give them.
    """
    with subprocess.Popen(  # noqa: S603  the viewer that came with the library
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
            return {name: _get(port, "" if name == INDEX else name) for name in NAMES}
        except (OSError, HTTPException) as error:
            raise ViewerGone(f"the viewer's page can't be had ({error})") from error
        finally:
            overdue.cancel()
            process.kill()


def _port(process: subprocess.Popen[bytes]) -> int:
    """The port that it says it listens on; asking one that was free a moment ago could reach somebody else's server."""
    said = b""
    for line in process.stderr or ():
        said = line
        if address := _ADDRESS.search(line):
            return int(address[1])
    raise OSError(said.decode(errors="replace").strip() or "it didn't begin")


def _get(port: int, name: str) -> bytes:
    connection = HTTPConnection(HOST, port, timeout=_TIMEOUT)
    try:
        connection.request("GET", f"/{name}")
        reply = connection.getresponse()
        content = reply.read()
        if reply.status != OK:
            raise OSError(f"{name}: {reply.status} {reply.reason}")
        return content
    finally:
        connection.close()
