"""What docs/guides/motion.md shows is what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "motion.md"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")  # last digits are the engine's


def block(kind: str) -> str:
    (found,) = re.findall(rf"```{kind}\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)[:1]
    return found


@pytest.mark.costly
@pytest.mark.slow
def test_the_guide_s_program_prints_what_the_guide_says() -> None:
    ended = subprocess.run([sys.executable, "-c", block("python")], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    shown, printed = block("text").splitlines(), ended.stdout.splitlines()
    assert [NUMBER.sub("#", line) for line in printed] == [NUMBER.sub("#", line) for line in shown]
    for line, other in zip(printed, shown, strict=True):
        numbers = [[float(number) for number in NUMBER.findall(text)] for text in (line, other)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.2)
