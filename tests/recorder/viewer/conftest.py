"""Real viewers for the tests: one without a window, the server of one that keeps what it gets, and a browser.

All are started for a test and surely ended after it: what a test leaves behind - a process, a file that is open, what
lies in the folder for temporary files - is its own failure, and never that of a test which runs later. Drawn is with the
processor.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import gc
import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import uuid
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
import pytest
import rerun_cli
from PIL import Image
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning
from rerun.experimental import ViewerClient

from recorder.viewer.connection import address, answers
from recorder.viewer.rerun_stream import STEP
from tests import needs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

REPO = Path(__file__).parents[3]
# no graphics card, no network, and a picture that is asked for again
OURS = re.compile("[Ss]oftware rasterizer|Failed to load examples|Failed to render screenshot")
BINARY = str(Path(rerun_cli.__file__).with_name("rerun"))
MARK = "PYCRAM_TEST_OF"  # in the environment of what a test starts, and of what that starts
#: The code of a plan whose viewer has the time that it needs on a busy machine.
PATIENT = """
from recorder.viewer import live
live._START_TIMEOUTS = dict.fromkeys(live.ViewerKind, 60.0)
live._END_TIMEOUT = live._HAND_OVER_TIMEOUT = live._LINGER_TIMEOUT = 80.0
"""
LEAVING = 10.0  # s for a process to end by itself after the test
PORTS = range(20_000, 32_000)  # below those that the system gives to connections while somebody looks for a free one
LOCK = Path(tempfile.gettempdir()) / f"pycram-viewer-ports-{os.getuid()}"  # of all runs on this machine


def wait_until(condition: Callable[[], object], what: str, seconds: float = 100) -> None:
    """Waits for something that another process does; to look takes processors that it needs, so not too often."""
    pause, asked = threading.Event(), time.monotonic()
    deadline = asked + seconds
    while not condition():
        now = time.monotonic()
        assert now < deadline, f"{what}: not within {seconds} s"
        pause.wait(min(max(0.05, 2 * (now - asked)), 1.0))
        asked = time.monotonic()


@pytest.fixture
def until() -> Callable[..., None]:
    return wait_until


def processes(mark: str, variable: str = MARK) -> list[psutil.Process]:
    """The processes that live and have come of a test, whoever their parents are now."""
    living, entry = [], f"{variable}={mark}\0".encode()
    for number in psutil.pids():
        with contextlib.suppress(OSError, psutil.Error):  # not ours, or gone
            if entry in Path(f"/proc/{number}/environ").read_bytes():  # that of a zombie is empty
                living.append(psutil.Process(number))
    return living


@pytest.fixture(autouse=True)
def isolated(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """A folder for temporary files of each test, and nothing that lives on after it."""
    folder, mark = tmp_path_factory.mktemp("temporary"), uuid.uuid4().hex
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)  # it is looked up again
    monkeypatch.setenv(MARK, mark)
    yield
    left = processes(mark)
    psutil.wait_procs(left, LEAVING)
    leftover = []
    for process in processes(mark) if left else ():
        with contextlib.suppress(psutil.Error):
            leftover.append(f"{process.pid}: {' '.join(process.cmdline())}")
            process.kill()
    if request.node.get_closest_marker("slow"):  # those start processes; it takes a while
        gc.collect()  # a file that it left open is reported here, not in the middle of another test
    assert not leftover, f"left running: {leftover}"


@pytest.fixture
def port() -> int:
    """A port that nobody has."""
    while True:
        with contextlib.suppress(OSError), socket.create_server(("", random.choice(PORTS))) as free:
            return int(free.getsockname()[1])


@pytest.fixture
def usual_ports() -> Iterator[None]:
    """Keeps the ports where viewers listen by default for one test at a time, whatever process it runs in."""
    with LOCK.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


class Server:
    """A viewer's server that writes what it gets into a file."""

    def __init__(self, port: int, file: Path) -> None:
        self.url = address(port)
        self.file = file
        self._size = 0  # of the file when it was read
        self._rows: Counter[str] = Counter()
        command = [BINARY, "--save", str(file), "--port", str(port), "--bind", "127.0.0.1"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            wait_until(lambda: answers(self.url), "the server answers")
        except BaseException:
            self.end()
            raise

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
        size = self.file.stat().st_size if self.file.exists() else 0
        if size != self._size:
            self._size, self._rows = size, rows_of(self.file)
        return self._rows


def rows_of(file: Path) -> Counter[str]:
    """How many rows each entity has in a file, which may be growing; not what is said of the recording as a whole."""
    counts: Counter[str] = Counter()
    # nothing may be there yet, or half of it, without an end
    with contextlib.suppress(ValueError, OSError, RuntimeError), warnings.catch_warnings():
        warnings.simplefilter("ignore", RerunWarning)
        for chunk in RrdReader(file).stream():
            counts[chunk.entity_path] += chunk.num_rows
    del counts["/__properties"]
    return counts


@pytest.fixture
def serve(port: int, tmp_path: Path) -> Iterator[Callable[[], Server]]:
    """Starts the server on ``port`` when it is called."""
    with contextlib.ExitStack() as ends:

        def start() -> Server:
            server = Server(port, tmp_path / "shown.rrd")
            ends.callback(server.end)
            return server

        yield start


class Headless:
    """A viewer without a window: it draws, but only into pictures."""

    def __init__(self, port: int) -> None:
        self.client = ViewerClient.spawn(headless=True, port=port, detach_process=False, executable_path=BINARY)
        self.url = self.client.url

    @property
    def pid(self) -> int:
        return self.client._pid

    def state(self) -> Any:
        """What it shows: recordings with their timelines, views with their reports."""
        return self.client.get_state()

    def complaints(self) -> list[str]:
        """Warnings and errors of the viewer and of its views, but for those about this machine."""
        logs = self.client.get_logs()
        complaints = [
            f"{log.level} {log.message}" for log in logs if log.level != "INFO" and not OURS.search(log.message)
        ]
        return complaints + [f"{view.name}: {report.summary}" for view in self.state().views for report in view.reports]

    def open(self, file: Path) -> None:
        """Opens a file and waits until it is loaded."""
        self.client.open(str(file))
        wait_until(self.has_loaded, f"{file.name} is loaded")

    def has_loaded(self) -> bool:
        state = self.state()
        return not state.loading and any(recording.timelines for recording in state.recordings)

    def end_of(self, timeline: str) -> int:
        """The last time on a timeline of the recording that it has; -1 if there is none."""
        ends = [
            line.end for recording in self.state().recordings for line in recording.timelines if line.name == timeline
        ]
        return max((end for end in ends if end is not None), default=-1)

    def go_to(self, step: int) -> None:
        """Shows a step and stays there."""
        self.client.set_time(STEP, sequence=step, play_state="paused")

    def picture(self, file: Path, view: str = "") -> Image.Image:
        """Draws a view that is in front, or all there is; views are there when something is loaded."""
        ids = [shown.view_id for shown in self.state().views if shown.name == view]

        def drawn() -> bool:
            try:
                self.client.save_screenshot(str(file), *ids)
            except TimeoutError:  # it draws with processors that others may have
                return False
            return True

        wait_until(drawn, "it is drawn")
        with Image.open(file) as image:
            return image.convert("RGB")

    def end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGCONT)
        self.client.quit()


