"""Real viewers for the tests: one without a window, the server of one that keeps what it gets, and a browser.

All are started for a test and surely ended after it. Drawn is with the processor.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import rerun_cli
from PIL import Image
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning
from rerun.experimental import ViewerClient

from recorder.viewer.connection import address, answers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

REPO = Path(__file__).parent.parent.parent
OURS = re.compile("[Ss]oftware rasterizer|Failed to load examples")  # no graphics card, no network
BINARY = str(Path(rerun_cli.__file__).with_name("rerun"))


def wait_until(condition: Callable[[], object], what: str, seconds: float = 60) -> None:
    """Waits for something that another process does."""
    pause, deadline = threading.Event(), time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not within {seconds} s"
        pause.wait(0.05)


@pytest.fixture
def until() -> Callable[..., None]:
    return wait_until


@pytest.fixture
def port() -> int:
    """A port that nobody has."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


@pytest.fixture
def usual_ports() -> Iterator[None]:
    """Keeps the ports where viewers listen by default for one test at a time, whatever process it runs in."""
    with (Path(tempfile.gettempdir()) / f"pycram-viewer-ports-{os.getuid()}").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


class Server:
    """A viewer's server that writes what it gets into a file."""

    def __init__(self, port: int, file: Path) -> None:
        self.url = address(port)
        self.file = file
        command = [BINARY, "--save", str(file), "--port", str(port), "--bind", "127.0.0.1"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_until(lambda: answers(self.url), "the server answers")

    def stall(self) -> None:
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        self.process.send_signal(signal.SIGCONT)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()

    def finish(self) -> None:
        """Lets it write the end of its file."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait(30)

    def rows(self) -> Counter[str]:
        """How many rows each entity has got so far."""
        return rows_of(self.file)


def rows_of(file: Path) -> Counter[str]:
    """How many rows each entity has in a file, which may be growing; not what is said of the recording as a whole."""
    found: Counter[str] = Counter()
    # nothing may be there yet, or half of it, without an end
    with contextlib.suppress(ValueError, OSError, RuntimeError), warnings.catch_warnings():
        warnings.simplefilter("ignore", RerunWarning)
        for chunk in RrdReader(file).stream():
            found[chunk.entity_path] += chunk.num_rows
    del found["/__properties"]
    return found


@pytest.fixture
def serve(port: int, tmp_path: Path) -> Iterator[Callable[[], Server]]:
    """Starts the server on ``port`` when it is called."""
    started: list[Server] = []

    def start() -> Server:
        started.append(Server(port, tmp_path / "shown.rrd"))
        return started[-1]

    yield start
    for server in started:
        server.end()


class Headless:
    """A viewer without a window: it draws, but only into pictures.

    What controls it has other names before rerun-sdk 0.40, the first that needs more than Python 3.10.
    """

    def __init__(self, port: int) -> None:
        self.client = ViewerClient.spawn(headless=True, port=port, detach_process=False, executable_path=BINARY)
        self.url = self.client.url

    def _call(self, name: str, old: str, *arguments: object) -> Any:
        return getattr(self.client, name if hasattr(self.client, name) else old)(*arguments)

    @property
    def pid(self) -> int:
        return self.client._pid

    def state(self) -> Any:
        """What it shows: recordings with their timelines, views with their reports."""
        return self._call("get_state", "viewer_state")

    def complaints(self) -> list[str]:
        """Warnings and errors of the viewer and of its views, but for those about this machine."""
        logs = self._call("get_logs", "viewer_logs")
        said = [f"{log.level} {log.message}" for log in logs if log.level != "INFO" and not OURS.search(log.message)]
        return said + [f"{view.name}: {report.summary}" for view in self.state().views for report in view.reports]

    def open(self, file: Path) -> None:
        """Opens a file and waits until it is loaded."""
        self._call("open", "open_url", str(file))
        wait_until(self.has_loaded, f"{file.name} is loaded")

    def has_loaded(self) -> bool:
        state = self.state()
        return not state.loading and any(recording.timelines for recording in state.recordings)

    def end_of(self, timeline: str) -> int:
        """The last time on a timeline of the recording that it has; -1 if there is none."""
        found = [
            line.end for recording in self.state().recordings for line in recording.timelines if line.name == timeline
        ]
        return max((end for end in found if end is not None), default=-1)

    def go_to(self, step: int) -> None:
        """Shows a step and stays there."""
        pausing = {"play_state": "paused"} if hasattr(self.client, "get_state") else {}
        self.client.set_time("step", sequence=step, **pausing)

    def picture(self, file: Path, view: str = "") -> Image.Image:
        """Draws a view that is in front, or all there is; views are there when something is loaded."""
        ids = [one.view_id for one in self.state().views if one.name == view]
        self.client.save_screenshot(str(file), *ids)
        with Image.open(file) as image:
            return image.convert("RGB")

    def end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGCONT)
        self._call("quit", "close")


@pytest.fixture
def headless(port: int) -> Iterator[Headless]:
    """A viewer without a window on ``port``."""
    viewer = Headless(port)
    yield viewer
    viewer.end()


class Browser:
    """A browser without a window and without a network but this machine's; talked to in the DevTools protocol."""

    def __init__(self, folder: Path) -> None:
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        options = [
            "--headless=new",
            "--no-sandbox",
            "--no-first-run",
            f"--user-data-dir={folder}",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--window-size=1000,700",
            "--remote-debugging-pipe",
        ]
        # it reads its orders from descriptor 3 and answers on 4
        plumbing = f'exec chromium "$@" 3<&{theirs_in} 4>&{theirs_out}'
        self._process = subprocess.Popen(
            ["bash", "-c", plumbing, "chromium", *options, "about:blank"],
            pass_fds=[theirs_in, theirs_out],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._reading = os.fdopen(ours_in, "rb")
        self._writing = os.fdopen(ours_out, "wb")
        self._rest = b""
        self._count = 0
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []
        (page,) = [one for one in self.call("Target.getTargets")["targetInfos"] if one["type"] == "page"]
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Gives an order that is obeyed; what happens meanwhile is kept in ``events``."""
        told = self.order(method, **parameters)
        assert "result" in told, told
        return told["result"]

    def order(self, method: str, **parameters: object) -> dict[str, Any]:
        """Gives an order and waits for its answer."""
        self._count += 1
        order = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            order["sessionId"] = self._session
        self._writing.write(json.dumps(order).encode() + b"\0")
        self._writing.flush()
        while True:
            told = self._next()
            if told.get("id") == self._count:
                return told
            self.events.append(told)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            read = self._reading.read1(1 << 20)
            assert read, "the browser ended"
            self._rest += read
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def asked(self) -> set[str]:
        """The addresses that its page asked for something."""
        return {e["params"]["request"]["url"] for e in self.events if e.get("method") == "Network.requestWillBeSent"}

    def errors(self) -> list[str]:
        """What the viewer in its page complains of."""
        told = [e["params"]["args"] for e in self.events if e.get("method") == "Runtime.consoleAPICalled"]
        lines = [str(one.get("value", "")) for arguments in told for one in arguments]
        thrown = [str(e["params"]) for e in self.events if e.get("method") == "Runtime.exceptionThrown"]
        return [line for line in lines if line.lstrip().startswith("ERROR")] + thrown

    def picture(self, file: Path) -> Image.Image:
        taken: dict[str, Any] = {}

        def drawn() -> bool:
            taken.update(self.order("Page.captureScreenshot"))
            return "result" in taken  # a page that is on its way elsewhere can't be drawn

        wait_until(drawn, "the page is drawn")
        file.write_bytes(base64.b64decode(taken["result"]["data"]))
        with Image.open(file) as image:
            return image.convert("RGB")

    def end(self) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._reading.close()
        with contextlib.suppress(BrokenPipeError):
            self._writing.close()


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    made = Browser(tmp_path / "browser")
    yield made
    made.end()


@pytest.fixture
def pycram(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts the command line as a process of its own, in ``tmp_path``."""
    started: list[subprocess.Popen[str]] = []

    def start(*words: str, **environment: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "pycram", *words],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={"PYTHONPATH": str(REPO), "PATH": os.environ["PATH"], **environment},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()
