"""Commands whose output nobody reads to its end, as with `| head`, end well: no traceback, nothing lost."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import replay
from recorder.records import Output

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parent / "replay" / "golden" / "0.1.0.mcap"
LINES = 3000  # more than a pipe's buffer, and a stream's
PLAN = f"""
import sys
for number in range({LINES}):
    print("line", number, flush=number % 2 == 0)
sys.exit(len(sys.argv) - 1)
"""


def ended(*command: str, folder: Path, buffered: bool, messages: bool = False) -> tuple[int, str]:
    """Run a command, whose messages nobody reads either if wanted; return its exit code, and the messages.

    Errors come where lines are printed, or, if they are buffered, where they are flushed.
    """
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run(
            [sys.executable, "-m", *command],
            stdout=write,
            stderr=write if messages else subprocess.PIPE,
            text=True,
            cwd=folder,
            env=os.environ | {"PYTHONUNBUFFERED": "" if buffered else "1"},
            check=False,
        )
    finally:
        os.close(write)
    return done.returncode, done.stderr or ""


@pytest.mark.parametrize("buffered", [False, True])
@pytest.mark.parametrize(
    "command", [("pycram", "run", "--explore", "2", "plan.py"), ("replay", "log", str(GOLDEN))], ids=" ".join
)
def test_a_command_whose_output_is_read_no_more_ends_well(
    command: tuple[str, ...], buffered: bool, tmp_path: Path
) -> None:
    (tmp_path / "plan.py").write_text("")
    assert ended(*command, folder=tmp_path, buffered=buffered) == (0, "")


@pytest.mark.parametrize("command", ["pycram describe pr2.urdf", "pycram --version", "replay --version"])
def test_so_does_any_other(command: str, tmp_path: Path) -> None:
    assert ended(*command.split(), folder=tmp_path, buffered=False) == (0, "")


def test_so_does_help(tmp_path: Path) -> None:
    assert ended("pycram", "run", "--help", folder=tmp_path, buffered=True) == (0, "")


@pytest.mark.parametrize("messages", [False, True])
def test_a_plan_whose_output_is_read_no_more_runs_to_its_end(messages: bool, tmp_path: Path) -> None:
    """Its recording has every line, and its exit code is its own."""
    (tmp_path / "plan.py").write_text(PLAN)
    plan = ("pycram", "run", "plan.py", "--", "a", "b")
    code, said = ended(*plan, folder=tmp_path, buffered=not messages, messages=messages)
    assert code == 2
    assert "Traceback" not in said
    with replay.open(tmp_path / "plan.mcap") as log:
        lines = [record.text for record in log.records(Output)]
    assert lines == [f"line {number}" for number in range(LINES)]


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "pycram", "--version"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr) == (2, "pycram: [Errno 28] No space left on device\n")
