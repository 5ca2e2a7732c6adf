"""What docs/guides/projection.md shows is what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = Path(__file__).parents[2] / "docs" / "guides" / "projection.md"


def block(kind: str) -> str:
    (found,) = re.findall(rf"```{kind}\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    return found


@pytest.mark.costly
@pytest.mark.slow
def test_the_guide_s_program_prints_what_the_guide_says() -> None:
    ended = subprocess.run([sys.executable, "-c", block("python")], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == block("text")
