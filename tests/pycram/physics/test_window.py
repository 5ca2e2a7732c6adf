"""PyBullet's window: on a screen of its own, or refused without one."""

from __future__ import annotations

import os
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


def test_without_a_display_a_window_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(DisplayError, match="DISPLAY is not set"):
        BulletWorld("GUI")
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(DisplayError, match="no X server answers"):
        BulletWorld("GUI")
