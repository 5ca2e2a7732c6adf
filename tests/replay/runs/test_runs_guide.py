"""docs/guides/runs.md: its commands print what it shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.replay.documented import REPO, blocks, printed, without_numbers

if TYPE_CHECKING:
    from pathlib import Path

TEXT = (REPO / "docs" / "guides" / "runs.md").read_text()


@pytest.mark.costly
@pytest.mark.slow
def test_its_commands_print_what_it_shows(runs: Path) -> None:
    for shown in blocks(TEXT):
        lines = printed(shown.commands, runs.parent)
        assert [without_numbers(line) for line in lines] == [without_numbers(line) for line in shown.lines]
