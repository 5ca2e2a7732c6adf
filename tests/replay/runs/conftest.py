"""A folder of real recordings, made once: in half of the runs the spoon is carried with the right arm, and falls."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from tests.replay.runs.seeded import Cause, sweep

if TYPE_CHECKING:
    from pathlib import Path

RIGHT_ARM = Cause("arm", "spoon", "right", ("arm=right at pick-up(spoon)",))
COUNT = 24


@pytest.fixture(scope="session")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recordings; not for changing, and without tables."""
    folder = tmp_path_factory.mktemp("swept") / "runs"
    folder.mkdir()
    sweep(folder, RIGHT_ARM, range(COUNT))
    return folder


@pytest.fixture
def runs(swept: Path, tmp_path: Path) -> Path:
    """A folder of one's own with these recordings."""
    folder = tmp_path / "runs"
    folder.mkdir()
    for recording in swept.glob("*.mcap"):
        shutil.copy2(recording, folder)
    return folder
