"""docs/guides/fluents.md: its examples run in their order, and print what the page shows."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = (Path(__file__).parents[3] / "docs" / "guides" / "fluents.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_examples_print_what_the_guide_shows(tmp_path: Path) -> None:
    (tmp_path / "guide.py").write_text("\n".join(re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)))
    ended = subprocess.run([sys.executable, "guide.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == "".join(re.findall(r"```text\n(.*?)```", GUIDE, re.DOTALL))
