"""What the plan language costs: blocks of trivial branches, against bare threads in the same run."""

from __future__ import annotations

import statistics
import threading
import time
from typing import TYPE_CHECKING

import pytest

import recorder
from pycram import tasks
from pycram.language import failure_handling, par, seq

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.slow


def milliseconds(action: Callable[[], object], times: int = 300) -> float:
    """The time that it takes where nobody else wants the processor: the best tenth of all runs."""
    took = []
    for _ in range(times):
        start = time.perf_counter()
        action()
        took.append(time.perf_counter() - start)
    return statistics.quantiles(took, n=10)[0] * 1e3


def nothing() -> None:
    pass


def three_threads() -> None:
    threads = [threading.Thread(target=nothing) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def three_branches() -> None:
    with par as s:
        s(nothing)
        s(nothing)
        s(nothing)


def in_order() -> None:
    with seq as s:
        s(nothing)
        s(nothing)
        s(nothing)


def six_attempts() -> None:
    for attempt in failure_handling(5):
        with attempt:
            pass


def test_blocks(tmp_path: Path) -> None:
    threads = milliseconds(three_threads)
    bare = {action.__name__: milliseconds(action) for action in (three_branches, in_order, six_attempts)}
    with recorder.record(tmp_path / "x.mcap"):
        recorded = {action.__name__: milliseconds(action) for action in (three_branches, in_order, six_attempts)}
        many = milliseconds(lambda: [tasks.tree().roots[-1].path for _ in range(100)], 10)
    print(f"\nthree bare threads {threads:.3f} ms")
    for name, took in recorded.items():
        print(f"{name:15} {bare[name]:.3f} ms, recorded {took:.3f} ms ({took / threads:.1f} times three bare threads)")
    print(f"the path of the last of {len(tasks.tree().roots)} outermost tasks: {many / 100:.3f} ms")
    assert recorded["three_branches"] < 20 * threads  # 1 ms is the goal; a noisy machine needs room
    assert recorded["three_branches"] < 5
