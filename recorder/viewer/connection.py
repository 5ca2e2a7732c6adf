"""Connections to viewers: which one is requested, what listens there, free ports, and this machine's own window.

A viewer is started here, started elsewhere, or a page in browsers. All speak one protocol: a server at a ``rerun+http``
address, to which records are sent, or from which pages fetch them.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import urlsplit

from recorder.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable


PORT: Final = 9876  # where viewers listen by default
_POLL_PERIOD: Final = 0.2  # s between two attempts to reach a viewer
HOST: Final = "127.0.0.1"  # what is recorded is nobody's business on the network

_SCHEMES: Final = ("rerun", "rerun+http", "rerun+https")
_HINT: Final = f"say spawn, connect, connect:rerun+http://{HOST}:{PORT}/proxy or serve"
_METHOD: Final = "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteMessages"
_SOCKETS: Final = Path("/proc/net/tcp")
_LISTENS: Final = "0A"  # the state of a socket
_ANSWER_TIMEOUT: Final = 1.0  # s; a viewer that lives answers within milliseconds


class ViewerGone(Exception):
    """The viewer has ended, or didn't begin."""


class ViewerKind(Enum):
    """Which viewer."""

    SPAWN = "spawn"
    CONNECT = "connect"
    SERVE = "serve"


@dataclass(frozen=True, slots=True)
class Target:
    """Where a plan is shown."""

    kind: ViewerKind
    url: str = ""  # its address, where somebody else starts it

    @classmethod
    def parse(cls, text: str) -> Target:
        """Parse "spawn", "connect", "connect:URL", "serve" or a URL; raise RecordingError if it is none of these."""
        if text in (ViewerKind.SPAWN.value, ViewerKind.SERVE.value):
            return cls(ViewerKind(text))
        if text == ViewerKind.CONNECT.value:
            return cls(ViewerKind.CONNECT, address(PORT))
        url = text.removeprefix(f"{ViewerKind.CONNECT.value}:")
        try:
            parts = urlsplit(url)
            valid = parts.scheme in _SCHEMES and parts.hostname and parts.port != 0
        except ValueError as error:
            raise RecordingError(text, f"is no address of a viewer ({error}); {_HINT}") from error
        if not valid or parts.path.rstrip("/") != "/proxy":
            raise RecordingError(text, f"is no address of a viewer; {_HINT}")
        return cls(ViewerKind.CONNECT, url)


def address(port: int) -> str:
    """Address of a viewer on this machine."""
    return f"rerun+http://{HOST}:{port}/proxy"


def answers(url: str) -> bool:
    """Whether a viewer's server takes an empty stream of messages there; an open port isn't enough."""
    import http.client  # noqa: PLC0415  most recordings have no viewer

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
    """Waits until a viewer answers; ``check`` is called from time to time, and may raise."""
    pause = threading.Event()
    while not answers(url):
        check()
        pause.wait(_POLL_PERIOD)


def is_own(port: int) -> bool:
    """Whether this user's process listens on a port of the loopback; another user's gets nothing that is recorded.

    Where the system doesn't tell whose a port is (other than Linux), it is believed to be.
    """
    if not _SOCKETS.exists():
        return True
    entries = [line.split() for line in _SOCKETS.read_text(encoding="ascii").splitlines()[1:]]
    words = (int.from_bytes(socket.inet_aton(host), sys.byteorder) for host in (HOST, "0.0.0.0"))  # noqa: S104  either
    places = [f"{word:08X}:{port:04X}" for word in words]
    return {entry[7] for entry in entries if entry[3] == _LISTENS and entry[1] in places} == {str(os.getuid())}


def free_port(preferred: int) -> int:
    """The wanted port if nobody listens there on any address of this machine, else one that is free."""
    for port in (preferred, 0):
        try:
            with socket.create_server(("", port)) as server:
                return int(server.getsockname()[1])
        except OSError:
            continue
    raise RecordingError(HOST, "no port is free")


END_TIMEOUT: Final = 2.0  # s that a viewer whose connection broke takes to end


class ViewerWindow:
    """This user's viewer that is open on this machine, or a new process that outlives this one.

    Its server answers before its window opens, and it ends then if there is no screen. So a caller that can't reach it
    any more calls :meth:`check`.

    Raises:
        ViewerGone: it ended immediately, or can't be distinguished from another user's.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  its last line is read when it ended
        self.url = address(PORT)  # where it takes records; it has answered there
        if not (is_own(PORT) and answers(self.url)):
            self._start(free_port(PORT))

    def _start(self, port: int) -> None:
        self.url = address(port)
        self._process = subprocess.Popen(  # noqa: S603  the viewer that came with the library
            [sys.executable, "-m", "rerun_cli", "--port", str(port), "--bind", HOST, "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._stderr,
            start_new_session=True,  # Ctrl-C is for the plan
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )
        wait_for_answer(self.url, self.check)
        if not is_own(port):  # somebody was quicker than it
            raise ViewerGone(f"another user's program listens at {self.url}")

    def check(self, timeout: float = 0.0) -> None:
        """Raise :class:`ViewerGone` if it was closed, or ended with an error, for example because there is no screen.

        It is ending when a connection to it broke: ``timeout`` (s) is the time to wait for that.
        """
        if self._process is None:
            return
        with suppress(subprocess.TimeoutExpired):
            code = self._process.wait(timeout)
            self._stderr.seek(0)
            lines = [line.strip() for line in self._stderr.read().decode(errors="replace").split("\n") if line.strip()]
            words = lines[-1] if lines else "it didn't say why"
            if code or words.startswith("Error"):  # the viewer's code is 0 then, too
                raise ViewerGone(f"the viewer didn't open ({words})")
            raise ViewerGone("the viewer was closed")
