"""Live viewing: a viewer gets all records; a slow, stalled, dead, late or missing one doesn't delay the plan."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from recorder.viewer import live
from recorder.viewer.connection import Target, ViewerKind, free_port
from replay.restore.verify import verify
from replay.view import convert
from tests.recorder.viewer.conftest import PATIENT, processes, rows_of, wait_until

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable, Iterator

    import psutil
    from conftest import Server

pytestmark = pytest.mark.slow

SCENE = """
import os, signal, sys
from pathlib import Path
from threading import Event
from pycram.bullet_world import BulletWorld, Object

def wait_for(file):
    while not Path(file).exists():
        Event().wait(0.05)

world = BulletWorld()
body = Object("milk", "milk", "milk.stl")
def move(times):
    for i in range(times):
        body.set_position([0.001 * i, 0, 0])
move(300)
Path("begun").touch()
"""


HURRY = """
from recorder.viewer import live
live._START_TIMEOUTS = dict.fromkeys(live.ViewerKind, 0.0)
live._END_TIMEOUT = 0.0
live._HAND_OVER_TIMEOUT = live._LINGER_TIMEOUT = 80.0  # on a busy machine, its process has little of it
"""


BRIEF = """
from recorder.viewer import live
live._LINGER_TIMEOUT = 3.0
"""


#: More than the socket of a stopped process takes.
FLOOD = """
from recorder import records
from recorder.tracing import journal
def flood(times):
    for _ in range(times):
        journal.emit(records.Output(stream="stdout", text=os.urandom(5_000).hex()))
"""


#: Takes simulated time, on a path.
MOTION = """
from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule, execution_environment
world.set_robot(Object("ur5", "robot", "ur5.urdf", [0, 2, 0.72]))
with execution_environment("continuous"):
    ProcessModule.perform(MotionDesignator([("type", "move-arm-joints"), ("ur5-arm", "park")]))
"""


FEW = """
live.LiveQueue.__init__.__defaults__ = (1_000, 128 << 20)
"""


class Ended:
    """What a plan has left."""

    def __init__(self, process: subprocess.Popen[str], log: Path, mark: str) -> None:
        self.out, self.err = process.communicate(timeout=100)
        self.code = process.returncode
        self.log = log
        self.mark = mark

    def missed(self) -> tuple[int, int]:
        """How many records the viewer missed, and of how many, as it was printed."""
        message = re.search(
            r"the viewer (?:missed|is) (\d+) of (\d+) records.*; the file contains all records", self.err
        )
        return (int(message[1]), int(message[2])) if message else (0, 0)

    def check(self) -> int:
        """The plan has succeeded, its recording is complete, nothing of it runs any more; the number of records."""
        assert self.code == 0, self.err
        wait_until(lambda: not marked(self.mark), "no process is left")
        with replay.open(self.log) as log:
            assert log.complete
            verification = verify(log)
            assert verification.sound, verification
            return len(log)


def marked(mark: str) -> list[psutil.Process]:
    """The processes that have come of a plan."""
    return processes(mark, "PYCRAM_TEST")


class Plan:
    """A plan that runs."""

    def __init__(
        self, pycram: Callable[..., subprocess.Popen[str]], folder: Path, code: str, live: str, **more: str
    ) -> None:
        (folder / "plan.py").write_text(SCENE + code)
        self.mark = uuid.uuid4().hex
        self.folder = folder
        self.process = pycram("run", "plan.py", f"--rerun={live}", PYCRAM_TEST=self.mark, **more)

    def end(self) -> Ended:
        return Ended(self.process, self.folder / "plan.mcap", self.mark)


@pytest.fixture
def plan(pycram: Callable[..., subprocess.Popen[str]], tmp_path: Path) -> Iterator[Callable[..., Plan]]:
    """Starts a plan in the scene above, with code that follows, watched by somebody."""
    started: list[Plan] = []

    def start(code: str, live: str, **more: str) -> Plan:
        started.append(Plan(pycram, tmp_path, code, live, **more))
        return started[-1]

    yield start
    for running in started:
        for process in marked(running.mark):
            process.kill()


def afterwards(log: Path, file: Path) -> Counter[str]:
    """The rows that a recording's records make when they are translated after the end."""
    with replay.open(log) as recording:
        convert([recording], file)
    return rows_of(file)


