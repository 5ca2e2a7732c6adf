"""What the README shows of a failed plan is what a reader gets."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.replay.documented import blocks, printed, without_numbers

README = Path(__file__).parents[3] / "README.md"


@pytest.mark.costly
@pytest.mark.slow
def test_the_readme_s_walk_through_a_failed_plan_is_real(failed_log: Path, tmp_path: Path) -> None:
    (tmp_path / failed_log.name).write_bytes(failed_log.read_bytes())
    shown = blocks(README.read_text().partition("## 4. A plan failed. What now?")[2].partition("\n## ")[0])
    verbs = [block.commands[-1].partition("pycram-replay")[2].split()[0] for block in shown]
    assert verbs == ["why", "render", "blame", "ask", "restore", "ask", "fork", "debug"]
    for commands, lines in shown:
        output = {without_numbers(line) for line in printed(commands, tmp_path)}
        for line in lines:
            assert line == "..." or without_numbers(line) in output, (commands, line)
