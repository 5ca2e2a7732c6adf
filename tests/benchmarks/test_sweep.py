"""What a run of a sweep costs, as ratios within one run: it finds done what the first one had to do."""

from __future__ import annotations

import itertools
import resource
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import pycram

if TYPE_CHECKING:
    from pycram.sweeping import Outcome, Sweep

RUNS = 5

pytestmark = pytest.mark.slow


def test_later_runs_cost_less_and_memory_stays(tmp_path: Path) -> None:
    spent: list[float] = []
    memory: list[int] = []

    def note(_: Sweep, __: Outcome | None) -> None:
        of = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(of.ru_utime + of.ru_stime)
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)

    demo = Path(__file__).parents[2] / "demos" / "scattered_table.py"
    result = pycram.sweep(demo, RUNS, tmp_path / "runs", set={"scatter": [0.01]}, cores=1, progress=note)
    assert not result.stopped
    first, *later = (after - before for before, after in itertools.pairwise(spent))
    print(f"a later run takes {sum(later) / len(later) / first:.2f} of the first one's processor time")
    assert sum(later) / len(later) < 0.85 * first
    assert memory[-1] < 1.05 * memory[2]  # once the caches are warm
    sizes = [file.stat().st_size for file in sorted((tmp_path / "runs").glob("[0-9]*.mcap"))]
    assert 500 * max(sizes[1:]) < 120e6
