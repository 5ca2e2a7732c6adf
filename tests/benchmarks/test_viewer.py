"""What it costs a plan to be recorded and watched, as ratios within one run: ``make bench`` prints the table.

The viewer and what feeds it are processes of their own. So two things are measured apart: the processor time of the plan's own
process, which is what counts where cores are free; and its wall time, in which the others show where cores are few, or
are halves of one. So there is a third run, beside a process that does nothing but compute on another core, which is
what that alone costs on this machine. A viewer without a graphics card draws with all cores that it finds; therefore there is one
that only takes what it gets, and one that draws. Both are as polite as one that ``--rerun`` starts.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import rerun_cli

import recorder
from recorder.viewer.connection import address, answers
from replay.cli.main import main
from tests.benchmarks.test_reading import write
from tests.benchmarks.timing import amount, goal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demos"))

import set_the_table

pytestmark = pytest.mark.slow

BINARY = str(Path(rerun_cli.__file__).with_name("rerun"))
GOAL = 1.15  # of the demo without recording and viewer
ROUNDS, PATIENCE = 3, 6
POLITE = ["nice", "-n", "10"]  # as what feeds the viewer, and the viewer that it starts


@contextmanager
def viewer(*options: str) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """How to connect to a viewer, and its process."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [*POLITE, BINARY, *options, "--port", str(port), "--bind", "127.0.0.1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        pause, deadline = threading.Event(), time.monotonic() + 100
        while not answers(address(port)):
            assert time.monotonic() < deadline
            pause.wait(0.05)
        yield address(port), process
    finally:
        process.kill()
        process.wait()


@dataclass
class Cost:
    """Seconds that the demo took: of its process, by the clock up to the plan's end, and then until it was closed."""

    processor: float
    planned: float
    end: float


def demo(file: Path | None = None, live: str | None = None) -> Cost:
    """The whole demo: loading, the plan, closing the recording."""
    processor, start = time.process_time(), time.perf_counter()
    with ExitStack() as recording:
        recording.enter_context(redirect_stdout(StringIO()))
        if file is not None:
            recording.enter_context(recorder.record(file, live))
        set_the_table.main()
        planned = time.perf_counter()
    return Cost(time.process_time() - processor, planned - start, time.perf_counter() - planned)


def least(costs: list[Cost], what: Callable[[Cost], float]) -> float:
    """The smallest: noise only adds."""
    return min(map(what, costs))


@contextmanager
def busy_core() -> Iterator[None]:
    """A process that computes."""
    process = subprocess.Popen([*POLITE, sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [["--serve-grpc"], pytest.param(["--headless"], marks=pytest.mark.needs("Vulkan driver"))],
    ids=["a viewer that takes", "a viewer that draws"],
)
def test_a_demo_that_is_recorded_and_watched(tmp_path: Path, options: list[str]) -> None:
    demo()  # what is made once: files laid out, code compiled
    bare, beside, watched = [], [], []
    processor = clock = float("inf")
    while len(bare) < ROUNDS or (max(processor, clock) > GOAL and len(bare) < PATIENCE):
        bare.append(demo())
        with busy_core():
            beside.append(demo())
        with viewer(*options) as (url, _):
            watched.append(demo(tmp_path / f"{len(bare)}.mcap", url))
        processor = least(watched, lambda cost: cost.processor) / least(bare, lambda cost: cost.processor)
        alone, shared, shown = (least(costs, lambda cost: cost.planned) for costs in (bare, beside, watched))
        clock = shown / alone
    print(f"\n{options[0]}: the demo, recorded and watched, against neither, in {len(bare)} rounds; goal {GOAL}")
    print(f"processor time of its process: {processor:.2f}")
    print(f"by the clock, up to the plan's end: {clock:.2f}; against one beside a busy core: {shown / shared:.2f}")
    print(f"its end takes {least(watched, lambda cost: cost.end):.2f} s more")
    goal("the plan's process, of one that is neither recorded nor watched", processor, GOAL)
    goal("the same by the clock", clock, GOAL, inf)  # a viewer that draws in software takes the plan's cores, too


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
                damaged = {"stopped": signal.SIGSTOP, "killed": signal.SIGKILL}[fault]
                threading.Timer(bare[0].planned / 2, process.send_signal, [damaged]).start()
            costs.append(demo(tmp_path / f"{i}.mcap", url))
    end = max(cost.end for cost in costs)
    processor = least(costs, lambda cost: cost.processor) / least(bare, lambda cost: cost.processor)
    print(f"\na viewer that is {fault}: the plan's process {processor:.2f}, its end takes {end:.2f} s more")
    goal("the plan's process, with its recording", processor, 1.2)
    goal("its end, s more", end, 2, inf)


CONVERTER = """
import os, pathlib, sys, time
import replay
from replay.view import convert

start = time.perf_counter()
with replay.open(sys.argv[1]) as log:
    convert([log], pathlib.Path(sys.argv[2]))
wall = time.perf_counter() - start
print(wall, sum(os.times()[:4]))
# getrusage would give the peak of the parent, if that is larger
print(int(pathlib.Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1e6)
"""


def converted(log: Path, file: Path) -> tuple[float, float, float]:
    """Seconds by the clock, seconds of the processors, and GB that a conversion takes, in a process of its own."""
    command = [sys.executable, "-c", CONVERTER, str(log), str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    wall, processor, memory = map(float, ended.stdout.split())
    return wall, processor, memory


@pytest.mark.long
@pytest.mark.needs("Vulkan driver")
def test_a_recording_opens_in_a_viewer_that_is_there(
    recorded_demo: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    log = recorded_demo("set_the_table")
    with viewer("--headless") as (url, _):
        start = time.perf_counter()
        assert main(["view", str(log), "--connect", url]) == 0
        first = time.perf_counter() - start
        start = time.perf_counter()
        assert main(["view", str(log), "--connect", url, "--at", "100"]) == 0
        again = time.perf_counter() - start
    with capsys.disabled():
        print(f"\nview of the demo in an open viewer: {first:.2f} s, again {again:.2f} s")
        goal("opening it, s", first, 5, inf)  # the viewer draws with the processor here


@pytest.mark.parametrize("count", [amount(20_000, 5_000), pytest.param(1_000_000, marks=pytest.mark.long)])
def test_long_recordings_are_translated(tmp_path: Path, count: int) -> None:
    log = tmp_path / "long.mcap"
    write(log, count)
    wall, processor, memory = converted(log, tmp_path / "long.rrd")
    print(f"\n{count} records: {wall:.1f} s ({processor:.1f} s of the processors), {memory:.2f} GB", end=" ")
    print(f"{wall / count * 1e6:.0f} us a record, {(tmp_path / 'long.rrd').stat().st_size / 1e6:.0f} MB")
    goal("translated, s of the processors", processor, 4 + 60e-6 * count, inf)
    assert memory < 1.0  # GB
