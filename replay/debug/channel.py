"""Messages between the prompt's process and the plan's: lines of JSON on a socket."""

from __future__ import annotations

import json
import select
import signal
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, TypeAlias

if TYPE_CHECKING:
    import socket

Message: TypeAlias = "dict[str, Any]"
_BLOCK: Final = 1 << 16
PAUSE: Final = getattr(signal, "SIGURG", signal.SIGINT)  # systems that can fork have it
"""Asks a plan that makes no record, and so reads no message, to stop where it is; ignored where nobody handles it."""


class Channel:
    """One end of a connection."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._received = b""

    def fileno(self) -> int:
        """Return what to wait at for messages."""
        return self._socket.fileno()

    def send(self, message: Message) -> None:
        """Send a message; to one who is gone, nothing."""
        with suppress(BrokenPipeError, ConnectionResetError):  # the next receive() tells
            self._socket.sendall(json.dumps(message).encode() + b"\n")

    def receive(self) -> Message | None:
        """Wait for a message; None if the other end is gone."""
        while b"\n" not in self._received:
            try:
                part = self._socket.recv(_BLOCK)
            except ConnectionResetError:
                part = b""
            if not part:
                return None
            self._received += part
        line, _, self._received = self._received.partition(b"\n")
        message: Message = json.loads(line)
        return message

    @property
    def pending(self) -> bool:
        """Whether something has arrived."""
        return self.has_read or bool(select.select([self._socket], (), (), 0)[0])

    @property
    def has_read(self) -> bool:
        """Whether a message was read already, with the one before: the socket doesn't tell."""
        return b"\n" in self._received

    def close(self) -> None:
        """Close this end."""
        self._socket.close()
