"""Who looks at a plan while it runs: a viewer that is started, one that somebody starts, or pages in browsers.

Every viewer speaks the same protocol: a server at the other end of a ``rerun+http`` address, to which records are sent,
or from which viewers fetch them.
"""

from __future__ import annotations

import http.client
import socket
from dataclasses import dataclass
from enum import Enum
from typing import Final
from urllib.parse import urlsplit

from recorder.errors import RecordingError

PORT: Final = 9876  # where viewers listen unless they are told otherwise
PAGE_PORT: Final = 9090  # of pages, and where these get their records from: not what would be taken for a viewer
RECORDS_PORT: Final = 9877
LINGERING: Final = 30.0  # s after the end of a recording for a viewer that is behind
HOST: Final = "127.0.0.1"  # what is recorded is nobody's business on the network

_SCHEMES: Final = {
    "rerun": http.client.HTTPSConnection,
    "rerun+http": http.client.HTTPConnection,
    "rerun+https": http.client.HTTPSConnection,
}
_HINT: Final = f"say spawn, connect, connect:rerun+http://{HOST}:{PORT}/proxy or serve"
_METHOD: Final = "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteMessages"
_PATIENCE: Final = 1.0  # s; a viewer that lives answers within milliseconds


class ViewerGone(Exception):
    """The viewer has ended, or didn't begin."""


class Kind(Enum):
    """Who is at the other end."""

    SPAWN = "spawn"
    CONNECT = "connect"
    SERVE = "serve"


class Status(Enum):
    """What a recording is told of its viewer."""

    ABSENT = "absent"
    READY = "ready"


@dataclass(frozen=True, slots=True)
class Target:
    """How a plan is to be watched.

    Attributes:
        kind: by whom.
        url: address of the viewer, where it is one that somebody else starts.
    """

    kind: Kind
    url: str = ""

    @classmethod
    def parse(cls, text: str) -> Target:
        """Reads a wish as users write it.

        Args:
            text: "spawn", "connect", "connect:URL", "serve" or just a URL.

        Raises:
            RecordingError: it is none of these, or the URL is no address of a viewer.
        """
        if text in (Kind.SPAWN.value, Kind.SERVE.value):
            return cls(Kind(text))
        if text == Kind.CONNECT.value:
            return cls(Kind.CONNECT, address(PORT))
        url = text.removeprefix(f"{Kind.CONNECT.value}:")
        try:
            place = urlsplit(url)
            sound = place.scheme in _SCHEMES and place.hostname and place.port != 0
        except ValueError as error:
            raise RecordingError(text, f"is no address of a viewer ({error}); {_HINT}") from error
        if not sound or place.path.rstrip("/") != "/proxy":
            raise RecordingError(text, f"is no address of a viewer; {_HINT}")
        return cls(Kind.CONNECT, url)


def address(port: int) -> str:
    """The address of a viewer on this machine.

    Args:
        port: where it listens.
    """
    return f"rerun+http://{HOST}:{port}/proxy"


def answers(url: str) -> bool:
    """Whether a viewer's server lives at an address: not just a port that is open, and not a stopped process.

    It is asked to take a stream of no messages.

    Args:
        url: its address.
    """
    place = urlsplit(url)
    connection = _SCHEMES[place.scheme](str(place.hostname), place.port or PORT, timeout=_PATIENCE)
    try:
        connection.request("POST", _METHOD, headers={"content-type": "application/grpc-web+proto"})
        reply = connection.getresponse()
        return bool(reply.status == http.client.OK) and reply.getheader("grpc-status", "0") == "0"
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def free_port(wanted: int) -> int:
    """The wanted port if nobody listens there on any address of this machine, else one that is free.

    Args:
        wanted: the port.
    """
    for port in (wanted, 0):
        try:
            with socket.create_server(("", port)) as found:
                return int(found.getsockname()[1])
        except OSError:
            continue
    raise RecordingError(HOST, "no port is free")
