"""What copies of a live plan cost, and what it costs to run one again: ratios within one run, printed."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path
from struct import pack, unpack
from typing import TYPE_CHECKING

import pytest

from pycram.projection import project_all
from pycram.projection.child import Child, die_with
from recorder.tracing import forking, journal
from tests.benchmarks.timing import amount, goal, ratio, seconds

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.bullet_world import BulletWorld

pytestmark = pytest.mark.slow

REPO = Path(__file__).parents[2]
NO_LIMIT = float("inf")  # where other processes of the machine have their say


def megabytes(process: int) -> float:
    """Memory of a process; of what it shares with others its part."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1000


def checkpoint(costs: int) -> None:
    """Copy this process as the debugger does: it waits, and its child goes on. What it cost, in s, goes to a pipe."""
    parent, start = os.getpid(), time.process_time()
    child = forking.fork_continuation()
    if child:
        os.write(costs, pack("d", time.process_time() - start))
        os.waitpid(child, 0)
        os._exit(0)
    die_with(parent)


def test_checkpoints_of_a_live_plan(scene: BulletWorld) -> None:
    """Copies that wait, as at the debugger's prompt, each at another moment: the plan goes on between them.

    Time is that of page tables: 4 to 7 ms for each 100 MB, of which each physics client of PyBullet takes 31, and 0.2 ms for
    each copy before it. Memory is that of the pages of 4 kB that are written to until the next copy. A step of physics writes
    to 1.9 MB in this scene, the first one or the hundredth: of each of its 166 links a few numbers, on nearly three pages.
    Python's own part of a fork writes to 0.9 MB. The rest is the code around them, as Python 3.11 counts references in
    functions, names and types that are all over its memory: three quarters of those pages come out the same. Tried in vain:
    malloc for Python's objects (half as much again), an arena of its own for the engine, large blocks apart.

    These copies have nothing but this to do. The debugger's, which compare records and answer, take 6 MB each in such a
    plan; in one that asks the world between, as the table-setting demo, 14 (``test_debugging.py``).
    """
    milk, count = scene.get_object("milk"), amount(20, 5)
    step = seconds(lambda: scene.engine.step(20)) / 20
    reading, writing = os.pipe()

    def plan() -> bytes:
        journal.open_journal(journal.Journal([journal.NullSink()]))  # the debugger keeps no records either
        processes = [os.getppid(), os.getpid()]
        before = sum(map(megabytes, processes))
        for number in range(count):
            checkpoint(writing)
            processes.append(os.getpid())
            milk.set_position([1.3, 1, 1 + number / 100])
            scene.simulate(0.1)
        costs = [unpack("d", os.read(reading, 8))[0] for _ in range(count)]
        each = (sum(map(megabytes, processes)) - before) / count
        os.write(writing, pack("2d", statistics.median(costs), each))
        os._exit(0)

    child = Child(plan)
    os.close(writing)
    while not child.ended:
        child.read()
    fork, each = unpack("2d", os.read(reading, 16))
    os.close(reading)
    print(f"\na checkpoint of the full scene: {fork * 1e3:.1f} ms ({fork / step:.1f} steps), {each:.1f} MB")
    goal("a checkpoint, ms", fork * 1e3, 10, room=NO_LIMIT)
    goal("a checkpoint, MB", each, 5, room=2)


def test_two_projections_at_once(scene: BulletWorld) -> None:
    def clock(until: Callable[[], object]) -> float:
        start = time.perf_counter()
        until()
        return time.perf_counter() - start

    candidates = [(scene.simulate, amount(480, 60) / 240)] * 2
    cores = os.sched_getaffinity(0)

    def one_after_another() -> None:
        for candidate in candidates:
            project_all([candidate])

    def at_once() -> None:
        project_all(candidates, "all")

    cost = ratio(lambda: clock(at_once), lambda: clock(one_after_another), rounds=3)
    print(f"\ntwo projections at once on {len(cores)} cores: {1 / cost:.2f} times as fast as one after another")
    goal("at once, of one after another", cost, 1 / 1.8, room=NO_LIMIT)


def children_seconds(*command: str | Path) -> float:
    """Processor time of a command, and of all that it starts."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", *command], cwd=REPO, check=True, capture_output=True, timeout=600)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


@pytest.mark.long
def test_retracing_the_demo_costs_little_more_than_running_it(tmp_path: Path) -> None:
    log = tmp_path / "demo.mcap"
    cost = ratio(
        lambda: children_seconds("replay", "retrace", log),
        lambda: children_seconds("pycram", "demo", "--log", log, "--overwrite", "--seed", "5"),
        rounds=3,
        most=1.2,
    )
    goal("retracing the demo, of running it", cost, 1.2, room=2)
