"""What docs/guides/motions.md shows is what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "motions.md"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")  # last digits are the engine's


def block(kind: str) -> str:
    (found,) = re.findall(rf"```{kind}\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    return found


@pytest.mark.slow
def test_the_guide_s_program_prints_what_the_guide_says() -> None:
    ended = subprocess.run([sys.executable, "-c", block("python")], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    shown, printed = ([NUMBER.sub("#", line) for line in text.splitlines()] for text in (block("text"), ended.stdout))
    assert printed == shown
    heights = [float(number) for number in re.findall(r"height (\S+) m, now at (\S+) m", ended.stdout)[0]]
    assert 0 < heights[0] - heights[1] < 0.02
