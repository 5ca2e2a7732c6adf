"""docs/guides/runs.md: its commands print what it shows, and its tables are those of the code."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from replay.runs.schema import documentation
from tests.replay.documented import REPO, blocks, printed, without_numbers

if TYPE_CHECKING:
    from pathlib import Path

TEXT = (REPO / "docs" / "guides" / "runs.md").read_text()


@pytest.mark.slow
def test_its_commands_print_what_it_shows(runs: Path) -> None:
    for shown in blocks(TEXT):
        lines = printed(shown.commands, runs.parent)
        assert [without_numbers(line) for line in lines] == [without_numbers(line) for line in shown.lines]


def test_its_tables_are_those_of_the_code() -> None:
    assert TEXT.endswith(f"## The tables\n\n{documentation()}\n"), "write them anew with replay.runs.schema"
