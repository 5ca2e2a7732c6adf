"""Recordings of the demos, made once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parents[2] / "demos"


def recorded(plan: str, folder: Path) -> Path:
    file = folder / f"{plan}.mcap"
    command = [sys.executable, "-m", "pycram", "run", str(DEMOS / f"{plan}.py"), "--log", str(file)]
    subprocess.run(command, capture_output=True, check=False, timeout=300)
    return file


@pytest.fixture(scope="session")
def demo_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded("set_the_table", tmp_path_factory.mktemp("demo"))


@pytest.fixture(scope="session")
def failed_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded("fails_to_reach", tmp_path_factory.mktemp("failed"))