@pytest.mark.costly
def test_a_viewer_gets_everything(
    plan: Callable[..., Plan], serve: Callable[[], Server], tmp_path: Path, until
) -> None:
    server = serve()
    ended = plan(f"{PATIENT}world.simulate(0.5); move(500){MOTION}", f"connect:{server.url}").end()  # on a busy machine
    assert ended.check() > 800
    assert "missed" not in ended.err
    expected = afterwards(ended.log, tmp_path / "afterwards.rrd")
    assert any("/paths/" in entity for entity in expected)
    until(lambda: server.rows() == expected, "what is shown live is what is shown afterwards")


@pytest.mark.costly
def test_a_viewer_that_starts_late_gets_what_was_before(
    plan: Callable[..., Plan], serve: Callable[[], Server], port: int, tmp_path: Path, until
) -> None:
    running = plan("wait_for('go'); move(100)", f"connect:rerun+http://127.0.0.1:{port}/proxy")
    until((tmp_path / "begun").exists, "the plan has begun")
    assert running.process.stderr is not None
    assert "to start a viewer at any time" in running.process.stderr.readline(), "nobody was there when it looked"
    server = serve()
    until(server.rows, "something is shown")
    (tmp_path / "go").touch()
    ended = running.end()
    ended.check()
    assert "missed" not in ended.err
    expected = afterwards(ended.log, tmp_path / "afterwards.rrd")
    until(lambda: server.rows() == expected, "what was before is there")


def test_a_plan_that_ends_before_the_viewer_s_library_is_loaded_is_shown_whole(
    plan: Callable[..., Plan], serve: Callable[[], Server], tmp_path: Path, until
) -> None:
    server = serve()
    ended = plan(HURRY, f"connect:{server.url}").end()
    count = ended.check()
    behind, of = ended.missed()
    assert of == count
    assert behind > 0, "when it ends"
    rows = afterwards(ended.log, tmp_path / "afterwards.rrd")
    until(lambda: server.rows() == rows, "what was left is shown")


@pytest.mark.costly
def test_records_that_can_t_be_shown_are_skipped(
    plan: Callable[..., Plan], serve: Callable[[], Server], until: Callable[..., None]
) -> None:
    server = serve()
    nonsense = "records.Query(name='visible', picture=records.Picture(width=1, height=1, pixels=b'none'))"
    emit = f"journal.emit({nonsense}, world=world.name)"
    code = f"from recorder import records\nfrom recorder.tracing import journal\n{emit}\n{emit}\nmove(50)\nwait_for('shown')"
    running = plan(code, f"connect:{server.url}")
    until(lambda: server.rows()["/records/mutation"] > 350, "all that was recorded before is on its way")
    (running.folder / "shown").touch()
    ended = running.end()
    assert ended.code == 0
    assert ended.err.count("a record can't be shown") == 1
    assert ended.missed()[0] == 2
    with replay.open(ended.log) as log:
        moves = log.counts()["mutation"]
    until(lambda: server.rows()["/records/mutation"] == moves, "all else is shown")


def test_a_plan_runs_without_a_viewer(plan: Callable[..., Plan], port: int) -> None:
    ended = plan("move(100)", f"connect:rerun+http://127.0.0.1:{port}/proxy").end()
    count = ended.check()
    assert ended.missed() == (count, count)


def test_a_short_plan_waits_only_until_no_viewer_answers(
    tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "_END_TIMEOUT", 90.0)
    begun = time.monotonic()
    with recorder.record(tmp_path / "log.mcap", live=f"connect:rerun+http://127.0.0.1:{port}/proxy"):
        pass
    assert time.monotonic() - begun < 60


