"""Long measures go on where they were: what has passed is left out, what failed or wasn't done is done."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import measures

REPO = Path(__file__).parent.parent
CONFTEST = """
from tests import measures
pytest_addoption, pytest_configure = measures.pytest_addoption, measures.pytest_configure
"""
CASES = """
from pathlib import Path
import pytest
from tests.measures import seeded

@pytest.mark.parametrize("kind", ["even"])
@seeded("{kind} numbers", range(10), 2)
def test_even(seeds, kind, record_property):
    record_property("numbers", len(seeds))
    assert 4 not in seeds or Path("mended").exists()

@pytest.mark.long
def test_alone(): ...

def test_of_another_size(): ...
"""


@pytest.mark.costly
@pytest.mark.slow
def test_a_run_that_was_ended_goes_on(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_cases.py").write_text(CASES)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n long\n slow\n measure\naddopts = -p no:cacheprovider\n")
    file = tmp_path / "results.jsonl"

    def run(choice: str, *workers: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "pytest", "-p", "xdist", *workers, "-m", choice, "--resume", str(file)]
        environment = os.environ | {"PYTHONPATH": str(REPO), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    def row(ended: subprocess.CompletedProcess[str], measure: str) -> list[str]:
        return next(line for line in ended.stdout.splitlines() if line.startswith(measure)).split()[
            len(measure.split()) :
        ]

    first = run("measure and not long")  # as if it had been killed after one
    assert "1 passed" in first.stdout
    assert row(first, "even numbers")[:2] == ["1", "0"]
    with file.open("a") as cut_off:
        cut_off.write('{"code": "')
    second = run("measure or long", "-n", "2")
    assert "4 passed" in second.stdout, second.stdout + second.stderr
    assert "1 failed" in second.stdout
    assert second.returncode == 1
    assert row(second, "even numbers")[:2] == ["5", "1"]
    assert row(second, "test_alone")[:2] == ["1", "0"]
    (tmp_path / "mended").touch()
    third = run("measure or long")
    assert "1 passed" in third.stdout
    assert row(third, "even numbers")[:2] == ["5", "0"]
    assert row(third, "even numbers")[-2:] == ["10", "numbers"]
    fourth = run("measure or long", "-n", "2")
    assert fourth.returncode == 0, "there was nothing left to do"
    assert row(fourth, "even numbers")[:2] == ["5", "0"]


def test_the_table_sums_numbers_up_and_ranks_lists_of_them() -> None:
    figures = ({"solved": 3, "s": [0.1, 9.0, *[1.0] * 16]}, {"solved": 2, "s": [2.0, 0.2]}, {})
    results = [{"measure": "paths", "outcome": "passed", "seconds": 1.0, "figures": each} for each in figures]
    assert list(measures.table(results))[1] == "paths      3       0        3  5 solved, s: median 1, p95 2"


def test_what_other_code_did_does_not_count(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    file.write_text("".join(json.dumps({"code": code, "case": "x"}) + "\n" for code in ("old", measures.code())))
    assert len(measures.read(file, "old")) == 1
    assert measures.read(file, "new") == {}
    assert measures.code() == measures.code()