@pytest.fixture
def headless(port: int) -> Iterator[Headless]:
    """A viewer without a window on ``port``."""
    needs.need("Vulkan driver")
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
            # the processor draws, so what is drawn is small; the page runs for a minute: optimizing it takes as long
            "--window-size=500,350",
            "--disable-gpu-compositing",
            "--js-flags=--liftoff-only --wasm-lazy-compilation",
            "--disable-extensions",
            "--disable-component-update",
            "--disable-background-networking",
            "--remote-debugging-pipe",
        ]
        # it reads its orders from descriptor 3 and answers on 4
        plumbing = f'exec {needs.browser()} "$@" 3<&{theirs_in} 4>&{theirs_out}'
        self._process = subprocess.Popen(
            ["bash", "-c", plumbing, "browser", *options, "about:blank"],
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
        try:
            self._attach()
        except BaseException:
            self.end()
            raise

    def _attach(self) -> None:
        """Takes the page that it has opened with."""
        (page,) = [target for target in self.call("Target.getTargets")["targetInfos"] if target["type"] == "page"]
        attached = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """Gives an order that is obeyed; what happens meanwhile is kept in ``events``."""
        reply = self.order(method, **parameters)
        assert "result" in reply, reply
        return reply["result"]

    def order(self, method: str, **parameters: object) -> dict[str, Any]:
        """Gives an order and waits for its answer."""
        self._count += 1
        order = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            order["sessionId"] = self._session
        self._writing.write(json.dumps(order).encode() + b"\0")
        self._writing.flush()
        while True:
            reply = self._next()
            if reply.get("id") == self._count:
                return reply
            self.events.append(reply)

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
        calls = [e["params"]["args"] for e in self.events if e.get("method") == "Runtime.consoleAPICalled"]
        lines = [str(argument.get("value", "")) for arguments in calls for argument in arguments]
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
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._reading.close()
        with contextlib.suppress(BrokenPipeError):
            self._writing.close()


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    needs.need("Chromium")
    made = Browser(tmp_path / "browser")
    yield made
    made.end()


@pytest.fixture
def pycram(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts the command line as a process of its own, in ``tmp_path``; ``before`` is code that it runs first."""
    with contextlib.ExitStack() as ends:

        def start(*arguments: str, before: str = "", **environment: str) -> subprocess.Popen[str]:
            kept = {name: os.environ[name] for name in ("PATH", "TMPDIR", "PYCRAM_CACHE", MARK)}
            end = "import sys\nfrom pycram.__main__ import main\nsys.exit(main())"
            program = ["-c", f"{before}\n{end}"] if before else ["-m", "pycram"]
            process = subprocess.Popen(
                [sys.executable, *program, *arguments],
                cwd=tmp_path,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env={"PYTHONPATH": str(REPO), **kept, **environment},
            )
            ends.callback(process.communicate)
            ends.callback(process.kill)
            return process

        yield start
