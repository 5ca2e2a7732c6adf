"""What docs/guides/knowledge.md shows is what a reader gets; numbers of steps apart."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.replay.documented import blocks, printed, without_numbers

GUIDE = (Path(__file__).parents[2] / "docs" / "guides" / "knowledge.md").read_text(encoding="utf-8")


def block(kind: str) -> str:
    (found,) = re.findall(rf"```{kind}\n(.*?)```", GUIDE, re.DOTALL)
    return found


def without_steps(text: str) -> str:
    return re.sub(r"step \d+", "step #", text)


@pytest.mark.costly
@pytest.mark.slow
def test_the_guide_s_plan_and_commands_print_what_the_guide_says(tmp_path: Path) -> None:
    (tmp_path / "fetch_milk.py").write_text(block("python"))
    ended = subprocess.run([sys.executable, "fetch_milk.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "Unreachable: right arm can't reach" in ended.stderr
    assert without_steps(ended.stdout) == without_steps(block("text"))
    for commands, lines in blocks(GUIDE):
        shown = printed(commands, tmp_path)
        assert [without_numbers(line) for line in shown] == [without_numbers(line) for line in lines], commands
