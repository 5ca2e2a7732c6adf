"""What a run of the same plan that succeeded did otherwise."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.running import RunSpec, run
from replay.cli.main import main
from replay.explain.good_run import good_run

if TYPE_CHECKING:
    from pathlib import Path

PLAN = """
import pycram
from pycram.bullet_world import BulletWorld, Object
from pycram.bullet_world_reasoning import stable
from pycram.failures import PlanFailure

z = pycram.parameters(z=0.05).z
with BulletWorld() as world:
    world.set_gravity([0, 0, -9.81])
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", "milk.stl", [1, 0, 0.1])
    world.settle()
    x, y, rest = milk.get_position()
    milk.set_position([x, y, rest + z])
    for _ in range(2):
        if stable(milk):
            break
    else:
        milk.set_position([5, 0, rest])
    if milk.get_position()[0] > 3:
        raise PlanFailure("the milk is far away")
"""


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    plan = tmp_path / "shelf.py"
    plan.write_text(PLAN)
    for name, z in (("good", 0.0), ("bad", 0.3)):
        run(RunSpec(plan, parameters={"z": z}, seed=1), tmp_path / f"{name}.mcap")
    return tmp_path


def test_why_says_where_the_good_run_went_on_otherwise(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(runs / "bad.mcap")]) == 0
    text = capsys.readouterr().out
    beside = text.split("Compared with good.mcap, where the plan succeeded\n")[1].split("\n\n")[0]
    assert "both runs called the same lines up to shelf.py:16 (step " in beside
    assert "before it, stable(object=milk) was answered no at step" in beside
    assert "there it was answered yes at step" in beside
    assert "this run went on with shelf.py:16" in beside
    assert "the good run ended" in beside
    assert main(["why", str(runs / "bad.mcap"), "--json"]) == 0
    good = json.loads(capsys.readouterr().out)["good_run"]
    assert good["file"] == "good.mcap"
    assert good["last"]["line"] == 16
    assert [each["here"]["answer"] for each in good["answers"]] == [False]


def test_edits_since_the_good_run_are_listed(runs: Path) -> None:
    plan = runs / "shelf.py"
    (runs / "good.mcap").unlink()
    plan.write_text(PLAN.replace("rest + z]", "rest]").replace("    world.settle()\n", ""))
    run(RunSpec(plan, parameters={"z": 0.3}, seed=1), runs / "edited.mcap")
    with replay.open(runs / "bad.mcap") as log:
        good = good_run(log, log.why())
    assert good is not None
    assert list(good.lines()) == [
        "shelf.py:12 was edited: a new line -> world.settle()",
        "shelf.py:14 was edited: milk.set_position([x, y, rest]) -> milk.set_position([x, y, rest + z])",
    ]


def test_without_a_good_run_of_the_plan_there_is_no_comparison(runs: Path) -> None:
    other = runs / "other.py"
    other.write_text("print('nothing')\n")
    (runs / "good.mcap").unlink()
    run(RunSpec(other), runs / "other.mcap")
    (runs / "broken.mcap").write_bytes(b"no recording")
    with replay.open(runs / "bad.mcap") as log:
        assert good_run(log, log.why()) is None
