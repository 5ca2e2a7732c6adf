"""What it costs a plan to be recorded and watched, as ratios within one run: ``make bench`` prints the table.

The viewer and what feeds it are processes of their own. So two things are told apart: the processor time of the plan's own
process, which others on the machine don't change and which is what counts where cores are free; and its wall time, in
which the others show where cores are few. A viewer without a graphics card draws with all cores that it finds; therefore
there is one that only takes what it gets, and one that draws.
"""

from __future__ import annotations

import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import rerun_cli

import recorder
from recorder.viewer.audience import address, answers
from replay.cli import main
from tests.benchmarks.test_reading import write

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demos"))

import set_the_table

pytestmark = pytest.mark.slow

BINARY = str(Path(rerun_cli.__file__).with_name("rerun"))
ROUNDS = 3


@contextmanager
def viewer(*options: str) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """How to connect to a viewer, and its process."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [BINARY, *options, "--port", str(port), "--bind", "127.0.0.1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        pause, deadline = threading.Event(), time.monotonic() + 30
        while not answers(address(port)):
            assert time.monotonic() < deadline
            pause.wait(0.05)
        yield address(port), process
    finally:
        process.kill()
        process.wait()


@dataclass
class Cost:
    """Seconds that the demo took: of its process, by the clock, what its end took of that, and what feeding the viewer took."""

    processor: float
    wall: float
    end: float
    feeding: float


def children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def demo(file: Path | None = None, live: str | None = None) -> Cost:
    """The whole demo: loading, the plan, closing the recording."""
    processor, wall, feeding = time.process_time(), time.perf_counter(), children()
    with ExitStack() as recording:
        recording.enter_context(redirect_stdout(StringIO()))
        if file is not None:
            recording.enter_context(recorder.record(file, live))
        set_the_table.main()
        planned = time.perf_counter()
    end = time.perf_counter()
    return Cost(time.process_time() - processor, end - wall, end - planned, children() - feeding)


def least(costs: list[Cost], what: Callable[[Cost], float]) -> float:
    """The smallest: noise only adds."""
    return min(map(what, costs))


@pytest.mark.parametrize(
    "options",
    [["--serve-grpc"], pytest.param(["--headless"], marks=pytest.mark.long)],
    ids=["a viewer that takes", "a viewer that draws"],
)
def test_a_demo_that_is_recorded_and_watched(tmp_path: Path, options: list[str]) -> None:
    demo()  # what is made once: files laid out, code compiled
    with viewer(*options) as (url, _):
        pairs = [(demo(), demo(tmp_path / f"{i}.mcap", url)) for i in range(ROUNDS)]
    bare, watched = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    processor = least(watched, lambda cost: cost.processor) / least(bare, lambda cost: cost.processor)
    wall = least(watched, lambda cost: cost.wall - cost.end) / least(bare, lambda cost: cost.wall)
    print(f"\n{options[0]}: the demo, recorded and watched, against neither")
    print(f"processor time of its process: {processor:.2f}; by the clock, up to the plan's end: {wall:.2f}")
    print(f"its end takes {least(watched, lambda cost: cost.end):.2f} s more, feeding the viewer", end=" ")
    print(f"{least(watched, lambda cost: cost.feeding):.2f} s of another core")
    assert processor < 1.5  # 1.15 is the goal, for both; cores that are shared with others need room
    assert wall < 4  # and say little by the clock


@pytest.mark.long
@pytest.mark.parametrize("fault", ["absent", "stopped", "killed"])
def test_a_viewer_that_fails_costs_two_seconds_at_most(tmp_path: Path, fault: str) -> None:
    demo()
    bare, costs = [], []
    for i in range(2):
        bare.append(demo())
        with viewer("--serve-grpc") as (url, process):
            if fault == "absent":
                process.kill()
                process.wait()
            else:
                hurt = {"stopped": signal.SIGSTOP, "killed": signal.SIGKILL}[fault]
                threading.Timer(bare[0].wall / 2, process.send_signal, [hurt]).start()
            costs.append(demo(tmp_path / f"{i}.mcap", url))
    end = max(cost.end for cost in costs)
    processor = least(costs, lambda cost: cost.processor) / least(bare, lambda cost: cost.processor)
    print(f"\na viewer that is {fault}: the plan's process {processor:.2f}, its end takes {end:.2f} s more")
    assert processor < 1.5  # with its recording
    assert end < 2.5  # 2 is the goal


CONVERTER = """
import pathlib, sys, time
import replay
from replay.view import convert

start = time.perf_counter()
with replay.open(sys.argv[1]) as log:
    convert([log], pathlib.Path(sys.argv[2]))
print(time.perf_counter() - start, time.process_time())
# the peak of this process; getrusage would tell that of its parent, if it is larger
print(int(pathlib.Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1e6)
"""


def converted(log: Path, file: Path) -> tuple[float, float, float]:
    """Seconds by the clock, seconds of the processors, and GB that a conversion takes in a process of its own."""
    command = [sys.executable, "-c", CONVERTER, str(log), str(file)]
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    wall, processor, memory = map(float, told.stdout.split())
    return wall, processor, memory


def test_a_recording_opens_in_a_viewer_that_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    demo(log := tmp_path / "demo.mcap")
    with viewer("--headless") as (url, _):
        start = time.perf_counter()
        assert main(["view", str(log), "--connect", url]) == 0
        first = time.perf_counter() - start
        start = time.perf_counter()
        assert main(["view", str(log), "--connect", url, "--at", "100"]) == 0
        again = time.perf_counter() - start
    with capsys.disabled():
        print(f"\nview of the demo in an open viewer: {first:.2f} s, again {again:.2f} s")
    assert first < 15  # 5 is the goal; the viewer draws with the processor here


@pytest.mark.parametrize("count", [20_000, pytest.param(1_000_000, marks=pytest.mark.long)])
def test_long_recordings_are_translated(tmp_path: Path, count: int) -> None:
    log = tmp_path / "long.mcap"
    write(log, count)
    wall, processor, memory = converted(log, tmp_path / "long.rrd")
    print(f"\n{count} records: {wall:.1f} s ({processor:.1f} s of the processors), {memory:.2f} GB", end=" ")
    print(f"{wall / count * 1e6:.0f} us a record, {(tmp_path / 'long.rrd').stat().st_size / 1e6:.0f} MB")
    assert processor < 4 + 150e-6 * count  # 60 s for a million is the goal
    assert memory < 1.0
