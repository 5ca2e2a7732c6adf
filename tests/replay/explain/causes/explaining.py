"""Runs plans that fail, for the tests of why they did."""

from __future__ import annotations

from textwrap import dedent
from typing import TYPE_CHECKING

import replay
from pycram.bullet_world import BulletWorld
from pycram.running import RunSpec, run
from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from replay.explain.why import Why


START = """
    import os, signal
    from pycram import bullet_world_reasoning as btr
    from pycram.bullet_world import BulletWorld, Object
    from pycram.failures import PlanFailure
    from pycram.fluent import Fluent
    from pycram.language import par, timeout
    world = BulletWorld(name="lab")
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
"""


WITH_PR2 = """
        from pycram.designator import MotionDesignator
        from pycram.process_module import ProcessModule
        def perform(**slots):
            slots = [(name.replace("_", "-"), value) for name, value in slots.items()]
            return ProcessModule.perform(MotionDesignator(slots))
        robot = world.robot = Object("pr2", "robot", "pr2.urdf")
        milk = Object("milk", "milk", "milk.stl", [7, 0, 0.1])
        tool = "l_gripper_tool_frame"
"""


def explain(folder: Path, text: str, code: int = 1) -> Why:
    """Runs a plan with these lines behind START, and explains why it failed; it ends with this exit code."""
    file = folder / "plan.py"
    file.write_text(dedent(START) + dedent(text))
    assert executed(file) == code
    with replay.open(folder / "x.mcap") as log:
        return log.why()


def executed(file: Path) -> int:
    """Run a plan, close the worlds that it left open, and return its exit code."""
    code = run(RunSpec(file), file.parent / "x.mcap")
    while BulletWorld.current_bullet_world is not None:
        BulletWorld.current_bullet_world.exit()
    return code


def line_of(tmp_path: Path, text: str) -> int:
    return next(n for n, line in enumerate((tmp_path / "plan.py").read_text().splitlines(), 1) if text in line)


def words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    main(["why", str(tmp_path / "x.mcap")])
    return capsys.readouterr().out
