"""What copies of a live plan cost, and what it costs to run one again: ratios within one run, printed."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram.projection import project_all
from tests.benchmarks.timing import amount, goal, ratio, warm_up

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.bullet_world import BulletWorld

pytestmark = pytest.mark.slow

REPO = Path(__file__).parents[2]
NO_LIMIT = float("inf")  # where other processes of the machine have their say


def cost_of_copies(count: int) -> dict[str, float]:
    """What a copy of a plan takes that is in a process of its own."""
    command = [sys.executable, "-m", "tests.benchmarks.waiting_copies", str(count)]
    ended = subprocess.run(command, cwd=REPO, capture_output=True, text=True, check=True, timeout=600)
    cost: dict[str, float] = json.loads(ended.stdout.splitlines()[-1])
    return cost


def test_checkpoints_of_a_live_plan() -> None:
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
    warm_up(lambda: cost_of_copies(1))  # meshes are converted
    cost = cost_of_copies(amount(40, 5))
    print(f"\na checkpoint of the full scene: {cost['ms']:.1f} ms, {cost['MB']:.2f} MB")
    goal("a checkpoint, ms", cost["ms"], 10, room=NO_LIMIT)
    goal("a checkpoint, MB", cost["MB"], 5, room=2)


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
