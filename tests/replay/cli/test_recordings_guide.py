"""What docs/reference/recordings.md shows of motions is what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from tests.replay.documented import REPO, blocks, printed

if TYPE_CHECKING:
    from pathlib import Path

GUIDE = (REPO / "docs" / "reference" / "recordings.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_commands_print_what_the_guide_shows(tmp_path: Path) -> None:
    (plan,) = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
    (tmp_path / "swing.py").write_text(plan)
    shown = blocks(GUIDE)
    assert len(shown) == 2
    for block in shown:
        for command in [each for each in block.commands if each.startswith("pycram run ")]:
            made = [sys.executable, "-m", *command.split()]
            subprocess.run(made, cwd=tmp_path, check=True, capture_output=True, timeout=120)
            block.commands.remove(command)
        assert printed(block.commands, tmp_path) == block.lines
