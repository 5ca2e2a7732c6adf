"""What a sweep on a Ray cluster of this machine takes beside one without it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import pycram
from tests.benchmarks.timing import goal

if TYPE_CHECKING:
    from pycram.sweeping import Outcome, Sweep

DEMO = Path(__file__).parents[2] / "demos" / "scattered_table.py"
RUNS = 200
BEGUN = 30  # runs until all processes are there, and warm
CORES = 2


def seconds(folder: Path, ray: str | None) -> float:
    """How long it takes by the clock, start-up apart; others on the machine take turns with both."""
    times: list[float] = []

    def note(_: Sweep, outcome: Outcome | None) -> None:
        if outcome is not None:
            times.append(time.monotonic())

    result = pycram.sweep(DEMO, RUNS, folder, set={"scatter": [0.01]}, cores=CORES, ray=ray, progress=note)
    assert (result.done, result.stopped) == (RUNS, "")
    return times[-1] - times[BEGUN]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_ray_takes_little_more_than_without(tmp_path: Path) -> None:
    local = seconds(tmp_path / "local", None)
    goal("200 runs of the demo with Ray, in times without", seconds(tmp_path / "ray", "") / local, 1.3, room=2)
