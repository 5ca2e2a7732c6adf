"""The README's plan runs, and docs/guides/failed_plan.md shows what a reader gets."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from replay.cli.main import VERBS
from tests.replay.documented import blocks, printed, without_numbers

REPO = Path(__file__).parents[3]
GUIDE = REPO / "docs" / "guides" / "failed_plan.md"


@pytest.mark.slow
def test_the_readme_s_plan_succeeds_and_leaves_a_recording(tmp_path: Path) -> None:
    (plan,) = re.findall(r"```python\n(.*?)```", (REPO / "README.md").read_text(), re.DOTALL)
    (tmp_path / "my_plan.py").write_text(plan)
    command = [sys.executable, "-m", "pycram", "run", "my_plan.py"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "my_plan.mcap").exists()


def test_the_readme_stays_short() -> None:
    assert len((REPO / "README.md").read_text().splitlines()) <= 150


@pytest.mark.costly
@pytest.mark.slow
def test_the_walk_through_a_failed_plan_is_real(failed_log: Path, tmp_path: Path) -> None:
    (tmp_path / failed_log.name).write_bytes(failed_log.read_bytes())
    shown = blocks(GUIDE.read_text())
    verbs = [block.commands[-1].partition("pycram-replay")[2].split()[0] for block in shown]
    assert verbs == ["render", "blame", "ask"]
    for commands, lines in shown:
        output = {without_numbers(line) for line in printed(commands, tmp_path)}
        for line in lines:
            assert line == "..." or without_numbers(line) in output, (commands, line)


def test_the_page_on_promises_says_of_each_verb_whether_it_runs_code() -> None:
    text = (REPO / "docs" / "reference" / "promises.md").read_text(encoding="utf-8")
    rows = [
        row.split("|")[1] for row in text.partition("## Which verbs run code")[2].splitlines() if row.startswith("| `")
    ]
    named = [verb for row in rows for verb in re.findall(r"`([a-z-]+)`", row)]
    assert sorted(named) == sorted(VERBS)
