"""What the machine lacks: tests that need it are skipped and summed up in one line, and fail where all has to run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import needs

REPO = Path(__file__).parent.parent
TESTS = """
import sys
import pytest
sys.modules["ray"] = None  # as if it weren't installed
from tests import needs

def pytest_configure(config):
    config.pluginmanager.register(needs)
"""
CASES = """
import pytest

@pytest.mark.needs("Xvfb", "Chromium")
def test_of_both(): ...

@pytest.mark.needs("Chromium")
def test_of_one(): ...

@pytest.mark.needs("Ray")
def test_of_a_package(): ...

def test_of_none(): ...

@pytest.mark.skip(reason="for another reason")
def test_skipped(): ...
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "ci", "code"), [((), "", 0), (("-n", "2"), "", 0), ((), "true", 1)], ids=["one", "two workers", "CI"]
)
def test_a_run_on_a_machine_without(tmp_path: Path, more: tuple[str, ...], ci: str, code: int) -> None:
    (tmp_path / "conftest.py").write_text(TESTS)
    (tmp_path / "test_cases.py").write_text(CASES)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = needs\naddopts = -p no:cacheprovider\n")
    command = [sys.executable, "-m", "pytest", "-p", "xdist", *more]
    kept = {**os.environ, "PYTHONPATH": str(REPO), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    environment = {**kept, "PATH": str(tmp_path), "CI": ci}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == code, ended.stdout
    install = "`make system-packages` and `make test-long` install them"
    line = f"3 tests skipped: no Xvfb, no Chromium, no Ray; {install}"
    assert (ended.stdout.splitlines()[-1] == line) == (not ci)
    assert ended.stdout.count(line) == (not ci)
    if ci:
        assert "3 errors" in ended.stdout
        assert "this machine has no Xvfb, no Chromium" in ended.stdout


def test_nothing_is_summed_up_where_nothing_was_missing() -> None:
    assert needs.summary([]) is None
    assert needs.summary(["Skipped: for another reason"]) is None
    assert needs.summary(["Skipped: this machine has no Xvfb"]) == (
        "1 test skipped: no Xvfb; `make system-packages` installs them"
    )
    assert needs.summary(["Skipped: this machine has no PyAV, no Ray", "Skipped: this machine has no Ray"]) == (
        "2 tests skipped: no Ray, no PyAV; `make test-long` installs them"
    )
