"""Smaller plans with the same failure."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from replay.cli.main import main
from tests.replay.fix.test_written_test import recorded

if TYPE_CHECKING:
    from pathlib import Path

PLAN = '''"""Looks at cups on a floor."""

import json
from pathlib import Path

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure

PLACES = {
    "red": [0.1, 0, 0.1],
    "green": [0.3, 0, 0.1],
    "blue": [0.5, 0, 0.1],
}


def load(names):
    cups = {}
    for name in names:
        cups[name] = Object(name, "cup", "cup.stl", PLACES[name])
        print(name, "stands there")
    return cups


def check(cup):
    # a comment
    height = cup.get_position()[2]
    if height < 0:
        print("below")
        raise PlanFailure(f"{cup.name} is at {height:.3f} m")


with BulletWorld() as world:
    world.set_gravity([0, 0, -9.8])
    Path("/").mkdir(exist_ok=True)  # has no effect
    plate = Object("plate", "plate", "plate.stl", [2, 0, 0.1])
    cups = load(["red", "blue"])
    print(json.dumps({}))
    cups["blue"].set_position([0, 0, -2])  # fails as well, but isn't the cause
    cups["blue"].set_position([0, 0, -3])
    try:
        for cup in cups.values():
            check(cup)
    finally:
        print("end")
    print("done")
'''


@pytest.mark.costly
def test_a_much_shorter_plan_fails_in_the_same_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = recorded(tmp_path, PLAN)
    (tmp_path / "stacks.py").write_text("raise SystemExit")  # the recorded source is made smaller
    monkeypatch.chdir(tmp_path)
    assert main(["minimise", str(log), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    small = tmp_path / "stacks_small.py"
    text = small.read_text()
    assert found["lines"][1] <= 0.6 * found["lines"][0]
    assert found["objects"] == [3, 2]
    for gone in ("plate", "print(", "comment", "json", "mkdir", "green", "-2"):
        assert gone not in text
    ended = subprocess.run([sys.executable, small], capture_output=True, text=True, check=False)
    assert "PlanFailure: blue is at -3.000 m" in ended.stderr
    assert main(["minimise", str(log)]) == 2  # it doesn't replace the file
    assert small.read_text() == text
    assert main(["minimise", str(log), "--budget", "12", "--overwrite"]) == 0
    assert "the search ended at --budget" in capsys.readouterr().out


@pytest.mark.slow
def test_a_plan_that_reaches_outside_or_succeeds_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outside = tmp_path.parent / "outside"
    reaching = PLAN.replace('    print("below")', f'    Path("{outside}").mkdir()').replace("height < 0", "height < 9")
    log = recorded(tmp_path, reaching)
    outside.rmdir()
    assert main(["minimise", str(log)]) == 2
    assert "the plan has effects outside of its folder: os.mkdir" in capsys.readouterr().err
    assert not outside.exists()
    log = recorded(tmp_path, PLAN.replace("height < 0", "False"))
    assert main(["minimise", str(log)]) == 2
    assert "the plan succeeded" in capsys.readouterr().err
