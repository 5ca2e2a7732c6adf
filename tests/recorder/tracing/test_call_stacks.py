"""Each task records the plan's whole call stack that led to it, in any thread."""

from __future__ import annotations

import inspect
import itertools
import subprocess
import sys
import threading
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import tasks
from pycram.language import par, try_in_order
from recorder.records import Task
from recorder.tracing.call_stack import MAX_LINES
from recorder.tracing.span import span
from replay.cli.main import main
from replay.history.blame import blame
from replay.history.source import PlanSource
from replay.history.tasks import causing_tasks

if TYPE_CHECKING:
    from pathlib import Path


PLAN = """
from pycram.bullet_world import BulletWorld, Object
import helpers

def tidy(ball):
    helpers.put(ball, 2)

BulletWorld(name="lab")
ball = Object("ball", "ball", "apple.stl")
tidy(ball)
"""
HELPERS = """
from recorder.tracing.span import span

def put(ball, height):
    with span("motion", "put"):
        ball.set_position([0, 0, height])
"""


def do(name: str) -> None:
    with span("motion", name), span("process-module", name.title()):
        pass


def do_again(name: str, times: int) -> None:
    if times:
        do_again(name, times - 1)
        return
    do(name)


def do_in_block(name: str) -> None:
    with par as block:
        block(do, name)


def functions(file: Path, name: str) -> list[str]:
    """The functions of a task's call stack, outermost first, from the test's on."""
    with replay.open(file) as log:
        record = next(record for record in log.records(Task) if record.name == name and record.phase == Task.STARTED)
        names = [line.function for line in PlanSource(log).call_stack(record)]
    return list(itertools.dropwhile(lambda name: not name, names))  # what runs the tests in many processes


def test_a_call_stack_is_recorded_from_the_outside_in(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file, source=__file__):
        do_again("push", 0)
    here = inspect.currentframe().f_code.co_name
    assert functions(file, "push") == functions(file, "Push") == [here, "do_again", "do"]


def test_a_recursive_line_stands_once(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file, source=__file__):
        do_again("push", 200)
    here = inspect.currentframe().f_code.co_name
    assert functions(file, "push") == [here, "do_again", "do_again", "do"]


def test_a_branch_continues_the_call_stack_of_the_code_that_asked_for_it(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file, source=__file__):
        do_in_block("push")
        with par as outer:
            outer(do_in_block, "pull")
        with par, try_in_order as inner:
            inner(do, "kick")
    here = inspect.currentframe().f_code.co_name
    assert functions(file, "push") == [here, "do_in_block", "do"]
    assert functions(file, "pull") == [here, "do_in_block", "do"]
    assert functions(file, "kick") == [here, "do"]


def test_a_lambda_stands_once_where_its_line_asks_for_it(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file, source=__file__), par as block:
        block(lambda: do("push"))
    here = inspect.currentframe().f_code.co_name
    assert functions(file, "push") == [here, "do"]


def start_in_block(name: str) -> None:
    with par as block:
        block.start(name, lambda: None)


def test_a_named_branch_has_the_call_stack_of_the_line_that_starts_it(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file, source=__file__):
        start_in_block("push")
    here = inspect.currentframe().f_code.co_name
    assert functions(file, "push") == [here, "start_in_block"]


def test_a_thread_of_the_plan_s_own_begins_a_new_call_stack(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file, source=__file__), span("motion", "outer"):
        thread = threading.Thread(target=do, args=("push",))
        thread.start()
        thread.join()
    assert functions(file, "push") == ["do"]


def test_a_long_call_stack_is_truncated_in_the_middle(tmp_path: Path) -> None:
    steps = [(f"def step_{number}():\n    step_{number + 1}()\n") for number in range(100)]
    (tmp_path / "plan.py").write_text("".join(steps) + "def step_100():\n    do('push')\n")
    plan: dict[str, object] = {"do": do, "__name__": "plan"}
    exec(compile((tmp_path / "plan.py").read_text(), str(tmp_path / "plan.py"), "exec"), plan)
    with recorder.record(tmp_path / "x.mcap", source=__file__):
        plan["step_0"]()
    names = functions(tmp_path / "x.mcap", "push")
    assert MAX_LINES - 5 < len(names) <= MAX_LINES
    assert names[:4] == [inspect.currentframe().f_code.co_name, "step_0", "step_1", "step_2"]
    assert names[-3:] == ["step_99", "step_100", "do"]


def test_without_a_recording_a_task_knows_its_innermost_line_only() -> None:
    do_again("unseen", 0)
    (node,) = tasks.tree().find(name="unseen")[-1:]
    assert __file__ in node.source
    assert not node.started.callers


@pytest.fixture
def ran(tmp_path: Path) -> Path:
    """A recording of a plan with a module of its own, which is gone then."""
    for name, text in (("plan.py", PLAN), ("helpers.py", HELPERS)):
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-m", "pycram", "run", "plan.py", "--log", "x.mcap"]
    subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)
    for name in ("plan.py", "helpers.py"):
        (tmp_path / name).unlink()
    return tmp_path / "x.mcap"


@pytest.mark.slow
def test_modules_of_the_plan_s_own_are_attached(ran: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with replay.open(ran) as log:
        explained = blame(log, "ball").causes
        assert explained == causing_tasks(log, blame(log, "ball").record)
        assert [(line.function, line.text) for line in explained.call_stack] == [
            ("<module>", "tidy(ball)"),
            ("tidy", "helpers.put(ball, 2)"),
            ("put", "ball.set_position([0, 0, height])"),
        ]
    assert main(["blame", str(ran), "ball"]) == 0
    output = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in output[3:6]] == ["from", "called", "called"]
    assert output[-1].endswith("in <module>:  tidy(ball)")


def test_files_of_one_name_are_not_confused(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        plan = tmp_path / folder / "same.py"
        plan.write_text(f"# {folder}\ndef push():\n    do('{folder}')\n")
    with recorder.record(tmp_path / "x.mcap", source=__file__):
        for folder in ("a", "b"):
            file = tmp_path / folder / "same.py"
            names: dict[str, object] = {"do": do, "__name__": "same"}
            exec(compile(file.read_text(), str(file), "exec"), names)
            names["push"]()
    with replay.open(tmp_path / "x.mcap") as log:
        assert PlanSource(log).text(str(tmp_path / "a" / "same.py")) == ""
