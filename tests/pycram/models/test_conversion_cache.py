"""Meshes are converted once for all processes; cached meshes are never out of date."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from pycram.models import conversion_cache, load
from pycram.models.mesh import convert_visual, read_parts

REPO = Path(__file__).parents[3]
URDF = """<robot name="ball"><link name="ball">
<visual><geometry><mesh filename="ball.obj"/></geometry></visual>
<collision><geometry><mesh filename="ball.obj"/></geometry></collision>
</link></robot>"""
FILES = """
import sys
from pycram.models import load
print(*sorted(file.key for path in sys.argv[1:] for file in load.load(path).files))
print("trimesh" in sys.modules, "scipy" in sys.modules, file=sys.stderr)
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PYCRAM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    """A ball with a red texture, more than 50 kB of text."""
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    text = sphere.export(file_type="obj", include_normals=False)
    lines = ["mtllib ball.mtl", "usemtl paint", "vt 0.5 0.5"]
    lines += [line for line in text.splitlines() if line.startswith("v ")]
    lines += ["f " + " ".join(f"{corner + 1}/1" for corner in face) for face in sphere.faces]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    (tmp_path / "ball.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    paint(tmp_path, (255, 0, 0))
    (tmp_path / "ball.urdf").write_text(URDF)
    return tmp_path / "ball.urdf"


def paint(folder: Path, color: tuple[int, int, int]) -> None:
    Image.new("RGB", (8, 8), color).save(folder / "paint.png")


def pieces(ball: Path) -> list[tuple[str, bytes, list[float] | None]]:
    mesh = ball.with_suffix(".obj")
    made = conversion_cache.get("visual", mesh, lambda: convert_visual(mesh))
    return [(name, content, None if rgba is None else list(rgba)) for name, content, rgba in made]


def files_in_a_new_process(*models: Path) -> tuple[str, str]:
    """The files of models, and whether the libraries were imported that convert meshes."""
    environment = {**os.environ, "PYTHONPATH": str(REPO)}
    command = [sys.executable, "-c", FILES, *map(str, models)]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return ended.stdout, ended.stderr


@pytest.mark.slow
def test_a_second_process_loads_the_same_without_converting(cache: Path, ball: Path, bowl: Path) -> None:
    first, imported = files_in_a_new_process(ball, bowl)
    assert imported == "True True\n"
    entries = {entry.name: entry.read_bytes() for entry in cache.iterdir()}
    assert len(entries) == 4, "what is seen and what collides, of one; of the other an object, and its pieces"
    assert files_in_a_new_process(ball, bowl) == (first, "False False\n")
    assert {entry.name: entry.read_bytes() for entry in cache.iterdir()} == entries


@pytest.fixture
def bowl(tmp_path: Path) -> Path:
    """A small mesh with pieces and a table beside it."""
    bowl = tmp_path / "bowl.stl"
    trimesh.creation.box((0.2, 0.2, 0.1)).export(bowl)
    trimesh.creation.box((0.2, 0.2, 0.1)).export(tmp_path / "bowl.collision.obj")
    trimesh.creation.box((0.2, 0.2, 0.02)).export(tmp_path / "rim.stl")
    (tmp_path / "objects.toml").write_text(TABLE)
    return bowl


TABLE = """
[bowl]
mass = 0.5
visual = [{ mesh = "bowl.stl", rgba = [1, 0, 0, 1] }, { mesh = "rim.stl", rgba = [0, 0, 1, 1] }]
"""


def test_an_object_is_converted_again_when_its_color_or_a_file_next_to_it_changes(cache: Path, bowl: Path) -> None:
    def files(color: list[float] | None = None) -> tuple[str, ...]:
        return tuple(file.key for file in load.load(bowl, color).files)

    found = [files(), files([0, 1, 0, 1])]
    bowl.with_name("objects.toml").write_text(TABLE.replace("0.5", "0.6"))
    found.append(files())
    trimesh.creation.box((0.2, 0.2, 0.05)).export(bowl.with_name("rim.stl"))
    found.append(files())
    trimesh.creation.box((0.1, 0.2, 0.1)).export(bowl.with_name("bowl.collision.obj"))
    found.append(files())
    assert len(set(found)) == len(found)
    assert found[-1] == files()


def test_a_converted_mesh_is_not_parsed_again(cache: Path, ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = pieces(ball)
    monkeypatch.setattr(load.mesh, "convert_visual", lambda _: pytest.fail("converted again"))
    assert pieces(ball) == before


@pytest.mark.slow
def test_changed_textures_materials_and_meshes_are_converted_again(cache: Path, ball: Path) -> None:
    (_, _, red), *_ = pieces(ball)
    paint(ball.parent, (0, 0, 255))
    read_parts.cache_clear()
    (_, _, blue), *_ = pieces(ball)
    assert np.argmax(red[:3]) == 0
    assert np.argmax(blue[:3]) == 2
    ball.with_suffix(".mtl").write_text("newmtl paint\nKd 0 1 0\n")
    read_parts.cache_clear()
    (_, _, green), *_ = pieces(ball)
    assert np.argmax(green[:3]) == 1
    mesh = ball.with_suffix(".obj")
    mesh.write_text(mesh.read_text().replace("v 0.", "v 0.1", 1))
    assert pieces(ball)[0][1] != b""
    assert len(list(cache.iterdir())) == 4


@pytest.mark.slow
def test_a_damaged_entry_is_replaced(cache: Path, ball: Path) -> None:
    before = pieces(ball)
    (entry,) = cache.iterdir()
    whole = entry.read_bytes()
    for damaged in (b"", whole[:-7], whole[:-1] + bytes([whole[-1] ^ 1]), b"[]\n", b"{}\n"):
        entry.write_bytes(damaged)
        assert pieces(ball) == before
        assert entry.read_bytes() == whole


@pytest.mark.slow
def test_the_oldest_entries_are_deleted_when_the_cache_is_too_large(
    cache: Path, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pieces(ball)
    (oldest,) = cache.iterdir()
    monkeypatch.setattr(conversion_cache, "_LARGEST", int(1.5 * oldest.stat().st_size))
    paint(ball.parent, (0, 0, 255))
    pieces(ball)
    (left,) = cache.iterdir()
    assert left != oldest


def test_models_load_without_a_writable_cache_folder(
    tmp_path: Path, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYCRAM_CACHE", "")
    before = pieces(ball)
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("PYCRAM_CACHE", str(tmp_path / "file"))
    assert pieces(ball) == before
    assert (tmp_path / "file").read_text() == "no folder"


@pytest.mark.parametrize("whose", ["everybody's", "somebody else's"])
def test_a_cache_folder_that_others_can_write_to_is_not_used(
    cache: Path, ball: Path, monkeypatch: pytest.MonkeyPatch, whose: str
) -> None:
    made = pieces(ball)
    (entry,) = cache.iterdir()
    name, content, rgba = made[0]
    conversion_cache._write(entry, [(name, content[:-1] + b"x", rgba)])
    assert pieces(ball) != made, "in the user's own folder nobody plants anything"
    if whose == "everybody's":
        cache.chmod(0o777)
    elif os.getuid() == 0:
        os.chown(cache, 54321, -1)
    else:
        monkeypatch.setattr(os, "getuid", lambda: 54321)
    planted = entry.read_bytes()
    assert pieces(ball) == made
    assert entry.read_bytes() == planted, "nor is anything kept there"
