"""A thread of the plan's own that fails stops no plan; its recording tells it."""

from __future__ import annotations

import json
import threading
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.failures import PlanFailure
from pycram.running import RunSpec, run
from recorder.records import Run
from recorder.tracing.span import span
from replay.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path

PLAN = """
import threading
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from recorder.tracing.span import span

def lift(ball):
    with span("motion", "lift"):
        raise PlanFailure("the ball slipped")

with BulletWorld(name="lab"):
    ball = Object("ball", "ball", "apple.stl")
    for work in (lambda: ball.set_position([0, 0, float("nan")]), {second}):
        helper = threading.Thread(target=work, name=f"helper {{threading.active_count()}}")
        helper.start()
        helper.join()
    ball.set_position([0, 0, 1])
"""


@pytest.fixture
def quiet(monkeypatch: pytest.MonkeyPatch) -> list[threading.ExceptHookArgs]:
    """What Python would print of threads that fail."""
    failures: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", failures.append)
    return failures


def recorded(second: str, tmp_path: Path) -> Path:
    (tmp_path / "plan.py").write_text(PLAN.format(second=second))
    assert run(RunSpec(tmp_path / "plan.py"), tmp_path / "x.mcap") == 0
    return tmp_path / "x.mcap"


def test_why_reports_a_failed_thread_with_the_plan_s_line(
    quiet: list[threading.ExceptHookArgs], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = recorded("int", tmp_path)
    assert len(quiet) == 1
    with replay.open(file) as log:
        why = log.why()
        (failed,) = [record for record in log.records(Run) if record.phase == Run.THREAD_FAILED]
        assert (why.step, why.task, why.thread) == (failed.seq, None, failed.thread)
        assert log.step("failure") == failed.seq
        assert [line.text for line in why.exceptions[-1].lines] == [
            'for work in (lambda: ball.set_position([0, 0, float("nan")]), int):'
        ]
    assert main(["why", str(file)]) == 0
    output = capsys.readouterr().out
    assert output.startswith("plan succeeded, although its thread helper ")
    assert "failed: BadArgument: position = [0, 0, nan]" in output.splitlines()[0]
    assert main(["info", str(file)]) == 0
    assert "failed: BadArgument" in capsys.readouterr().out
    assert main(["verify", str(file)]) == 0


def test_an_equal_failure_after_a_thread_ended_is_not_its_cause(
    quiet: list[threading.ExceptHookArgs], tmp_path: Path
) -> None:
    failure = PlanFailure("the ball slipped")

    def lift(name: str) -> None:
        with span("motion", name):
            raise failure

    with recorder.record(tmp_path / "x.mcap"):
        helper = threading.Thread(target=lift, args=("in the thread",))
        helper.start()
        helper.join()
        with pytest.raises(PlanFailure):
            lift("afterwards")
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.why().task.started.name == "in the thread"
    assert len(quiet) == 1


def test_a_thread_s_failure_is_traced_to_its_task(
    quiet: list[threading.ExceptHookArgs], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = recorded("lambda: lift(ball)", tmp_path)
    with replay.open(file) as log:
        why = log.why()
        assert why.task.started.name == "lift"
        assert log.tree().began == why.task.started.task
        assert [record.failure.type for record in why.failed_threads] == ["BadArgument"]
    assert len(quiet) == 2
    assert main(["why", str(file)]) == 0
    assert "also failed: thread helper " in capsys.readouterr().out
    assert main(["why", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["thread"].startswith("helper ")


def fail_twice(file: Path) -> None:
    with recorder.record(file):
        helper = threading.Thread(target=throw, args=[PlanFailure("the thread")])
        helper.start()
        helper.join()
        with span("motion", "go"):
            throw(PlanFailure("the plan"))


def test_a_plan_s_own_failure_comes_first(quiet: list[threading.ExceptHookArgs], tmp_path: Path) -> None:
    with pytest.raises(PlanFailure, match="the plan"):
        fail_twice(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
    assert (why.failure.message, why.thread) == ("the plan", "")
    assert [record.failure.message for record in why.failed_threads] == ["the thread"]
    assert len(quiet) == 1


def test_each_recording_has_a_thread_s_failure_once_and_restores_the_hook(
    quiet: list[threading.ExceptHookArgs], tmp_path: Path
) -> None:
    before = threading.excepthook
    with recorder.record(tmp_path / "outer.mcap"), recorder.record(tmp_path / "inner.mcap"):
        for ending in (PlanFailure("gone"), SystemExit()):
            helper = threading.Thread(target=throw, args=[ending])
            helper.start()
            helper.join()
    assert threading.excepthook is before
    for name in ("outer", "inner"):
        with replay.open(tmp_path / f"{name}.mcap") as log:
            assert [record.failure.message for record in log.records(Run) if record.phase == Run.THREAD_FAILED] == [
                "gone"
            ]
    assert len(quiet) == 2


def throw(error: BaseException) -> None:
    raise error


def test_an_error_without_message_is_recorded_with_its_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.py").write_text(
        "class Odd(Exception):\n    def __str__(self):\n        raise RuntimeError\n\nraise Odd\n"
    )
    assert run(RunSpec(tmp_path / "plan.py"), tmp_path / "x.mcap") == 1
    assert "recorded to" in capsys.readouterr().err
    with replay.open(tmp_path / "x.mcap") as log:
        assert [line.text for line in log.why().exceptions[-1].lines] == ["raise Odd"]
