"""NumPy's products run in one thread, unless the user wants more."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPO = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="threads are counted in /proc")
@pytest.mark.parametrize("package", ["recorder.geometry", "pycram.actions", "replay"])
@pytest.mark.parametrize("wanted", [None, "2"])
def test_importing_a_package_leaves_one_thread_or_those_that_are_wanted(package: str, wanted: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {} if wanted is None else {"OPENBLAS_NUM_THREADS": wanted}
    program = (
        f"import {package}, numpy; numpy.ones((500, 500)) @ numpy.ones((500, 500)); print(*open('/proc/self/status'))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=REPO, env=environment, capture_output=True, text=True, check=True
    )
    (threads,) = (int(line.split()[1]) for line in ended.stdout.splitlines() if line.strip().startswith("Threads:"))
    assert threads == (1 if wanted is None else min(2, len(os.sched_getaffinity(0))))
