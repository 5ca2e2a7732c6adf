"""Plans that end otherwise than they should, in processes of their own: their recordings are sound."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Mutation
from replay.cli.main import main
from replay.restore.verify import verify

if TYPE_CHECKING:
    from pathlib import Path

    from replay.restore.verify import Verification

pytestmark = pytest.mark.usefixtures("nothing_left")

BEGIN = """
import signal, sys, threading
import recorder
from pycram.bullet_world import BulletWorld, Object
from pycram.language import failure_handling, par, seq, try_in_order
from recorder.tracing.span import span

up = threading.Event()

def watch():
    with span("plan", "watching"):
        up.set()
        threading.Event().wait()
"""

WORKER_IS_ABANDONED = """
import os
from pycram.scheduling.worker import in_thread

def press():
    up.wait()
    os.kill(os.getpid(), signal.SIGINT)

with recorder.record(FILE), BulletWorld(), seq:
    threading.Thread(target=press).start()
    in_thread(watch)
"""

THREAD_GOES_ON = """
def begin():
    threading.Thread(target=watch, daemon=True).start()
    up.wait()

with recorder.record(FILE), BulletWorld(), par as block:
    block(begin)
    block(lambda: signal.raise_signal(signal.SIGINT))
"""

BLOCKS_WITHOUT_END = """
def nested(depth, milk):
    with seq:
        milk.set_position([depth, 0, 1])
        nested(depth + 1, milk)
"""

BRANCHES_WITHOUT_END = """
def nested(depth, milk):
    milk.set_position([depth % 9, 0, 1])
    if depth % 3 == 0:
        with par as s:
            s(nested, depth + 1, milk)
            s(milk.set_position, [0, 0, 1])
    elif depth % 3 == 1:
        for attempt in failure_handling(1):
            with attempt:
                nested(depth + 1, milk)
    else:
        with try_in_order as s:
            s(nested, depth + 1, milk)
"""

NESTING = """
with recorder.record(FILE), BulletWorld() as world:
    milk = Object("milk", "milk", "milk.stl")
    sys.setrecursionlimit(LIMIT)
    try:
        nested(0, milk)
    finally:
        sys.setrecursionlimit(1000)
"""


def recorded_by(plan: str, file: Path, **values: object) -> subprocess.CompletedProcess[str]:
    given = "".join(f"{name} = {value!r}\n" for name, value in values.items())
    program = f"FILE = {str(file)!r}\n{given}{BEGIN}{plan}"
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.slow
@pytest.mark.parametrize(
    "plan",
    [
        pytest.param(WORKER_IS_ABANDONED, id="worker"),
        pytest.param(THREAD_GOES_ON, id="daemon thread", marks=pytest.mark.slow),
    ],
)
def test_a_thread_s_task_that_outlives_a_plan_after_ctrl_c_is_no_damage(plan: str, tmp_path: Path, capfd) -> None:
    file = tmp_path / "run.mcap"
    assert recorded_by(plan, file).returncode == -signal.SIGINT
    with replay.open(file) as log:
        verification = verify(log)
    assert verification.exact, verification
    assert verification.unfinished == 1
    assert main(["verify", str(file)]) == 0
    assert "1 of them unfinished" in capfd.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("limit", [200, *(pytest.param(limit, marks=pytest.mark.slow) for limit in (201, 203))])
def test_a_plan_that_ends_in_a_recursion_error_is_sound(limit: int, tmp_path: Path) -> None:
    verification, changes = verified_after_recursion_error(BLOCKS_WITHOUT_END, limit, tmp_path / "run.mcap")
    assert verification.tasks - changes in (0, 1)  # of the innermost block perhaps only the change was refused


@pytest.mark.costly
def test_branches_within_each_other_without_end_end_in_a_recursion_error(tmp_path: Path) -> None:
    verified_after_recursion_error(BRANCHES_WITHOUT_END, 200, tmp_path / "run.mcap")


def verified_after_recursion_error(plan: str, limit: int, file: Path) -> tuple[Verification, int]:
    assert "RecursionError" in recorded_by(plan + NESTING, file, LIMIT=limit).stderr
    with replay.open(file) as log:
        verification = verify(log)
        changes = sum(1 for record in log.records(Mutation) if record.HasField("move_body"))
    assert verification.exact, verification
    assert verification.unfinished == 0
    assert changes >= 3
    return verification, changes
