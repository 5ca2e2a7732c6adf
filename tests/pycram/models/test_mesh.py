"""Broken files are rejected with a cause; meshes of all formats collide."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError
from pycram.models.files import resources
from pycram.models.mesh import read_parts
from pycram.world.object import Filled

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink

NAN = float("nan")


def broken(folder: Path, name: str, content: bytes) -> Path:
    file = folder / name
    file.write_bytes(content)
    return file


def test_broken_files_are_rejected_with_their_cause(tmp_path: Path, world: BulletWorld, sink: MemorySink) -> None:
    milk = (resources() / "milk.stl").read_bytes()
    link = "<link name='a'><visual><geometry><mesh filename='gone.stl'/></geometry></visual></link>"
    two_roots = "<robot name='r'><link name='a'/><link name='b'/></robot>"
    nan = milk[:84] + struct.pack("<f", NAN) * 12 + milk[132:]
    files = {
        "empty": (broken(tmp_path, "empty.stl", b""), "is empty"),
        "truncated": (broken(tmp_path, "cut.stl", milk[: len(milk) // 2]), "truncated"),
        "no faces": (broken(tmp_path, "none.stl", milk[:80] + struct.pack("<I", 0)), "has no faces"),
        "NaN": (broken(tmp_path, "nan.stl", nan), "not finite"),
        "text": (broken(tmp_path, "text.obj", b"hello"), "no faces"),
        "xml": (broken(tmp_path, "bad.urdf", b"<robot><link></robot>"), "well-formed"),
        "other xml": (broken(tmp_path, "html.urdf", b"<html/>"), "not <robot>"),
        "no mesh": (broken(tmp_path, "mesh.urdf", f"<robot name='r'>{link}</robot>".encode()), "gone.stl"),
        "two roots": (broken(tmp_path, "roots.urdf", two_roots.encode()), "2 root links"),
        "type": (broken(tmp_path, "thing.blend", b"x"), "not .urdf, .stl"),
    }
    for name, (file, cause) in files.items():
        with pytest.raises(AssetError, match=cause) as raised:
            Object(name, "thing", file)
        assert file.name in str(raised.value)
    assert not world.objects
    assert not [record for record in sink.records if type(record).__name__ in ("Mutation", "Query")]


def test_an_obj_file_has_the_same_triangles_with_and_without_trimesh(tmp_path: Path) -> None:
    """Without materials it is read here, with one by trimesh."""
    bowl = (resources() / "bowl.collision.obj").read_bytes()
    odd = b"v 0 0 0\nv 1 0 0\nvt 0 0\nv  0 1e0 0\no a\nf 1 2 3\n# f 9 9 9\nv 0 0 -1.5\nf -1/1 -4//  2/1/\n"
    for content, count in ((bowl, bowl.count(b"\nf ")), (odd, 2)):
        (plain,) = read_parts(tmp_path / "plain.obj", content)
        (painted,) = read_parts(tmp_path / "painted.obj", b"usemtl paint\n" + content)
        assert len(plain.triangles) == count
        assert np.array_equal(plain.triangles, painted.triangles)


def test_an_obj_file_with_broken_numbers_is_rejected(tmp_path: Path) -> None:
    for line, cause in (("v 1 2", "fewer than three"), ("v 1 2 x", "could not convert"), ("v 1 2 nan", "not finite")):
        with pytest.raises(AssetError, match=cause):
            read_parts(tmp_path / "x.obj", f"v 0 0 0\nv 1 0 0\n{line}\nf 1 2 3\n".encode())


def test_text_after_the_end_of_a_dae_is_named_with_its_line_and_the_remedy(tmp_path: Path) -> None:
    content = trimesh.creation.box((0.1, 0.1, 0.1)).export(file_type="dae")
    lines = content.count(b"\n")
    with pytest.raises(AssetError, match=rf"line {lines + 2}, column 0; delete everything after </COLLADA>"):
        read_parts(tmp_path / "x.dae", content + b"\n\x00exported by hand\n")


@pytest.mark.parametrize("kind", ["stl_ascii", "obj", "dae", "stl"])
def test_meshes_of_all_formats_collide(tmp_path: Path, world: BulletWorld, kind: str) -> None:
    Object("floor", "environment", "plane.urdf")
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    file = tmp_path / f"box.{kind.partition('_')[0]}"
    content = box.export(file_type=kind)
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    body = Object("box", "thing", file, [0, 0, 0.2], color=[1, 0, 0, 1])
    world.simulate(1)
    assert body.get_position()[2] == pytest.approx(0.05, abs=3e-3)
    assert [entry.name for entry in tmp_path.iterdir()] == [file.name]


@pytest.mark.costly
def test_an_open_shell_is_hollow(tmp_path: Path, world: BulletWorld) -> None:
    """As a bowl without thickness; its convex hull would be solid."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.08)
    lower = np.flatnonzero(ball.triangles_center[:, 2] < 0)
    ball.submesh([lower], append=True).export(tmp_path / "shell.stl")
    ball.apply_scale(0.5)
    ball.export(tmp_path / "ball.stl")
    shell = Object("shell", "bowl", str(tmp_path / "shell.stl"))
    inside = Object("ball", "ball", str(tmp_path / "ball.stl"), [0, 0, -0.03])
    assert world.engine.deepest(shell.handle, inside.handle) is None
    inside.set_position([0, 0, -0.06])
    assert world.engine.deepest(shell.handle, inside.handle) is not None


def test_a_hollow_mesh_of_furniture_is_said_to_be_filled(tmp_path: Path, world: BulletWorld) -> None:
    """As a drawer whose collision mesh is in one piece; a mesh that is nearly convex is no news."""
    outside, inside = trimesh.creation.box((0.4, 0.4, 0.2)), trimesh.creation.box((0.36, 0.36, 0.2))
    inside.apply_translation((0, 0, 0.02))
    inside.invert()
    trimesh.util.concatenate(outside, inside).export(tmp_path / "drawer.stl")
    outside.export(tmp_path / "front.stl")
    links = "".join(
        f'<link name="{name}"><collision><geometry><mesh filename="{name}.stl"/></geometry></collision></link>'
        for name in ("drawer", "front")
    )
    joint = '<joint name="j" type="fixed"><parent link="drawer"/><child link="front"/></joint>'
    (tmp_path / "cupboard.urdf").write_text(f'<robot name="cupboard">{links}{joint}</robot>')
    with pytest.warns(Filled, match=r"cupboard: the collision mesh of drawer is hollow"):
        Object("cupboard", "furniture", tmp_path / "cupboard.urdf", [0, 0, 0.2])
