"""What the plan language costs: blocks of trivial branches, against bare threads in the same run."""

from __future__ import annotations

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


def milliseconds(*actions: Callable[[], object], rounds: int = 15, times: int = 40) -> list[float]:
    """Processor time of each, of all its threads: the best round, as others on the machine only add to it."""
    best = [float("inf")] * len(actions)
    for _ in range(rounds):
        for place, action in enumerate(actions):
            start = time.process_time()
            for _ in range(times):
                action()
            best[place] = min(best[place], (time.process_time() - start) / times * 1e3)
    return best


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
    actions = (three_threads, three_branches, in_order, six_attempts)
    threads, *bare = milliseconds(*actions)
    with recorder.record(tmp_path / "x.mcap"):
        threads_then, *recorded = milliseconds(*actions)
        (many,) = milliseconds(lambda: [tasks.tree().roots[-1].path for _ in range(100)], rounds=3, times=1)
    threads = min(threads, threads_then)
    print(f"\nthree bare threads {threads:.3f} ms")
    for action, alone, on_record in zip(actions[1:], bare, recorded, strict=True):
        ratio = on_record / threads
        print(
            f"{action.__name__:15} {alone:.3f} ms, recorded {on_record:.3f} ms ({ratio:.1f} times three bare threads)"
        )
    print(f"the path of the last of {len(tasks.tree().roots)} outermost tasks: {many / 100:.3f} ms")
    assert recorded[0] < max(1.0, 5 * threads)  # ms; where three bare threads take longer than 0.2 ms, so may this
