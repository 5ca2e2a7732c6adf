"""An editor that speaks the Debug Adapter Protocol, and checks each message against the protocol's published schema."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from functools import cache
from importlib.resources import files
from typing import IO, TYPE_CHECKING, Any, Self

import jsonschema

if TYPE_CHECKING:
    from collections.abc import Sequence

Message = dict[str, Any]
PATIENCE = 300  # s, after which an adapter is killed


@cache
def schema() -> Message:
    """The protocol's schema, as debugpy brings it along."""
    file = files("debugpy") / "_vendored/pydevd/_pydevd_bundle/_debug_adapter/debugProtocol.json"
    found: Message = json.loads(file.read_text(encoding="utf-8"))
    return found


@cache
def checker(definition: str) -> jsonschema.Draft4Validator:
    """Checks messages of one definition."""
    assert definition in schema()["definitions"], definition
    return jsonschema.Draft4Validator({"$ref": f"#/definitions/{definition}", "definitions": schema()["definitions"]})


def definition_of(message: Message) -> str:
    """The name of the definition that a message has to fit."""
    if message["type"] == "response" and not message["success"]:
        return "ErrorResponse"
    name = message["event" if message["type"] == "event" else "command"]
    return f"{name[0].upper()}{name[1:]}{message['type'].capitalize()}"


class Editor:
    """An editor, connected to an adapter on stdin and stdout; or, with streams, to any adapter."""

    def __init__(self, *options: str, streams: tuple[IO[bytes], IO[bytes]] | None = None) -> None:
        self.process = None
        if streams is None:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "replay", "debug", "--dap", *options],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            assert self.process.stdin is not None
            assert self.process.stdout is not None
            self._patience = threading.Timer(PATIENCE, self.process.kill)  # a test that hangs fails
            self._patience.start()
            streams = self.process.stdin, self.process.stdout
        self.writing, self.reading = streams
        self.events: list[Message] = []
        self._number = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None:
            self._patience.cancel()
            with self.process as process:
                process.kill()

    def send(self, command: str, arguments: Message) -> int:
        """Send a request; returns its number."""
        self._number += 1
        message = {"seq": self._number, "type": "request", "command": command, "arguments": arguments}
        checker(definition_of(message)).validate(message)
        text = json.dumps(message).encode()
        self.writing.write(b"Content-Length: %d\r\n\r\n%b" % (len(text), text))
        self.writing.flush()
        return self._number

    def respond(self, command: str, **arguments: object) -> Message:
        """Send a request; returns the whole response. Events before it are kept."""
        number = self.send(command, arguments)
        while True:
            message = self.read()
            if message["type"] == "response":
                assert message["request_seq"] == number
                return message
            self.events.append(message)

    def ask(self, command: str, **arguments: object) -> Message:
        """Send a request that succeeds; returns the body of the response."""
        response = self.respond(command, **arguments)
        assert response["success"], response
        body: Message = response["body"]
        return body

    def until(self, event: str) -> Message:
        """Wait for an event; returns its body. Events before it are dropped."""
        while True:
            message = self.events.pop(0) if self.events else self.read()
            if message["event"] == event:
                body: Message = message["body"]
                return body

    def read(self) -> Message:
        """Read a message."""
        length = 0
        while (line := self.reading.readline()).strip():
            length = int(line.partition(b":")[2])
        text = self.reading.read(length)
        assert text, "the adapter has ended"
        message: Message = json.loads(text)
        checker(definition_of(message)).validate(message)
        return message

    def launch(self, *, filters: Sequence[str] = (), **arguments: object) -> Message:
        """Begin to debug; returns why and where the plan stopped first."""
        self.ask("initialize", adapterID="pycram")
        self.ask("launch", **arguments)
        self.until("initialized")
        self.ask("setExceptionBreakpoints", filters=list(filters))
        self.ask("configurationDone")
        return self.until("stopped")

    def move(self, command: str, **arguments: object) -> Message:
        """Move the plan; returns why and where it stopped."""
        self.ask(command, threadId=1, **arguments)
        return self.until("stopped")

    def frames(self) -> list[Message]:
        """The plan's frames and the tasks around them."""
        found: list[Message] = self.ask("stackTrace", threadId=1)["stackFrames"]
        return found

    def variables(self, scope: str, *path: str, frame: int = 0) -> dict[str, Message]:
        """The variables of a scope, or below the named ones."""
        scopes = self.ask("scopes", frameId=frame)["scopes"]
        reference = next(each["variablesReference"] for each in scopes if each["name"] == scope)
        listed = self.listed(reference)
        for name in path:
            listed = self.listed(listed[name]["variablesReference"])
        return listed

    def listed(self, reference: int) -> dict[str, Message]:
        """The variables of a reference, by their names."""
        return {each["name"]: each for each in self.ask("variables", variablesReference=reference)["variables"]}

    def leave(self) -> int:
        """Disconnect; returns the adapter's exit code."""
        assert self.process is not None
        self.ask("disconnect")
        return self.process.wait()
