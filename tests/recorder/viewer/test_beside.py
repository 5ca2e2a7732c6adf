"""Recordings that are shown together with a recording: the fork of a run, and projections."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import replay
from replay.cli.main import main
from tests.recorder.viewer.shown import Shown, in_world, small

if TYPE_CHECKING:
    from pathlib import Path

PLAN = """
from pycram.bullet_world import BulletWorld, Object
from pycram.projection import project

world = BulletWorld(name="w")
cup = Object("cup", "cup", "cup.stl", [0, 0, 1])

def lift(height):
    cup.set_position([0, 0, height])
    if height > 5:
        raise RuntimeError("too high")

project(lift, 4)
project(lift, 6)
cup.set_position([0, 0, 2])
world.exit()
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("beside")
    (folder / "plan.py").write_text(PLAN)
    command = [sys.executable, "-m", "pycram", "run", "--log", folder / "run.mcap", folder / "plan.py"]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return folder / "run.mcap"


def heights(file: Shown, root: str) -> set[float]:
    """Where the cup of a recording is at any step."""
    last = max(moment[0] for rows in file.rows.values() for moment, _ in rows)
    frames = [file.frames(step) for step in range(last + 1)]
    found = [in_world(each, f"{root}/w//cup", f"{root}/world") for each in frames if f"{root}/w//cup" in each]
    return {round(position[2], 3) for position, _ in found}


@pytest.mark.slow
def test_what_was_imagined_stands_beside_the_run(run: Path, tmp_path: Path) -> None:
    assert main(["view", str(run), "--imagined", "--save", str(tmp_path / "all.rrd")]) == 0
    file = Shown(tmp_path / "all.rrd")
    assert heights(file, "run") == {1.0, 2.0}
    assert 4.0 in heights(file, "run.projection-1")
    assert 6.0 in heights(file, "run.projection-2")


@pytest.mark.slow
def test_tree_and_log_say_what_was_foreseen_and_where(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tree", str(run)]) == 0
    first, second = (line for line in capsys.readouterr().out.splitlines() if "projection" in line)
    assert "lift(4) projection" in first or "lift" in first
    assert ": it would succeed; see run.projection-1.mcap" in first
    assert ": it would fail: RuntimeError: too high; see run.projection-2.mcap" in second
    with replay.open(run) as log:
        step = next(record.seq for record in log.records() if "projection-2" in getattr(record, "result_json", ""))
    assert main(["show", str(run), str(step)]) == 0
    assert ": it would fail: RuntimeError: too high; see run.projection-2.mcap" in capsys.readouterr().out


def test_a_run_that_imagined_nothing_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = small(tmp_path / "log.mcap")
    assert main(["view", str(log), "--imagined", "--save", str(tmp_path / "x.rrd")]) == 2
    assert "its folder has no recordings of its projections" in capsys.readouterr().err


@pytest.mark.slow
def test_a_fork_stands_beside_its_parent(run: Path, tmp_path: Path) -> None:
    plan = tmp_path / "edited.py"
    plan.write_text(PLAN.replace("[0, 0, 2]", "[0, 0, 3]"))
    with replay.open(run) as log:
        last = max(record.seq for record in log.records() if "projection" in getattr(record, "kind", ""))
    fork = tmp_path / "run.fork.mcap"
    assert main(["fork", str(run), "--at", str(last), "--plan", str(plan), "-o", str(fork)]) == 0
    assert main(["view", str(run), str(fork), "--save", str(tmp_path / "both.rrd")]) == 0
    file = Shown(tmp_path / "both.rrd")
    assert heights(file, "run") == {1.0, 2.0}
    assert heights(file, "run.fork") == {1.0, 3.0}
