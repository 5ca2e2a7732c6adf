"""What docs/guides/debug.md shows is what a reader gets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.replay.documented import REPO, blocks, printed, without_numbers

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.costly
@pytest.mark.slow
def test_the_guide_s_sessions_are_real(failed_log: Path, tmp_path: Path) -> None:
    (tmp_path / failed_log.name).write_bytes(failed_log.read_bytes())
    shown = blocks((REPO / "docs" / "guides" / "debug.md").read_text())
    assert len(shown) == 1
    for commands, lines in shown:
        output = [without_numbers(line) for line in printed(commands, tmp_path)]
        assert output == [without_numbers(line) for line in lines], commands
