"""What copies of a live plan cost, and what it costs to run one again: ratios within one run, printed."""

from __future__ import annotations

import os
import resource
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
from pycram.projection import project_all
from pycram.projection.child import Child
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


def pause() -> bytes:
    signal.pause()
    return b""


def test_checkpoints_of_a_live_plan(scene: BulletWorld, tmp_path: Path) -> None:
    """Paused copies, each of another moment: the plan goes on between them.

    Time is that of page tables: 5 to 7 ms for each 100 MB, of which each physics client of PyBullet takes 31. Memory is that of
    the pages that change: 2.4 MB by the child until it is paused, of which Python itself changes 1.3, 2.3 MB by a step
    of physics in this scene, the first one or the hundredth, and 2 MB by the code around it, as Python 3.11 counts references
    in the objects. Half of these pages come out the same. Garbage collection isn't why: none made no difference.
    """
    milk, count = scene.get_object("milk"), amount(20, 5)
    children: list[Child] = []
    forks: list[float] = []
    try:
        with recorder.record(tmp_path / "run.mcap"):
            step = seconds(lambda: scene.engine.step(20)) / 20
            before = megabytes(os.getpid())
            for number in range(count):
                forks.append(seconds(lambda: children.append(Child(pause))))
                milk.set_position([1.3, 1, 1 + number / 100])
                scene.simulate(0.1)
            after = megabytes(os.getpid()) + sum(megabytes(child.pid) for child in children)
    finally:
        for child in children:
            child.kill()
    fork = statistics.median(forks)
    each = (after - before) / count
    print(f"\na checkpoint of the full scene: {fork * 1e3:.1f} ms ({fork / step:.1f} steps), {each:.1f} MB")
    goal("a checkpoint, ms", fork * 1e3, 10, room=NO_LIMIT)
    goal("a checkpoint, MB", each, 8)


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