@pytest.mark.costly
def test_another_program_has_the_port(plan: Callable[..., Plan]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"rerun+http://127.0.0.1:{silent.getsockname()[1]}/proxy"
        ended = plan("move(100)", url).end()
    count = ended.check()
    assert ended.missed() == (count, count)


def changes_in(server: Server) -> int:
    """How many changes the viewer has got."""
    return server.rows()["/records/mutation"]


@pytest.mark.costly
def test_a_viewer_is_closed_while_the_plan_runs(plan: Callable[..., Plan], serve: Callable[[], Server], until) -> None:
    server = serve()
    running = plan("wait_for('more'); move(10); wait_for('go'); move(1_000)", f"connect:{server.url}")
    until(lambda: changes_in(server) > 100, "the viewer has it")
    shown = changes_in(server)
    (running.folder / "more").touch()
    until(lambda: changes_in(server) > shown, "it has taken what was before")
    server.end()
    (running.folder / "go").touch()
    ended = running.end()
    count = ended.check()
    assert "the viewer was closed; the plan continues without a viewer" in ended.err
    missed, of = ended.missed()
    assert of == count
    assert 0 < missed < count


@pytest.mark.costly
@pytest.mark.parametrize("at_the_end", [True, False])
def test_a_viewer_is_stopped_while_the_plan_runs(
    plan: Callable[..., Plan], serve: Callable[[], Server], until, *, at_the_end: bool
) -> None:
    server = serve()
    # it is let go on, or not, before the plan ends
    code = f"{FLOOD}wait_for('go'); flood(1_000); move(10); Path('flooded').touch()\n"
    code += "" if at_the_end else "wait_for('end')"
    running = plan(code, f"connect:{server.url}", before=BRIEF)
    until(lambda: changes_in(server) > 100, "the viewer has it")
    server.stall()
    (running.folder / "go").touch()
    until((running.folder / "flooded").exists, "the plan goes on")
    if not at_the_end:
        server.go_on()
        with replay.open(running.folder / "plan.mcap") as log:
            changes = log.counts()["mutation"]
        until(lambda: changes_in(server) >= changes, "the viewer catches up")
        (running.folder / "end").touch()
    ended = running.end()
    ended.check()


@pytest.mark.costly
def test_records_that_a_stopped_viewer_misses_are_counted(
    plan: Callable[..., Plan], serve: Callable[[], Server]
) -> None:
    server = serve()
    code = f"{FLOOD}os.kill({server.process.pid}, signal.SIGSTOP); flood(3_000)"
    ended = plan(code, f"connect:{server.url}", before=BRIEF + FEW).end()
    count = ended.check()
    missed, of = ended.missed()
    assert of == count
    assert missed > 1_000  # it is stopped, but its socket takes some
    with replay.open(ended.log) as log:
        assert 0 < int(log.metadata["pycram.end.viewer_dropped"]) <= missed


@pytest.mark.costly
def test_a_viewer_that_lives_gets_all_of_many_records(
    plan: Callable[..., Plan], serve: Callable[[], Server], until
) -> None:
    server = serve()
    running = plan("move(2_000); Path('flooded').touch(); wait_for('seen')", f"connect:{server.url}")
    until((running.folder / "flooded").exists, "the plan has done its part")
    until(lambda: changes_in(server) > 2_000, "the viewer catches up")
    (running.folder / "seen").touch()
    ended = running.end()
    assert ended.check() > 2_000
    assert "missed" not in ended.err


@pytest.mark.usefixtures("usual_ports")
@pytest.mark.parametrize(
    "code", [pytest.param("", marks=pytest.mark.costly), HURRY], ids=["in time", "later than the plan"]
)
def test_a_page_can_be_opened_while_the_plan_runs_and_until_ctrl_c(tmp_path: Path, code: str) -> None:
    (tmp_path / "plan.py").write_text(SCENE + code)
    mark = uuid.uuid4().hex
    with contextlib.ExitStack() as ends:
        ours, theirs = pty.openpty()  # somebody sits there
        ends.callback(os.close, ours)
        ends.callback(os.close, theirs)
        process = subprocess.Popen(
            [sys.executable, "-m", "pycram", "run", "plan.py", "--rerun=serve"],
            cwd=tmp_path,
            stdin=theirs,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3]), "PYCRAM_TEST": mark},
        )
        ends.callback(process.communicate)
        ends.callback(process.kill)
        assert process.stderr is not None
        lines: list[str] = []
        while not ("the page is served until Ctrl-C" in "".join(lines) and "live at" in "".join(lines)):
            lines.append(process.stderr.readline())
            assert lines[-1], lines
        address = re.search(r"recorder: live at (http://127\.0\.0\.1:\d+/\S+/)\?\S*url=(\S+)", "".join(lines))
        assert address, lines
        with urllib.request.urlopen(urllib.request.unquote(address[2]), timeout=100) as records:
            assert records.read(4) == b"RRF2"
        with urllib.request.urlopen(address[1], timeout=100) as page:
            assert b"rerun" in page.read().lower()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=100)
    assert process.returncode == 0
    assert not marked(mark)


