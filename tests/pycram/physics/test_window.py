"""PyBullet's window: on a screen of its own, or refused without one."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest

from pycram.bullet_world import BulletWorld
from pycram.failures import DisplayError

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


@pytest.mark.needs("Xvfb", "OpenGL")
@pytest.mark.slow
def test_a_window_opens_and_simulates_as_without_one(display: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PLAN],
        env=os.environ | {"DISPLAY": display},
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert ended.returncode == 0, ended.stderr
    assert "PyBullet has one window" in ended.stdout
    # the window's native thread greets on stdout too, whenever it likes
    assert "the same as without a window: True" in ended.stdout
    assert ended.stdout.rstrip().endswith("ended")


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
        assert any("'s window stays until it is closed" in line for line in process.stderr)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


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
