"""A plan that hangs, and was ended from outside: it runs again up to there, and Ctrl-C stops it where it hangs."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
from typing import TYPE_CHECKING

import pytest

import replay
from replay.retrace.retrace import retrace

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.slow

PLAN = """\
import sys
from pathlib import Path
from pycram.bullet_world import BulletWorld, Object
from pycram.language import par
world = BulletWorld()
milk = Object("milk", "milk", "milk.stl")
def hangs():
    turns = 0
    Path("hangs").write_text("x")
    while True:
        turns += 1
par(lambda: None, hangs) if sys.argv[1:] else hangs()
"""


def hung(folder: Path, *arguments: str, ended_by: signal.Signals) -> Path:
    """The recording of a plan that hangs; a pipe beside it tells each time that it comes to do so."""
    (folder / "hung.py").write_text(PLAN)
    os.mkfifo(folder / "hangs")
    command = [sys.executable, "-m", "pycram", "run", "hung.py", "--seed", "1", "--", *arguments]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL) as plan:
        (folder / "hangs").read_text()
        plan.send_signal(ended_by)
    return folder / "hung.mcap"


@pytest.mark.costly
def test_ctrl_c_stops_a_plan_where_it_hangs(tmp_path: Path, debug: Callable[..., list[str]]) -> None:
    file = hung(tmp_path, ended_by=signal.SIGINT)
    with replay.open(file) as log:
        end = len(log) - 1  # to which it never comes
        result = retrace(log)
    assert result.identical
    assert result.equal == end

    def interrupt() -> None:
        (tmp_path / "hangs").read_text()
        os.kill(os.getpid(), signal.SIGINT)

    person = threading.Thread(target=interrupt)
    person.start()
    stopped, turns, before, again = debug(file, "p turns > 0", "rstep", "step", step="last")
    person.join()
    assert f"--KeyboardInterrupt--\nstep {end - 1} of" in stopped
    assert "hung.py(10)hangs()\n-> while True:" in stopped or "hung.py(11)hangs()\n-> turns += 1" in stopped
    assert turns == "True\n"
    assert before.startswith(f"step {end - 2} of")
    assert again.startswith(f"step {end - 1} of")
    assert "hung.py(6)<module>()" in again, "at the record, not where it hangs after that"


def test_a_plan_that_hung_in_a_branch_and_was_killed_is_retraced_to_its_last_record(tmp_path: Path) -> None:
    with replay.open(hung(tmp_path, "branch", ended_by=signal.SIGKILL)) as log:
        result = retrace(log)
        assert result.identical
        assert result.equal == len(log)


def test_a_plan_that_hangs_ends_with_whoever_has_it_retraced(tmp_path: Path) -> None:
    file = hung(tmp_path, ended_by=signal.SIGINT)
    other = tmp_path / "other.py"
    other.write_text(
        'import os\nfrom pathlib import Path\nPath("hangs").write_text(str(os.getpid()))\nwhile True:\n    pass\n'
    )
    command = [sys.executable, "-m", "replay", "retrace", file, "--plan", other]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as retracing:
        plan = os.pidfd_open(int((tmp_path / "hangs").read_text()))
        retracing.kill()
    assert select.select([plan], (), (), 60)[0]
    os.close(plan)
