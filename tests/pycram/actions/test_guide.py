"""What docs/guides/actions.md shows is what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "actions.md"
BLOCK = re.compile(r"```(python|text)\n(.*?)```", re.DOTALL)


@pytest.mark.costly
@pytest.mark.slow
def test_the_guide_s_programs_print_what_the_guide_says() -> None:
    plan, printed, own = (text for _, text in BLOCK.findall(GUIDE.read_text(encoding="utf-8")))
    program = f"{plan}\n{own}\nprint(perform(tidying_up.designator(object=milk)).name)\n"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == printed + "milk\n"
