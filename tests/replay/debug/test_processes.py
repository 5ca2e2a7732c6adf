"""The processes of a debugged plan end with the prompt, however that ends; deadlines don't pass while one thinks."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import psutil
import pytest

import replay
from replay.debug.guided_plan import GuidedPlan, PlanEnded
from replay.debug.stopped_plan import PausableClock
from replay.retrace.plan_process import PlanProcess
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from pathlib import Path

_TIMEOUT = 600.0  # s, on a busy machine


def prompt_of(log: Path, step: int) -> subprocess.Popen[bytes]:
    """A prompt that waits for its first command."""
    command = [sys.executable, "-m", "replay", "debug", str(log), str(step)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    read = b""
    while not read.endswith(b"(debug) "):
        read += process.stdout.read(1)
    return process


@pytest.mark.slow
@pytest.mark.parametrize("killed", [True, False], ids=["killed", "left"])
def test_no_process_outlives_the_prompt(plan_log: Path, *, killed: bool) -> None:
    with replay.open(plan_log) as log:
        prompt = prompt_of(log.path, len(log) - 4)
    others = psutil.Process(prompt.pid).children(recursive=True)
    assert len(others) > 2, "copies wait at steps before"
    ends = [os.pidfd_open(each.pid) for each in others]
    if killed:
        prompt.kill()
        prompt.wait()
    else:
        prompt.communicate(b"rs\nrs\nn\nq\n", timeout=_TIMEOUT)
        assert not any(psutil.pid_exists(each.pid) for each in others), "none is left as a zombie"
    for end in ends:
        assert select.select([end], (), (), _TIMEOUT)[0]
        os.close(end)
    for stream in (prompt.stdin, prompt.stdout):
        assert stream is not None
        stream.close()


@pytest.mark.slow
def test_a_plan_that_is_killed_is_told_and_run_again(plan_log: Path) -> None:
    with replay.open(plan_log) as log, GuidedPlan(PlanProcess(log)) as plan:
        plan.go(20)
        for each in psutil.Process().children(recursive=True):
            each.send_signal(signal.SIGKILL)
        with pytest.raises(PlanEnded):
            plan.ask("where")
        assert plan.go(12).step == 12
        assert plan.ask("where")
        assert plan.copies.runs == 2


DEADLINE = """\
import time
from pycram.bullet_world import BulletWorld
from pycram.language import timeout
world = BulletWorld()
began = time.monotonic()
with timeout(5):
    world.set_gravity([0, 0, -1])
    world.set_gravity([0, 0, -2])
assert time.monotonic() - began < 5
"""


def test_clocks_stand_still_while_a_plan_does(monkeypatch: pytest.MonkeyPatch) -> None:
    real = time.monotonic
    for name in ("time", "monotonic", "perf_counter"):
        monkeypatch.setattr(time, name, getattr(time, name))
        monkeypatch.setattr(time, f"{name}_ns", getattr(time, f"{name}_ns"))
    clock = PausableClock()
    clock.install()
    before, began = time.monotonic(), real()
    with clock.paused():
        while real() < began + 0.05:
            pass
    assert time.monotonic() - before < real() - began - 0.04
    assert time.perf_counter_ns() > 0
    assert time.time() > 1e9


@pytest.mark.slow
def test_a_deadline_does_not_pass_at_the_prompt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "plan.py"
    file.write_text(DEADLINE.replace("5", "0.4"))
    with replay.open(record(file)) as log, GuidedPlan(PlanProcess(log)) as plan:
        assert log[-1].succeeded
        within = next(each.seq for each in log if each.task)
        plan.go(within)
        until = time.monotonic() + 0.5
        while time.monotonic() < until:  # somebody thinks
            plan.ask("where")
        assert plan.go(len(log) - 1).reason == "step"
