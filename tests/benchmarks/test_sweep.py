"""What a run of a sweep costs, as ratios within one sweep: later runs find models parsed that the first had to parse."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import pytest

DEMO = Path(__file__).parents[2] / "demos" / "scattered_table.py"
RUNS = 5
#: In a process of its own: this one may have done what the first run has to do.
SWEEP = """
import json, resource, sys
import pycram

spent, memory = [], []

def note(_sweep, _outcome):
    of = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent.append(of.ru_utime + of.ru_stime)
    memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)

plan, runs, folder = sys.argv[1:]
result = pycram.sweep(plan, int(runs), folder, set={"scatter": [0.01]}, cores=1, progress=note)
assert not result.stopped
print(json.dumps([spent, memory]))
"""

pytestmark = pytest.mark.long


def test_later_runs_cost_less_and_memory_stays(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SWEEP, DEMO, str(RUNS), tmp_path / "runs"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    spent, memory = json.loads(ended.stdout.splitlines()[-1])
    first, _, *later = (after - before for before, after in itertools.pairwise(spent))
    print(f"a later run takes {sum(later) / len(later) / first:.2f} of the first one's processor time")
    assert sum(later) / len(later) < 0.9 * first
    assert memory[-1] < 1.05 * memory[2]  # once the caches are warm
    files = sorted((tmp_path / "runs").glob("[0-9]*.mcap"))
    sizes = [
        file.stat().st_size + (file.parent / "tables" / "new" / f"{file.name}.arrows").stat().st_size for file in files
    ]
    assert 500 * max(sizes[1:]) < 120e6
