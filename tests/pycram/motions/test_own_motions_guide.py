"""docs/guides/process_modules.md: its examples run in their order, and print what the page shows."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = (Path(__file__).parents[3] / "docs" / "guides" / "process_modules.md").read_text(encoding="utf-8")
TIME = re.compile(r"\d+\.\d+ ms")


def blocks(kind: str) -> list[str]:
    return re.findall(rf"```{kind}\n(.*?)```", GUIDE, re.DOTALL)


def run(folder: Path, *command: str) -> str:
    ended = subprocess.run([sys.executable, *command], cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return TIME.sub("TIME", ended.stdout)


@pytest.mark.slow
def test_the_examples_print_what_the_guide_shows(tmp_path: Path) -> None:
    (tmp_path / "guide.py").write_text("\n".join(blocks("python")))
    assert run(tmp_path, "guide.py") == "".join(blocks("text"))
    (console,) = blocks("console")
    command, shown = console.split("\n", 1)
    assert command == "$ pycram-replay tree wiping.mcap"
    assert run(tmp_path, "-m", "replay", *command.split()[2:]) == TIME.sub("TIME", shown)


def test_entry_points_on_the_page_are_those_that_are_tested() -> None:
    tested = (Path(__file__).parents[1] / "test_plugins.py").read_text(encoding="utf-8")
    groups = re.findall(r'\[project\.entry-points\."([^"]+)"\]', GUIDE)
    assert len(groups) == 3
    assert all(f"[{group}]" in tested for group in groups)
