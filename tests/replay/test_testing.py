"""The pytest plugin: docs/guides/testing.md is what its readers get."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Run
from tests.replay.documented import REPO, blocks, without_numbers

if TYPE_CHECKING:
    from pathlib import Path

GUIDE = (REPO / "docs" / "guides" / "testing.md").read_text(encoding="utf-8")
KEPT = "test_tidy.py.test_milk_falls_to_the_floor.mcap"


def run_tests(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    plan, *tests = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
    (folder / "tidy.py").write_text(plan, encoding="utf-8")
    (folder / "test_tidy.py").write_text("\n".join(tests), encoding="utf-8")
    (folder / "pytest.ini").write_text("[pytest]\n", encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-p", "replay.testing", "-p", "no:cacheprovider", *options]
    environment = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    environment.pop("PYTEST_ADDOPTS", None)
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.costly
@pytest.mark.slow
@pytest.mark.parametrize("parallel", [(), ("-p", "xdist", "-n", "2")], ids=["alone", "xdist"])
def test_the_guide_s_tests_end_as_it_shows(tmp_path: Path, parallel: tuple[str, ...]) -> None:
    ended = run_tests(tmp_path, *parallel)
    assert "1 failed, 5 passed" in ended.stdout, ended.stdout
    (block,) = blocks(GUIDE)
    shown = [without_numbers(line) for line in ended.stdout.splitlines()]
    assert [line for line in block.lines if without_numbers(line) not in shown] == []
    assert [file.name for file in (tmp_path / "pycram-recordings").iterdir()] == [KEPT]
    assert f"pycram-replay why pycram-recordings/{KEPT}" in ended.stdout
    with replay.open(tmp_path / "pycram-recordings" / KEPT) as log:
        end = log[-1]
        assert isinstance(end, Run)
        assert end.failure.type == "PropertyFailed"


@pytest.mark.slow
def test_an_error_of_collection_is_shown_as_without_the_plugin(tmp_path: Path) -> None:
    (tmp_path / "test_broken.py").write_text("import nothing_of_this_name\n", encoding="utf-8")
    ended = run_tests(tmp_path, "test_broken.py")
    assert ended.returncode == 2
    assert "No module named 'nothing_of_this_name'" in ended.stdout
    assert "INTERNALERROR" not in ended.stdout + ended.stderr
    assert "AttributeError" not in ended.stdout + ended.stderr


@pytest.mark.slow
def test_a_seed_is_that_of_the_fixtures(tmp_path: Path) -> None:
    (tmp_path / "test_seeds.py").write_text(
        "import random\nfrom replay.testing import seeds\n"
        "@seeds(2)\ndef test_dice(pycram_record, seed):\n"
        "    assert random.random() == random.Random(seed).random()\n",
        encoding="utf-8",
    )
    ended = run_tests(tmp_path, "test_seeds.py")
    assert "2 passed" in ended.stdout, ended.stdout
    assert not (tmp_path / "pycram-recordings").exists()


@pytest.mark.slow
def test_the_plugin_is_off_unless_it_is_used(tmp_path: Path) -> None:
    (tmp_path / "test_plain.py").write_text(
        "import sys\ndef test_plain():\n    assert not {'pybullet', 'pycram', 'numpy'} & set(sys.modules)\n",
        encoding="utf-8",
    )
    ended = run_tests(tmp_path, "test_plain.py")
    assert "1 passed" in ended.stdout, ended.stdout
