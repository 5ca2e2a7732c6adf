"""What docs/guides/places.md shows is what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

COUNTS = re.compile(r"\d+(?= (by|places) )")  # which hang on the last bits of numbers
GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "places.md"


def block(kind: str) -> str:
    (found,) = re.findall(rf"```{kind}\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    return found


@pytest.mark.costly
@pytest.mark.slow
def test_the_guide_s_program_prints_what_the_guide_says(tmp_path: Path) -> None:
    command = [sys.executable, "-c", block("python")]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert COUNTS.sub("#", ended.stdout) == COUNTS.sub("#", block("text"))
    command = [sys.executable, "-m", "replay", "log", "places.mcap", "--kind", "query"]
    log = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "standing_places(robot=pr2, reach=[cereal], arms=[left, right])" in log.stdout
    assert re.search(r"of \d+ places \d+ are out of reach, \d+ collide with kitchen", log.stdout)
