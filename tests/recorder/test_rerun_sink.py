"""Live viewing: a real viewer's server gets the records; one that stalls costs the plan nothing."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import recorder
import replay

REPO = Path(__file__).parent.parent.parent
PLAN = """
import sys, time
import recorder
from pycram.bullet_world import BulletWorld, Object
start = time.monotonic()
with recorder.record(sys.argv[1], live=sys.argv[2]):
    with BulletWorld() as world:
        body = Object("milk", "milk", "milk.stl")
        for i in range(2000):
            body.set_position([0.001 * i, 0, 0])
print("done")
"""


def run(file: Path, url: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", PLAN, str(file), url], cwd=REPO, capture_output=True, text=True, check=False, timeout=60
    )


def test_nobody_listens(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with (
        pytest.raises(recorder.RecordingError, match="no viewer answers"),
        recorder.record(tmp_path / "x.mcap", live=f"rerun+http://127.0.0.1:{port}/proxy"),
    ):
        pass


@pytest.mark.slow
def test_a_viewer_that_never_answers_costs_nothing(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as stalled:
        port = stalled.getsockname()[1]
        ended = run(tmp_path / "x.mcap", f"rerun+http://127.0.0.1:{port}/proxy")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == "done\n"
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.complete
        assert len(log) > 2000


@pytest.mark.slow
def test_a_real_viewer_gets_the_records(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    live = tmp_path / "live.rrd"
    command = [sys.executable, "-m", "rerun", "--save", str(live), "--port", str(port), "--expect-data-soon"]
    # in a session of its own: the command is a wrapper, and signals to it don't reach the server below
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)
    try:
        deadline = time.monotonic() + 30
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), timeout=1).close()
                break
            except OSError:
                assert time.monotonic() < deadline, "the viewer's server didn't start"
        ended = run(tmp_path / "x.mcap", f"rerun+http://127.0.0.1:{port}/proxy")
        assert ended.returncode == 0, ended.stderr
        while not live.exists() or live.stat().st_size < 20_000:
            assert time.monotonic() < deadline, "nothing arrived"
    finally:
        os.killpg(viewer.pid, signal.SIGKILL)
        viewer.wait()
    assert b"milk" in live.read_bytes() or live.stat().st_size > 20_000
