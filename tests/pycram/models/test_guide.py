"""The examples in docs/guides/models.md give the printed output."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path

import pytest
import trimesh

from pycram.bullet_world import BulletWorld
from pycram.failures import AssetError, UsageError
from pycram.models.files import find

GUIDE = (Path(__file__).parents[3] / "docs" / "guides" / "models.md").read_text()
BLOCK = re.compile(r"```(xml|python|text)\n(.*?)```", re.DOTALL)
NAMED = re.compile(r"`([\w.]+)`[^`]*:\n\n```xml\n(.*?)```", re.DOTALL)


def test_commands_of_the_guide_to_models_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, content in NAMED.findall(GUIDE):
        Path(name).write_text(content)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["arm.urdf", "hand.urdf"]
    names: dict[str, object] = {}
    output = io.StringIO()
    shown = 0
    try:
        for kind, content in BLOCK.findall(GUIDE):
            if kind == "python":
                output = io.StringIO()
                try:
                    with contextlib.redirect_stdout(output):
                        exec(content, names)
                except UsageError as error:
                    print(f"{type(error).__name__}: {error}".replace(f"{tmp_path}/", ""), file=output)
            elif kind == "text":
                assert output.getvalue() == content
                shown += 1
    finally:
        world = names.get("world")
        if isinstance(world, BulletWorld):
            world.exit()
    assert shown == 3


def test_the_guide_lists_all_bundled_models() -> None:
    section = GUIDE.partition("## Bundled models\n")[2].partition("\n## ")[0]
    with pytest.raises(AssetError) as raised:
        find("nothing.stl")
    assert set(re.findall(r"`([\w.]+\.(?:urdf|stl))`", section)) == set(
        str(raised.value).partition(" are ")[2].split(", ")
    )
    for name in re.findall(r"`(\w+\.stl)`", section):
        lower, upper = 1000 * trimesh.load_mesh(find(name)).bounds
        assert upper == pytest.approx(-lower, abs=0.1), f"the origin of {name} isn't its middle"