@pytest.mark.costly
@pytest.mark.usefixtures("usual_ports")
@pytest.mark.parametrize("live", ["serve", "connect"])
def test_a_killed_plan_leaves_no_process(plan: Callable[..., Plan], port: int, until, live: str) -> None:
    url = f"connect:rerun+http://127.0.0.1:{port}/proxy"
    running = plan("wait_for('never')", live if live == "serve" else url)
    until((running.folder / "begun").exists, "the plan has begun")
    until(lambda: len(marked(running.mark)) == 2, "there is a process between plan and viewer")
    running.process.kill()
    until(lambda: not marked(running.mark), "nothing is left")


@pytest.mark.costly
@pytest.mark.needs("Xvfb", "Vulkan driver", "window libraries")
@pytest.mark.usefixtures("usual_ports")
def test_the_viewer_outlives_the_plan_that_opened_it(plan: Callable[..., Plan], display: str) -> None:
    with socket.create_server(("127.0.0.1", free_port(9876))):  # where it would listen is taken
        running = plan(f"{PATIENT}move(100)", "spawn", DISPLAY=display)
        ended = running.end()
    assert ended.code == 0, ended.err
    assert "missed" not in ended.err
    viewer = [process for process in marked(running.mark) if process.name() == "rerun"]
    assert len(viewer) == 1, "it is still open"


@pytest.mark.costly
@pytest.mark.usefixtures("usual_ports")
def test_no_viewer_opens_without_a_screen(plan: Callable[..., Plan]) -> None:
    ended = plan(f"{PATIENT}move(100)", "spawn").end()
    count = ended.check()
    assert "the viewer didn't open" in ended.err
    assert "DISPLAY" in ended.err
    assert ended.missed() == (count, count)


@pytest.mark.parametrize(
    "wrong", ["", "web", "connect:", "http://127.0.0.1:9876/proxy", "rerun+http://127.0.0.1:99999/proxy"]
)
def test_an_invalid_target_is_refused_at_once(tmp_path: Path, wrong: str) -> None:
    with (
        pytest.raises(recorder.RecordingError, match="use spawn, connect"),
        recorder.record(tmp_path / "x.mcap", live=wrong),
    ):
        pass
    assert not (tmp_path / "x.mcap").exists()


def test_the_command_line_refuses_an_invalid_target(
    pycram: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    process = pycram("demo", "--rerun=web")
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "--rerun: 'web' isn't the address of a viewer; use spawn, connect" in " ".join(printed.split())
    assert not list(tmp_path.iterdir())


def test_targets_are_parsed() -> None:
    assert Target.parse("connect") == Target(ViewerKind.CONNECT, "rerun+http://127.0.0.1:9876/proxy")
    assert Target.parse("connect:rerun://robot/proxy") == Target(ViewerKind.CONNECT, "rerun://robot/proxy")
    assert Target.parse("rerun+http://robot:1/proxy") == Target(ViewerKind.CONNECT, "rerun+http://robot:1/proxy")
