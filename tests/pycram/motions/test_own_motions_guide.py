"""docs/guides/process_modules.md: the entry points that it shows are those that are tested."""

from __future__ import annotations

import re
from pathlib import Path

GUIDE = (Path(__file__).parents[3] / "docs" / "guides" / "process_modules.md").read_text(encoding="utf-8")


def test_entry_points_on_the_page_are_those_that_are_tested() -> None:
    tested = (Path(__file__).parents[1] / "test_plugins.py").read_text(encoding="utf-8")
    groups = re.findall(r'\[project\.entry-points\."([^"]+)"\]', GUIDE)
    assert len(groups) == 3
    assert all(f"[{group}]" in tested for group in groups)
