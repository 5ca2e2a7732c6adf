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


@pytest.fixture(params=["buffered", "unbuffered"])
def buffering(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors come where lines are printed, or where they are flushed."""
    monkeypatch.setenv("PYTHONUNBUFFERED", "1" if request.param == "unbuffered" else "")


def ended(*command: str, folder: Path, messages: bool = False) -> tuple[int, str]:
    """Run a command, whose messages nobody reads either if wanted; return its exit code, and the messages."""
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run(
            [sys.executable, "-m", *command],
            stdout=write,
            stderr=write if messages else subprocess.PIPE,
            text=True,
            cwd=folder,
            check=False,
        )
    finally:
        os.close(write)
    return done.returncode, done.stderr or ""


@pytest.mark.usefixtures("buffering")
@pytest.mark.parametrize(
    "command",
    [
        ("pycram", "--version"),
        ("pycram", "run", "--help"),
        ("pycram", "run", "--explore", "2", "plan.py"),
        ("pycram", "describe", "pr2.urdf"),
        ("replay", "--version"),
        ("replay", "log", "--help"),
        ("replay", "log", str(GOLDEN)),
    ],
    ids=" ".join,
)
def test_a_command_whose_output_is_read_no_more_ends_well(command: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "plan.py").write_text("")
    assert ended(*command, folder=tmp_path) == (0, "")


@pytest.mark.usefixtures("buffering")
@pytest.mark.parametrize("messages", [False, True])
def test_a_plan_whose_output_is_read_no_more_runs_to_its_end(messages: bool, tmp_path: Path) -> None:
    """Its recording has every line, and its exit code is its own."""
    (tmp_path / "plan.py").write_text(PLAN)
    code, said = ended("pycram", "run", "plan.py", "--", "a", "b", folder=tmp_path, messages=messages)
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
