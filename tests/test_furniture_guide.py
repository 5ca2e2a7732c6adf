"""The examples in docs/guides/furniture.md give the printed output."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram import cli
from pycram.bullet_world import BulletWorld
from pycram.failures import UsageError
from pycram.models import corrections, load
from pycram.models.furniture import furniture_of

if TYPE_CHECKING:
    from collections.abc import Sequence

REPO = Path(__file__).parent.parent
GUIDE = (REPO / "docs" / "guides" / "furniture.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"```console\n\$ (.*?)\n(.*?)```", GUIDE, re.DOTALL)


def test_python_prints_what_the_guide_shows() -> None:
    names: dict[str, object] = {}
    blocks: Sequence[tuple[str, str]] = re.findall(r"```python\n(.*?)```\n\n```text\n(.*?)```", GUIDE, re.DOTALL)
    try:
        for code, shown in blocks:
            output = io.StringIO()
            with contextlib.redirect_stdout(output):
                try:
                    exec(code, names)
                except UsageError as error:
                    print(f"{type(error).__name__}: {error}")
            assert output.getvalue() == shown
    finally:
        world = names.get("world")
        if isinstance(world, BulletWorld):
            world.exit()
    assert len(blocks) == 2


@pytest.mark.slow
@pytest.mark.parametrize(("command", "shown"), COMMANDS)
def test_commands_print_what_the_guide_shows(
    command: str, shown: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    program, *arguments = shlex.split(command)
    assert program == "pycram"
    assert cli.main(arguments) == 0
    expected, _, cut = shown.partition("...\n")
    printed = capsys.readouterr().out
    assert printed.startswith(expected) if "...\n" in shown else printed == expected
    assert not cut
    for picture in re.findall(r"\w+\.png", command):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


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
