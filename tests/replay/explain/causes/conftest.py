"""Plans that fail, explained."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import pytest

from tests.replay.explain.causes.explaining import explain

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.explain.why import Why


@pytest.fixture
def explained(tmp_path: Path) -> Callable[..., Why]:
    """Runs a plan, and explains why it failed; its file is plan.py."""
    return partial(explain, tmp_path)
