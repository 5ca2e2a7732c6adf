"""The demos and the command line, run as processes, and what they record."""

from __future__ import annotations

import ast
import json
import math
import os
import re
import runpy
import shlex
import subprocess
import sys
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.cli import main as pycram_command
from pycram.failures import ReasoningError
from pycram.world.overlaps import Overlapping
from recorder import geometry
from recorder.records import Mutation, Query, Run, Task
from recorder.tasks import State
from replay.cli.main import main as replay_command

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.conftest import DemoRun

REPO = Path(__file__).parent.parent
GOALS = {"milk": [-0.8, 1, 0.93], "bowl": [-0.8, 1.2, 0.9], "cereal": [-1, 1, 0.94], "spoon": [-0.8, 1.2, 0.94]}


def pycram(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pycram", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env={"PYTHONPATH": str(REPO), "PATH": "/usr/bin:/bin", "PYCRAM_CACHE": os.environ["PYCRAM_CACHE"]},
    )


@pytest.mark.slow
def test_the_demo_sets_the_table_and_records_it(demo_run: Callable[[str], DemoRun]) -> None:
    ended = demo_run("set_the_table")
    assert ended.returncode == 0, ended.stderr
    assert "the table is set" in ended.stdout
    assert [file.name for file in ended.folder.iterdir()] == ["set_the_table.mcap"]
    assert "set_the_table.mcap" in ended.stderr.splitlines()[-1]
    shown = (REPO / "README.md").read_text().partition("$ pycram demo\n")[2].partition("```")[0].splitlines()
    printed = [*ended.stdout.splitlines(), *ended.stderr.splitlines()]
    size = re.compile(r"\d+\.\d MB")
    assert [size.sub("", line) for line in shown] == [size.sub("", line) for line in printed], "README shows it"
    with replay.open(ended.folder / "set_the_table.mcap") as log:
        assert log.complete
        closing = next(r.seq for r in log.records(Mutation) if r.WhichOneof("command") == "close_world")
        world = log.state_at(closing - 1).world()
        for name, goal in GOALS.items():
            body = world.body(name)
            assert math.dist(body.position, goal) < 0.03, name
            upward = geometry.rotate(body.orientation, (0.0, 0.0, 1.0))
            assert upward[2] > math.cos(math.radians(5)), f"{name} has fallen over"
            assert math.hypot(*body.velocity[:3]) < 0.01, f"{name} is still moving"
        assert not world.attachments
        drawer = world.body("kitchen").joints["sink_area_left_upper_drawer_main_joint"]
        assert drawer == pytest.approx(0.3, abs=1e-3)
        last = log[-1]
        assert isinstance(last, Run)
        assert last.succeeded
        asked = next(record for record in log.records(Query) if record.name == "blocking")
        assert [found["object"] for found in json.loads(asked.answer_json)] == ["bowl"]
        attached = [r.attach_body.body for r in log.records(Mutation) if r.WhichOneof("command") == "attach_body"]
        assert attached == ["bowl", "milk", "cereal", "spoon"], "what blocks goes first"


ON_TABLE = {
    "milk": [0.45, 0.4, 0.82],
    "bowl": [0.5, 0.15, 0.75],
    "cereal": [0.3, 0.45, 0.84],
    "spoon": [0.5, 0.15, 0.78],
}


