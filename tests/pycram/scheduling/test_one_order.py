"""One order: drawn from the run's seed, the same in any process and under any load; what the clock decides is on record."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import in_thread, par, seq, timeout
from pycram.scheduling.cancellation import checkpoint
from pycram.scheduling.schedule import scheduler, seed_order
from recorder.records import Task
from tests.measures import seeded
from tests.pycram.scheduling.random_orders import digest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.conftest import MemorySink

REPO = Path(__file__).parents[3]
LETTERS = "abcd"


@pytest.fixture(autouse=True)
def _unseeded() -> Iterator[None]:
    yield
    seed_order(None)


def order_of(seed: int | None) -> str:
    """The order in which four branches take three turns each."""
    turns: list[str] = []

    def take(name: str) -> None:
        for _ in range(3):
            checkpoint()
            turns.append(name)

    seed_order(seed)
    with par as s:
        for name in LETTERS:
            s(take, name)
    return "".join(turns)


def test_the_order_is_drawn_from_the_seed_and_is_first_come_first_served_without_one() -> None:
    assert order_of(None) == order_of(None) == LETTERS * 3
    orders = [order_of(seed) for seed in range(20)]
    assert orders == [order_of(seed) for seed in range(20)]
    assert len(set(orders)) > 15
    assert {order[0] for order in orders} == set(LETTERS)  # any branch may be the first


def test_what_must_stay_in_order_does_in_every_order(world: BulletWorld) -> None:
    cup = Object("cup", "cup", "cup.stl")
    for seed in range(20):
        seed_order(seed)
        seen: list[int] = []
        with par as s:
            for start in (0, 10):
                with seq as t:
                    for number in range(start, start + 3):
                        t(cup.set_position, [0, 0, number])
                        t(seen.append, number)
            s(cup.set_position, [0, 0, 100])
        assert [n for n in seen if n < 10] == [0, 1, 2]
        assert [n for n in seen if n >= 10] == [10, 11, 12]


def test_the_plan_s_own_random_numbers_are_not_drawn_from() -> None:
    import random  # noqa: PLC0415  only here

    random.seed(7)
    expected = random.random()
    random.seed(7)
    order_of(7)
    assert random.random() == expected


def started(order: int, plans: range, hash_seed: int) -> subprocess.Popen[str]:
    """A process that runs plans in the order of a seed, and prints the digests of their records."""
    script = [sys.executable, "-m", "tests.pycram.scheduling.random_orders", str(order), *map(str, plans)]
    environment = os.environ | {"PYTHONHASHSEED": str(hash_seed)}
    return subprocess.Popen(script, cwd=REPO, stdout=subprocess.PIPE, text=True, env=environment)


def output(process: subprocess.Popen[str]) -> str:
    printed = process.communicate(timeout=500)[0]
    assert process.returncode == 0
    return printed


PLANS = 50


@pytest.mark.costly
@seeded("one order a seed: runs of random plans", range(5 * PLANS), 10)
def test_random_plans_make_the_same_records_in_any_process_under_any_load(
    seeds: range, record_property: Callable[[str, object], None]
) -> None:
    """Each plan in four processes: two of them alone, and two at once beside another that keeps the machine busy."""
    order, plans = seeds[0] // PLANS, range(seeds[0] % PLANS, seeds[-1] % PLANS + 1)
    outputs = [output(started(order, plans, hash_seed)) for hash_seed in (0, 1)]
    busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        loaded = [started(order, plans, hash_seed) for hash_seed in (2, 3)]
        outputs += [output(process) for process in loaded]
    finally:
        busy.kill()
        busy.wait()
    assert len(set(outputs)) == 1
    digests = [line.split()[1] for line in outputs[0].splitlines()]
    assert len(set(digests)) == len(plans)
    record_property("runs", len(outputs) * len(plans))


@pytest.mark.slow
def test_another_seed_makes_other_records() -> None:
    assert digest(3, 1).lines == digest(3, 1).lines
    assert len({digest(3, seed).hash.hexdigest() for seed in range(6)}) > 3


def tasks_of(sink: MemorySink, kind: str) -> list[Task]:
    return [task for task in sink.of(Task) if task.kind == kind and task.phase == Task.FINISHED]


def test_what_the_clock_and_workers_decide_is_recorded_where_it_struck(sink: MemorySink) -> None:
    now, never, release = scheduler(), Fluent(0), threading.Event()

    def waits() -> None:
        for _ in range(5):
            checkpoint()
        with pytest.raises(PlanFailure), timeout(0.02):
            (never > 0).wait_for()

    before = now.checkpoints
    with par as s:
        s(waits)
        s((never > 0).wait_for, 0.01)
        s(in_thread, release.wait, 60)
        s(release.set)
    (late,), (worker,) = tasks_of(sink, "timeout"), tasks_of(sink, "in-thread")
    assert before + 5 < late.checkpoint <= now.checkpoints
    assert before < worker.checkpoint <= now.checkpoints
    assert worker.result_json == "true"
    (waited,) = [task for task in tasks_of(sink, "wait") if task.status == Task.SUCCEEDED]
    assert before < waited.checkpoint <= now.checkpoints
    assert (Fluent(1) == 1).wait_for(60)
    assert tasks_of(sink, "wait")[-1].checkpoint == 0  # the seed knows it
    with pytest.raises(PlanFailure), timeout(0):
        time.monotonic()
    assert tasks_of(sink, "timeout")[-1].checkpoint == now.checkpoints
