"""What docs/guides/sweep.md shows is what a reader gets."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

REPO = Path(__file__).parents[3]
GUIDE = REPO / "docs" / "guides" / "sweep.md"

#: What isn't the same each time and everywhere.
VARIES = (
    (r"in \d+ s, [\d.]+ a second", "in 2 s, 6.1 a second"),
    (r"(directory|revision|started|took|computer|versions) .*\n", ""),
    (r"\([\d.]+ MB\)", "(0.2 MB)"),
)


def stable(text: str) -> str:
    for pattern, instead in VARIES:
        text = re.sub(pattern, instead, text)
    return text


@pytest.mark.slow
def test_a_reader_of_the_guide_gets_what_it_shows(tmp_path: Path) -> None:
    text = GUIDE.read_text(encoding="utf-8")
    plan, *_ = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "put_down.py").write_text(plan)
    modules = {"pycram": "pycram", "pycram-replay": "replay"}
    for shown in re.findall(r"```console\n\$ (.*?)```", text, re.DOTALL):
        command, _, lines = shown.partition("\n")
        name, *words = shlex.split(command)
        process = subprocess.run(
            [sys.executable, "-m", modules[name], *words],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(REPO)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert stable(process.stdout) == stable(lines), process.stderr
        progress = re.compile(r"pycram: \d+ of \d+ runs, \d+ failed")  # a line every 10 s, on slow machines
        assert not [line for line in process.stderr.splitlines() if not progress.fullmatch(line)]
