"""Connections to viewers: the requested viewer, servers and free ports, and this machine's viewer window.

A viewer is a window on this machine, a program that somebody else starts, or a page in browsers. All viewers use
servers at ``rerun+http`` addresses.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import IO, Final
from urllib.parse import urlsplit

from recorder.errors import RecordingError
from recorder.system import user

PORT: Final = 9876  # default port of viewers
_POLL_PERIOD: Final = 0.2  # time in s between attempts to reach a viewer
HOST: Final = "127.0.0.1"  # address for listening: recordings are private, so never on the network

_SCHEMES: Final = ("rerun", "rerun+http", "rerun+https")
_HINT: Final = f"use spawn, connect, connect:rerun+http://{HOST}:{PORT}/proxy or serve"
_METHOD: Final = "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteMessages"
_SOCKETS: Final = Path("/proc/net/tcp")
_LISTENS: Final = "0A"  # state of a listening socket in /proc/net/tcp
_ANSWER_TIMEOUT: Final = 1.0  # maximum time in s for an answer of a running viewer


class ViewerGone(Exception):
    """The viewer has ended, or hasn't started."""


class ViewerKind(Enum):
    """The ways to start a viewer."""

    SPAWN = "spawn"
    CONNECT = "connect"
    SERVE = "serve"


@dataclass(frozen=True, slots=True)
class Target:
    """The viewer that shows a plan."""

    kind: ViewerKind
    url: str = ""  # address of a viewer that another program starts

    @classmethod
    def parse(cls, text: str) -> Target:
        """Parse "spawn", "connect", "connect:URL", "serve" or a URL. Other texts raise RecordingError."""
        if text in (ViewerKind.SPAWN.value, ViewerKind.SERVE.value):
            return cls(ViewerKind(text))
        if text == ViewerKind.CONNECT.value:
            return cls(ViewerKind.CONNECT, address(PORT))
        url = text.removeprefix(f"{ViewerKind.CONNECT.value}:")
        try:
            parts = urlsplit(url)
            valid = parts.scheme in _SCHEMES and parts.hostname and parts.port != 0
        except ValueError as error:
            raise RecordingError(text, f"isn't the address of a viewer ({error}); {_HINT}") from error
        if not valid or parts.path.rstrip("/") != "/proxy":
            raise RecordingError(text, f"isn't the address of a viewer; {_HINT}")
        return cls(ViewerKind.CONNECT, url)


def address(port: int) -> str:
    """Return the address of a viewer on this machine."""
    return f"rerun+http://{HOST}:{port}/proxy"


def answers(url: str) -> bool:
    """Return whether a viewer's server accepts an empty stream of messages. Another program may use the port."""
    import http.client  # noqa: PLC0415  imported here: most recordings have no viewer

    parts = urlsplit(url)
    kind = http.client.HTTPConnection if parts.scheme == "rerun+http" else http.client.HTTPSConnection
    connection = kind(str(parts.hostname), parts.port or PORT, timeout=_ANSWER_TIMEOUT)
    try:
        connection.request("POST", _METHOD, headers={"content-type": "application/grpc-web+proto"})
        reply = connection.getresponse()
        return bool(reply.status == http.client.OK) and reply.getheader("grpc-status", "0") == "0"
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def wait_for_answer(url: str, check: Callable[[], None] = lambda: None) -> None:
    """Wait until a viewer answers. ``check`` is called before each attempt, and may raise an error."""
    pause = threading.Event()
    while not answers(url):
        check()
        pause.wait(_POLL_PERIOD)


def is_own(port: int) -> bool:
    """Return whether this user listens on a port of the loopback; True if unknown. Other users must not get records."""
    if not _SOCKETS.exists():
        return True
    entries = [line.split() for line in _SOCKETS.read_text(encoding="ascii").splitlines()[1:]]
    words = (int.from_bytes(socket.inet_aton(host), sys.byteorder) for host in (HOST, "0.0.0.0"))  # noqa: S104  either
    places = [f"{word:08X}:{port:04X}" for word in words]
    return {entry[7] for entry in entries if entry[3] == _LISTENS and entry[1] in places} == {str(user())}


def free_port(preferred: int) -> int:
    """Return the preferred port if it is free on all addresses of this machine, or else another free port."""
    for port in (preferred, 0):
        try:
            with socket.create_server(("", port)) as server:
                return int(server.getsockname()[1])
        except OSError:
            continue
    raise RecordingError(HOST, "no port is free")


END_TIMEOUT: Final = 2.0  # time in s to wait for the end of a viewer after its connection broke


class ViewerWindow:
    """The open viewer of this user on this machine, or a new viewer that outlives this process.

    The viewer's server answers before the window opens. A viewer without a screen ends later, so callers that lose the
    connection call :meth:`check`. If another user's program took the viewer's port, ViewerGone is raised.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  read again, because the viewer has ended
        self.url = address(PORT)  # address of the viewer, which has already answered
        if not (is_own(PORT) and answers(self.url)):
            self._start(free_port(PORT))

    def _start(self, port: int) -> None:
        self.url = address(port)
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", "rerun_cli", "--port", str(port), "--bind", HOST, "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._stderr,
            start_new_session=True,  # Ctrl-C must stop only the plan
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )
        wait_for_answer(self.url, self.check)
        if not is_own(port):  # another program has taken the port in the meantime
            raise ViewerGone(f"another user's program listens at {self.url}")

    def check(self, timeout: float = 0.0) -> None:
        """Raise ViewerGone if the viewer was closed or failed. ``timeout`` (s) limits the wait for the viewer's end."""
        if self._process is None:
            return
        with suppress(subprocess.TimeoutExpired):
            code = self._process.wait(timeout)
            self._stderr.seek(0)
            lines = [line.strip() for line in self._stderr.read().decode(errors="replace").split("\n") if line.strip()]
            words = lines[-1] if lines else "without a message"
            if code or words.startswith("Error"):  # after an error, the exit code may be 0
                raise ViewerGone(f"the viewer didn't open ({words})")
            raise ViewerGone("the viewer was closed")