@pytest.mark.costly
@pytest.mark.parametrize(("robot", "goals"), [("tiago_pro", GOALS), ("panda", ON_TABLE), ("ur5", ON_TABLE)])
def test_every_robot_in_the_box_sets_the_table(tmp_path: Path, robot: str, goals: dict[str, list[float]]) -> None:
    ended = pycram("demo", "--robot", robot, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    file = tmp_path / "set_the_table.mcap"
    with replay.open(file) as log:
        closing = next(r.seq for r in log.records(Mutation) if r.WhichOneof("command") == "close_world")
        world = log.state_at(closing - 1).world()
        for name, goal in goals.items():
            body = world.body(name)
            assert math.dist(body.position, goal) < 0.03, name
            assert geometry.rotate(body.orientation, (0.0, 0.0, 1.0))[2] > math.cos(math.radians(5)), name
        assert not world.attachments
        assert world.robot == robot
        stable = [json.loads(record.answer_json) for record in log.records(Query) if record.name == "stable"]
        assert stable == [True] * 4
    assert replay_command(["verify", str(file)]) == 0


@pytest.mark.costly
def test_a_place_is_reached_in_another_posture_if_no_path_leads_to_the_best_ones(tmp_path: Path) -> None:
    ended = pycram("demo", "--motion", "continuous", "--seed", "21", cwd=tmp_path)  # beside the bowl, with the left arm
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "robot", ["panda", *(pytest.param(robot, marks=pytest.mark.long) for robot in ("ur5", "pr2", "tiago_pro"))]
)
def test_every_robot_in_the_box_sets_a_breakfast_as_far_as_it_can(tmp_path: Path, robot: str) -> None:
    ended = pycram("demo", "breakfast", "--robot", robot, "--seed", "1", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    lacking = [line for line in ended.stdout.splitlines() if "in its description" in line]
    assert ended.stdout.splitlines()[: len(lacking)] == lacking, "before it begins"
    bolted = robot in {"panda", "ur5"}
    assert ["no base that drives" in line for line in lacking] == ([True, False] if bolted else [])
    assert ["no second arm" in line for line in lacking] == ([False, True] if bolted else [])
    with replay.open(tmp_path / "breakfast.mcap") as log:
        assert log.complete
        closing = next(r.seq for r in log.records(Mutation) if r.WhichOneof("command") == "close_world")
        world = log.state_at(closing - 1).world()
        set_there = {"spoon": True, "cereal": True, "bowl": False, "milk": False}
        for name, there in set_there.items():
            body = world.body(name)
            x, y, z = body.position
            assert z > 0.5, f"{name} has fallen off"  # the fridge begins there
            assert (y > 0 if bolted else x < -0.6) == there, name
            if name != "spoon":
                assert geometry.rotate(body.orientation, (0.0, 0.0, 1.0))[2] > math.cos(math.radians(10)), name
        assert not world.attachments
        if not bolted:
            assert world.body("kitchen").joints["iai_fridge_door_joint"] == pytest.approx(0, abs=0.02)
            handed = [
                task for task in log.records(Task) if task.name == "handing-over" and task.status == Task.SUCCEEDED
            ]
            assert handed


def test_the_plan_of_the_breakfast_has_no_pose() -> None:
    tree = ast.parse((REPO / "demos" / "breakfast.py").read_text())
    plan = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    for name in ("bring", "breakfast"):
        numbers = [each.value for each in ast.walk(plan[name]) if isinstance(each, ast.Constant)]
        assert [value for value in numbers if isinstance(value, int | float)] in ([], [2]), "2 digits are printed"


@pytest.mark.parametrize(
    ("blocks", "circle"),
    [
        ({"milk": "bowl", "bowl": "milk"}, "milk and bowl"),
        ({"milk": "bowl", "bowl": "cereal", "cereal": "bowl"}, "bowl and cereal"),
    ],
)
def test_things_that_block_each_other_end_the_plan(
    scene: BulletWorld, blocks: dict[str, str], circle: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = runpy.run_path(str(REPO / "demos" / "set_the_table.py"))["move_object"].__globals__

    def blocking(body: Object, *_: object) -> list[Object]:
        return scene.get_objects_by_type(blocks[body.type])

    monkeypatch.setitem(names, "go", lambda _: None)  # what is in whose way is the point, not where it lies
    monkeypatch.setitem(names, "find", lambda known: known)
    monkeypatch.setattr(names["btr"], "blocking", blocking)
    with pytest.raises(ReasoningError, match=f"^{circle} block each other, so none can be cleared away first$"):
        names["move_object"]("milk", scene.get_object("kitchen"))


def test_a_demo_that_has_one_robot_takes_no_other(tmp_path: Path) -> None:
    ended = pycram("demo", "fails_to_reach", "--robot", "panda", cwd=tmp_path)
    assert ended.returncode == 2
    assert "--robot is only for the demos breakfast and set_the_table" in ended.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_failing_demo_records_its_failure(demo_run: Callable[[str], DemoRun]) -> None:
    ended = demo_run("fails_to_reach")
    assert ended.returncode == 1
    assert all(f"{arm} arm can't reach" in ended.stderr for arm in ("left", "right"))
    with replay.open(ended.folder / "fails_to_reach.mcap") as log:
        assert log.complete
        failed = [r for r in log.records(Task) if r.status == Task.FAILED]
        assert {r.failure.type for r in failed} == {"Unreachable"}
        assert all(r.failure.traceback and r.failure.data for r in failed)
        last = log[-1]
        assert isinstance(last, Run)
        assert not last.succeeded
        assert last.failure.type == "Unreachable"
        (handling,) = log.tree().roots
        assert [dict(attempt.parameters)["arm"] for attempt in handling.attempts] == ["left", "right"] * 2
        assert {attempt.status for attempt in handling.attempts} == {State.FAILED}


@pytest.mark.slow
def test_run_records_any_plan_with_its_arguments(tmp_path: Path) -> None:
    plan = tmp_path / "plan.py"
    plan.write_text(
        "import sys\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        "world = BulletWorld()\n"
        "Object('thing', 'thing', sys.argv[1])\n"
        "assert __name__ == '__main__'\n"
    )
    ended = pycram("run", "plan.py", "--log", "out.mcap", "--", "cup.stl", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    with replay.open(tmp_path / "out.mcap") as log:
        assert log.metadata["plan_arguments"] == "cup.stl"
        assert any(name.endswith("/plan.py") for name in log.assets)
        assert list(log.state_at(-1).world().bodies) == ["thing"]


@pytest.mark.parametrize(
    ("code", "exit_code", "message"),
    [
        ("raise SystemExit(3)", 3, ""),
        ("from pycram.bullet_world import *\nwith BulletWorld() as w: w.set_gravity([1])", 1, "3 finite numbers"),
        ("1 / 0", 1, "ZeroDivisionError"),
        ("raise SystemExit(['a', 'list'])", 1, "['a', 'list']"),
        ("class Own(BaseException): pass\nraise Own('of its own')", 1, "Own: of its own"),
        ("import os; os.chdir('/')", 0, ""),
        ("def x(", 1, "SyntaxError"),
    ],
)
@pytest.mark.slow
def test_run_exits_with_the_code_of_the_plan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], code: str, exit_code: int, message: str
) -> None:
    (tmp_path / "plan.py").write_text(code)
    with chdir(tmp_path):
        assert pycram_command(["run", "plan.py"]) == exit_code
    said = capsys.readouterr().err
    assert message in said
    assert "pycram: recorded to plan.mcap" in said
    with replay.open(tmp_path / "plan.mcap") as log:
        assert log.complete
    for line in said.splitlines():
        if line.startswith("  pycram-replay"):  # what it says to type next works
            _, *words = shlex.split(line, comments=True)
            words += ["--save", "plan.rrd"] if words[0] == "view" else []  # there is no screen to open it on
            with chdir(tmp_path):
                assert replay_command(words) == 0, line
            assert capsys.readouterr().out, line


@pytest.mark.slow
def test_the_process_exits_with_the_code_of_the_command(tmp_path: Path) -> None:
    (tmp_path / "plan.py").write_text("raise SystemExit(3)")
    ended = pycram("run", "plan.py", cwd=tmp_path)
    assert ended.returncode == 3
    assert "pycram: recorded to plan.mcap" in ended.stderr


@pytest.mark.slow
def test_threads_that_outlive_the_main_thread_are_recorded(tmp_path: Path) -> None:
    (tmp_path / "plan.py").write_text(
        "import threading\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        "world = BulletWorld()\n"
        "def late():\n"
        "    Object('late', 'thing', 'cup.stl')\n"
        "threading.Timer(0.2, late).start()\n"
    )
    assert pycram("run", "plan.py", cwd=tmp_path).returncode == 0
    with replay.open(tmp_path / "plan.mcap") as log:
        assert list(log.state_at(-1).world().bodies) == ["late"]


@pytest.mark.slow
def test_a_recording_that_cannot_be_written_stops_the_plan(tmp_path: Path) -> None:
    (tmp_path / "plan.py").write_text("print('ran unrecorded')")
    ended = pycram("run", "plan.py", "--log", "nowhere/out.mcap", cwd=tmp_path)
    assert ended.returncode == 2
    assert "nowhere/out.mcap" in ended.stderr
    assert "No such file" in ended.stderr
    assert "ran unrecorded" not in ended.stdout


@pytest.mark.slow
def test_the_plan_works_with_the_positions_of_the_thesis() -> None:
    """Listing 5.1: spoon and bowl overlap when they are loaded, and everything falls onto the counter."""
    demo = runpy.run_path(str(REPO / "demos" / "set_the_table.py"))
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        world.robot = Object("pr2", "robot", "pr2.urdf")
        kitchen = Object("kitchen", "environment", "kitchen.urdf")
        Object("milk", "milk", "milk.stl", [1.3, 1, 1])
        Object("spoon", "spoon", "spoon.stl", [1.4, 0.8, 1])
        Object("cereal", "cereal", "breakfast_cereal.stl", [1.3, 0.6, 1])
        with pytest.warns(Overlapping, match="bowl is .* inside of spoon"):
            Object("bowl", "bowl", "bowl.stl", [1.3, 0.8, 1])
        assert world.settle(timeout=5)
        demo["set_table"](kitchen)
        for name, (target, _) in demo["TARGETS"].items():
            assert math.dist(world.get_object(name).get_position()[:2], target[:2]) < 0.02, name
