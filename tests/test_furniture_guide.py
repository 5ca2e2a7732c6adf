"""docs/guides/furniture.md: its corrections are read, and it has each of their entries."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from pycram import cli
from pycram.models import corrections, load
from pycram.models.furniture import furniture_of

REPO = Path(__file__).parent.parent
GUIDE = (REPO / "docs" / "guides" / "furniture.md").read_text(encoding="utf-8")


def test_the_corrections_that_the_guide_shows_are_read(tmp_path: Path) -> None:
    shutil.copy(REPO / "resources" / "table.urdf", tmp_path)
    ((text),) = re.findall(r"```toml\n(.*?)```", GUIDE, re.DOTALL)
    (tmp_path / f"table{corrections.SUFFIX}").write_text(text)
    surfaces = furniture_of(load.load(tmp_path / "table.urdf")).surfaces
    assert sorted(surfaces) == ["desk", "window sill"]
    assert surfaces["desk"].clearance == 0.6
    assert surfaces["window sill"].size == pytest.approx((0.15, 1.2))


@pytest.mark.slow
def test_what_describe_prints_can_be_saved_as_corrections(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("kitchen.urdf", f"kitchen{corrections.SUFFIX}"):
        shutil.copy(REPO / "resources" / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    before = furniture_of(load.load("kitchen.urdf"))
    assert cli.main(["describe", "kitchen.urdf"]) == 0
    (tmp_path / f"kitchen{corrections.SUFFIX}").write_text(capsys.readouterr().out)
    assert furniture_of(load.load("kitchen.urdf")) == before


def test_every_entry_of_corrections_is_in_the_guide() -> None:
    for entries in corrections.ENTRIES.values():
        for entry in entries:
            assert f"`{entry}" in GUIDE, entry
