"""Tests that ``pycram-replay test`` writes: they fail as the run did, and pass when the plan is mended."""

from __future__ import annotations

import ast
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path

PLAN = """from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import pick_up, place

WHERE = [0.5, 0.2, 8.3]

with BulletWorld() as world:
    world.set_gravity([0, 0, -9.8])
    Object("plain floor", "environment", "plane.urdf")
    Object("table", "environment", "table.urdf")
    world.robot = robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 0.72])
    (arm,) = robot.description.arms
    robot.set_joint_positions(robot.description.arm(arm).posture("park"))
    milk = Object("milk", "milk", "milk.stl", [0.5, -0.2, 0.83])
    world.settle()
    perform(pick_up(object=milk, arm=arm))
    perform(place(object=milk, target=WHERE, arm=arm))
"""


def recorded(folder: Path, text: str) -> Path:
    plan, log = folder / "stacks.py", folder / "run.mcap"
    plan.write_text(text)
    command = [sys.executable, "-m", "pycram", "run", str(plan), "--seed", "3", "--log", str(log), "--overwrite"]
    subprocess.run(command, capture_output=True, check=False)
    return log


def passes(test: Path) -> bool:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(test)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode in (0, 1), ended.stdout + ended.stderr
    return ended.returncode == 0


@pytest.mark.slow
def test_it_passes_when_the_plan_is_mended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = recorded(tmp_path, PLAN)
    monkeypatch.chdir(tmp_path)
    assert main(["test", str(log)]) == 0
    test = tmp_path / "test_stacks.py"
    assert "run_plan('stacks.py', seed=3)" in test.read_text()
    (tmp_path / "stacks.py").write_text(PLAN.replace("8.3", "0.83"))
    assert passes(test)
    assert main(["test", str(log)]) == 2  # an existing test is kept


@pytest.mark.costly
@pytest.mark.slow
def test_the_moment_before_a_motion_is_built_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = recorded(tmp_path, PLAN)
    monkeypatch.chdir(tmp_path)
    assert main(["test", str(log), "failure", "-o", "test_moment.py"]) == 0
    test = tmp_path / "test_moment.py"
    text = test.read_text()
    ast.parse(text)
    assert "perform(place(object=milk, target=[0.5, 0.2, 8.3]" in text
    assert "ur5.attach(milk, link=" in text  # the milk is in the hand
    assert "table_top =" not in text
    test.write_text(text.replace("8.3", "0.83"))
    assert passes(test)
    assert main(["test", str(log), "1", "-o", "x.py"]) == 2
    assert not (tmp_path / "x.py").exists()


@pytest.mark.costly
@pytest.mark.slow
def test_a_property_that_did_not_hold_is_asserted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(tmp_path, PLAN.replace("8.3", "0.83"))
    assert main(["test", str(log), "-o", str(tmp_path / "test_it.py")]) == 2
    assert "--holds" in capsys.readouterr().err
    assert main(["test", str(log), "-o", str(tmp_path / "test_it.py"), "--holds", "always milk.y < 0.1"]) == 0


@pytest.mark.slow
def test_a_property_of_a_block_isn_t_asserted_of_the_whole_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = (
        "from pycram import monitored\nfrom pycram.bullet_world import BulletWorld, Object\n"
        "with BulletWorld():\n    cup = Object('cup', 'cup', 'cup.stl', [0, 0, 2])\n    cup.set_position([0, 0, 1])\n"
        "    with monitored('always cup.z < 1.5'):\n        cup.set_position([0, 0, 2])\n"
    )
    log = recorded(tmp_path, plan)
    monkeypatch.chdir(tmp_path)
    assert main(["test", str(log)]) == 0
    test = tmp_path / "test_stacks.py"
    assert not passes(test)
    (tmp_path / "stacks.py").write_text(
        plan.replace("2])\n", "1])\n").replace("[0, 0, 1])\n    cup", "[0, 0, 2])\n    cup")
    )
    assert passes(test)  # the cup begins higher, before the block
