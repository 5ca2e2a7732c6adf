"""The test of a plan in docs/guides/running.md passes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = (Path(__file__).parents[1] / "docs" / "guides" / "running.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_test_of_a_plan_in_the_guide_passes_and_leaves_a_recording_for_each_run(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(import pytest\n.*?)```", GUIDE, re.DOTALL)
    (tmp_path / "test_plan.py").write_text(example)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--basetemp=runs"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "2 passed" in ended.stdout, ended.stdout
    assert len([each for each in tmp_path.glob("runs/*/run.mcap") if not each.parent.is_symlink()]) == 2
