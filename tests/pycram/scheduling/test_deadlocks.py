"""A wait that nothing can end is a deadlock: it is raised immediately, with who waits where for what."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
import traceback
from typing import TYPE_CHECKING

import pytest

import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import DeadlockedBranches, PlanFailure
from pycram.fluent import Fluent
from pycram.fluents.world import contact
from pycram.language import finally_, par
from pycram.scheduling.cancellation import checkpoint
from pycram.scheduling.schedule import Scheduler, scheduler, seed_order
from recorder.tasks import State
from tests.measures import seeded
from tests.pycram.scheduling.random_waits import Waits

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture
def asleep(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Set as soon as the thread of the plan sleeps."""
    event, sleep = threading.Event(), Scheduler._sleep

    def note(self: Scheduler) -> None:
        if self._bell.locked():  # otherwise it doesn't sleep: somebody has rung
            event.set()
        sleep(self)

    monkeypatch.setattr(Scheduler, "_sleep", note)
    return event


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    yield
    seed_order(None)


def order(seed: int) -> None:
    seed_order(seed if seed % 4 else None, "added" if seed % 4 == 1 else "")


@seeded("random deadlocks, reported without any sleep", range(60), 20)
def test_random_deadlocks_are_told_without_any_sleep(seeds: range, asleep: threading.Event) -> None:
    longest = 0.0
    for seed in seeds:
        plan = Waits(seed)
        run = plan.deadlock()
        order(seed)
        began = time.monotonic()
        with pytest.raises(DeadlockedBranches) as raised:
            run()
        longest = max(longest, time.monotonic() - began)
        assert not asleep.is_set(), seed
        assert not scheduler().branches, seed
        plan.end()
        waits = raised.value.waits
        assert len(raised.value.cycle) == (plan.cycle + 1 if plan.cycle else 0), seed
        assert all(each.line.startswith("random_waits.py:") and each.reason for each in waits), seed
    print(f"{len(seeds)} deadlocks, each told within {longest:.3f} s")


@seeded("random plans that something wakes, none of them called a deadlock", range(200), 40)
def test_no_plan_that_something_wakes_is_called_a_deadlock(seeds: range, asleep: threading.Event) -> None:
    for seed in seeds:
        asleep.clear()
        order(seed)
        plan = Waits(seed)
        plan.woken(asleep)
        asleep.set()
        plan.end()
        signal.signal(signal.SIGALRM, signal.SIG_DFL)  # a handler of its own might wake the next one


def test_the_error_says_who_waits_where_for_what_and_for_whom() -> None:
    fork, spoon = Fluent("free", "fork"), Fluent("free", "spoon")
    both = Fluent(0, "both")

    def eat(mine: Fluent, other: Fluent) -> None:
        mine.set_value("taken")
        both.set_value(both.get_value() + 1)
        (both == 2).wait_for()
        (other == "free").wait_for()

    with pytest.raises(DeadlockedBranches) as raised, par as s:
        s(eat, fork, spoon)
        s(eat, spoon, fork)
    first, second = raised.value.waits
    assert raised.value.waiting == dict.fromkeys(("par-1 eat(fork, spoon)", "par-2 eat(spoon, fork)"), first.line)
    assert first.reason == f"spoon == 'free', last set by {second.branch}"
    assert second.reason == f"fork == 'free', last set by {first.branch}"
    assert raised.value.cycle == (first.branch, second.branch, first.branch)
    assert str(raised.value).endswith(f"cycle: {first.branch} -> {second.branch} -> {first.branch}")


def test_what_waits_outside_of_branches_is_told_too() -> None:
    with pytest.raises(DeadlockedBranches) as raised, par as s:
        s(Fluent(name="x").wait_for)
        Fluent(name="y").wait_for()
    assert [each.reason for each in raised.value.waits] == ["x, which nobody has set", "y, which nobody has set"]


def test_branches_that_wait_for_a_failed_branch_end_with_its_failure() -> None:
    class Spilled(PlanFailure):
        pass

    poured = Fluent(name="poured")

    def pour() -> None:
        checkpoint()
        raise Spilled("the milk is on the floor")

    with pytest.raises(Spilled, match="the milk is on the floor") as raised, par as s:
        s(poured.wait_for)
        s(pour)
    assert [branch.state for branch in s.branches] == [State.CANCELLED, State.FAILED]
    printed = "".join(traceback.format_exception(raised.value))
    assert "waits for poured, which nobody has set" in printed
    assert not scheduler().branches


def test_a_cleanup_that_waits_for_ever_ends_too() -> None:
    def clean() -> None:
        with finally_(Fluent(name="cleanup").wait_for):
            Fluent(name="x").wait_for()

    for _ in range(2):
        with pytest.raises(DeadlockedBranches, match="x, which nobody has set"):
            par(clean, clean)
        assert not scheduler().branches


def test_a_thing_in_the_air_that_nobody_simulates_is_a_deadlock(world: BulletWorld) -> None:
    floor = Object("floor", "environment", "plane.urdf")
    cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
    with pytest.raises(DeadlockedBranches, match="contact of cup and floor, while nobody simulates"):
        contact(cup, floor).wait_for()


RAW_THREAD = """
import _thread, threading
from pycram.fluent import Fluent
from pycram.scheduling.schedule import Scheduler
begun, asleep, answer, sleep = threading.Event(), threading.Event(), Fluent(name="answer"), Scheduler._sleep
Scheduler._sleep = lambda self: (asleep.set(), sleep(self))
_thread.start_new_thread(lambda: (begun.set(), asleep.wait(), answer.set_value(1)), ())
begun.wait()
answer.wait_for()
"""


def test_a_thread_that_the_threading_module_doesnt_know_may_wake_a_wait() -> None:
    subprocess.run([sys.executable, "-c", RAW_THREAD], timeout=100, check=True)  # it leaves a dummy thread behind


def test_a_run_that_is_deadlocked_ends_with_a_whole_recording(tmp_path: Path) -> None:
    plan, log = tmp_path / "plan.py", tmp_path / "plan.mcap"
    plan.write_text("from pycram.fluent import Fluent\nfrom pycram.language import par\n"
                    "left, right = Fluent(name='left'), Fluent(name='right')\npar(left.wait_for, right.wait_for)\n")  # fmt: skip
    ran = subprocess.run([sys.executable, "-m", "pycram", "run", str(plan), "--log", str(log)],
                         capture_output=True, text=True, timeout=100, check=False)  # fmt: skip
    assert ran.returncode == 1
    assert "deadlock: all branches wait, and nothing can wake them: par-1 left.wait_for at plan.py:4" in ran.stderr
    with replay.open(log) as recording:
        *_, last = recording
        assert last.failure.type == "DeadlockedBranches"
