"""PyBullet's window: on a screen of its own, or refused without one."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.bullet_world import BulletWorld
from pycram.failures import DisplayError
from recorder.records import Mutation
from replay.restore.verify import verify

if TYPE_CHECKING:
    from pathlib import Path

PLAN = """
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import DisplayError
ends = []
for mode in ("DIRECT", "GUI"):
    world = BulletWorld(mode)
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", "milk.stl", [0, 0, 0.2])
    world.simulate(0.5)
    ends.append(milk.get_position_and_orientation())
try:
    BulletWorld("GUI")
except DisplayError as error:
    print("refused:", error)
print("the same as without a window:", ends[0] == ends[1])
world.exit()
with BulletWorld("GUI") as again:
    again.simulate(0.1)
print("ended")
"""


DRAGGING = """
import ctypes, itertools, sys, time
import pybullet
import recorder
from pycram.bullet_world import BulletWorld, Object

x11, xtest = ctypes.CDLL("libX11.so.6"), ctypes.CDLL("libXtst.so.6")
x11.XOpenDisplay.restype = ctypes.c_void_p
screen = ctypes.c_void_p(x11.XOpenDisplay(None))

def point(x, y):
    xtest.XTestFakeMotionEvent(screen, -1, x, y, 0)
    x11.XSync(screen, 0)

def press(down):
    xtest.XTestFakeButtonEvent(screen, 1, down, 0)
    x11.XSync(screen, 0)

class Latest:
    dragged = False
    def write(self, topic, record, payload):
        if topic == "/mutation": self.dragged = bool(record.drags)
    def attach(self, asset): pass
    def flush(self): pass
    def close(self): pass

latest = Latest()
with recorder.record(sys.argv[1]) as recording, BulletWorld("GUI", name="lab") as world:
    recording.journal.add_sink(latest)
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    Object("bowl", "bowl", "bowl.stl", [1, 1, 0.05])
    milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
    world.settle()
    pybullet.resetDebugVisualizerCamera(0.6, 0, -30, milk.get_position())
    # The window's thread takes events when it has drawn: however long that takes on a busy machine, waiting ends
    # with what is waited for, or with an error that names it.
    def until(happened, what):
        end = time.monotonic() + 60
        while not (result := happened()):
            assert time.monotonic() < end, f"a minute without {what}"
            world.simulate(1 / 30)
        return result
    # where the mouse is in the window: its events tell
    def pointer():
        point(400, 300); point(401, 301)
        return next((event[1:3] for event in pybullet.getMouseEvents() if event[0] == 1), None)
    seen = until(pointer, "an event of the mouse")
    width, height = pybullet.getDebugVisualizerCamera()[:2]
    x, y = round(401 + width / 2 - seen[0]), round(301 + height / 2 - seen[1])
    point(x, y)
    press(True)
    steps = itertools.count()
    def pulled():
        point(x + min(next(steps), 100), y)
        return milk.get_position()[0] > 0.05
    until(pulled, "a milk that follows the mouse")
    press(False)
    until(lambda: not latest.dragged, "the milk let go")
    print("dragged to", milk.get_position()[0])
"""


def run(plan: str, *arguments: str, display: str) -> str:
    """Returns what a plan prints in a process of its own, which ends well."""
    command = [sys.executable, "-c", plan, *arguments]
    environment = os.environ | {"DISPLAY": display}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=200)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.mark.costly
@pytest.mark.needs("Xvfb", "OpenGL", "XTest")
@pytest.mark.slow
def test_what_somebody_drags_with_the_mouse_is_marked(
    display: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "x.mcap"
    run(DRAGGING, str(file), display=display)
    with replay.open(file) as log:
        changes = list(log.records(Mutation))
        dragged = [record for record in changes if record.drags]
        assert dragged
        assert {drag.body for record in dragged for drag in record.drags} == {"milk"}
        assert not changes[-2].drags, "it was let go"
        assert log.blame("milk", dragged[-1].seq).how == "hand"
        assert verify(log).sound


@pytest.mark.needs("Xvfb", "OpenGL")
@pytest.mark.costly
def test_a_window_opens_and_simulates_as_without_one(display: str) -> None:
    output = run(PLAN, display=display)
    assert "PyBullet has only one window" in output
    # the window's native thread greets on stdout too, whenever it likes
    assert "the same as without a window: True" in output
    assert output.rstrip().endswith("ended")


STAYS = """
from pycram.bullet_world import BulletWorld, Object
world = BulletWorld("GUI")
Object("milk", "milk", "milk.stl")
"""


@pytest.mark.needs("Xvfb", "OpenGL")
@pytest.mark.slow
def test_a_window_outlives_its_script_where_somebody_can_close_it(display: str) -> None:
    quiet = {name: value for name, value in os.environ.items() if name != "CI"} | {"DISPLAY": display}
    command = [sys.executable, "-c", STAYS]
    terminal, user = pty.openpty()
    with (
        os.fdopen(terminal, "wb"),
        os.fdopen(user, "rb") as stdin,
        subprocess.Popen(command, env=quiet, stdin=stdin, stderr=subprocess.PIPE, text=True) as process,
    ):
        assert process.stderr is not None
        assert any("stays open until you close it" in line for line in process.stderr)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


@pytest.mark.costly
@pytest.mark.needs("Xvfb", "OpenGL")
@pytest.mark.slow
def test_a_window_opens_on_a_server_that_resets_and_ends_where_nobody_could_close_it() -> None:
    reading, writing = os.pipe()
    server = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1024x768x24", "-nolisten", "tcp"]
    with os.fdopen(reading) as answer, subprocess.Popen(server, pass_fds=[writing], stderr=subprocess.DEVNULL) as xvfb:
        os.close(writing)
        try:
            environment = os.environ | {"DISPLAY": f":{answer.readline().strip()}", "CI": "1"}
            command = [sys.executable, "-c", STAYS]
            terminal, user = pty.openpty()
            with os.fdopen(terminal, "wb"), os.fdopen(user, "rb") as stdin:  # a terminal, but nobody sits at it
                checked = subprocess.run(command, env=environment, stdin=stdin, check=False, timeout=100)
            del environment["CI"]
            piped = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, check=False, timeout=100)
            assert (checked.returncode, piped.returncode) == (0, 0)
        finally:
            xvfb.terminate()


def test_without_a_display_a_window_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(DisplayError, match="DISPLAY is not set"):
        BulletWorld("GUI")
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(DisplayError, match="no X server answers"):
        BulletWorld("GUI")
