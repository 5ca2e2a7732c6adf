"""Models that the engine refuses without a reason, or loads silently, are rejected with a cause."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import trimesh

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError
from recorder.records import Refusal

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink

INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
BOX = '<geometry><box size="1 1 1"/></geometry>'

LINKS: dict[str, tuple[str, str]] = {
    "box without size": ("<collision><geometry><box/></geometry></collision>", "3 finite numbers, has None"),
    "box of words": ('<collision><geometry><box size="1 x 1"/></geometry></collision>', "'1 x 1'"),
    "box of two": ('<collision><geometry><box size="1 1"/></geometry></collision>', "3 finite numbers"),
    "box of a Python number": ('<visual><geometry><box size="1_0 1 1"/></geometry></visual>', "has '1_0 1 1'"),
    "negative box": ('<collision><geometry><box size="-1 1 1"/></geometry></collision>', "not above 0"),
    "box of nan": ('<visual><geometry><box size="nan 1 1"/></geometry></visual>', "3 finite numbers"),
    "sphere without radius": ("<collision><geometry><sphere/></geometry></collision>", "radius takes a finite number"),
    "cylinder without length": (
        '<collision><geometry><cylinder radius="1"/></geometry></collision>',
        "length takes a finite number",
    ),
    "no shape": ("<collision><geometry/></collision>", "<geometry> must contain one shape, but contains none"),
    "no geometry": ("<visual/>", "contains none"),
    "unknown shape": ('<visual><geometry><torus r="1"/></geometry></visual>', "<torus> isn't a shape; shapes are box"),
    "unexpanded xacro": ('<visual><geometry><box size="${w} 1 1"/></geometry></visual>', r"\$\{w\}"),
    "origin of words": (f'<visual><origin xyz="a b c"/>{BOX}</visual>', "origin: xyz takes 3 finite numbers"),
    "origin of nan": (f'<visual><origin rpy="nan 0 0"/>{BOX}</visual>', "origin: rpy takes 3 finite numbers"),
    "mass of nan": (f'<inertial><mass value="nan"/>{INERTIA}</inertial>', "mass: value takes a finite number"),
    "negative mass": (f'<inertial><mass value="-5"/>{INERTIA}</inertial>', "less than 0"),
    "no mass": (f"<inertial>{INERTIA}</inertial>", "has no <mass>"),
    "no inertia": ('<inertial><mass value="1"/></inertial>', "has no <inertia>"),
    "inertia of words": (
        '<inertial><mass value="1"/><inertia ixx="x" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>',
        "ixx takes a finite number",
    ),
    "colour of two": (
        f'<visual>{BOX}<material name="m"><color rgba="1 1"/></material></visual>',
        "rgba takes 4 finite numbers",
    ),
    "glaring colour": (
        f'<visual>{BOX}<material name="m"><color rgba="1 1 7 1"/></material></visual>',
        "between 0 and 1",
    ),
}

MESHES: dict[str, tuple[str, str]] = {
    "one.stl": (
        "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
        "is flat",
    ),
    "flat.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n", "is flat"),
    "point.obj": ("v 0 0 0\nv 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\nf 2 4 3\n", "is flat"),
    "far.obj": ("v 0 0 0\nv 1e30 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n", "away from its origin"),
}


@pytest.mark.parametrize("name", LINKS)
def test_invalid_links_are_rejected_by_name(tmp_path: Path, world: BulletWorld, sink: MemorySink, name: str) -> None:
    inside, cause = LINKS[name]
    file = tmp_path / "r.urdf"
    file.write_text(f'<robot name="r"><link name="a">{inside}</link></robot>')
    before = len(sink.records)
    with pytest.raises(AssetError, match=cause) as raised:
        Object("r", "r", file)
    assert raised.value.path == str(file)
    assert "'a'" in raised.value.cause
    assert not world.objects
    assert [type(record) for record in sink.records[before:]] == [Refusal]


@pytest.mark.parametrize(
    ("origin", "cause"),
    [
        ("1e39 0 0", r"joint 'far': the origin \(1e\+39, 0.0, 0.0\) has a coordinate above"),
        ("1_0 0 0", "of joint far is '1_0', not a number"),
    ],
)
def test_joints_that_the_engine_would_misplace_are_rejected(
    tmp_path: Path, world: BulletWorld, origin: str, cause: str
) -> None:
    ends = f'<parent link="a"/><child link="b"/><origin xyz="{origin}"/>'
    joint = f'<joint name="far" type="fixed">{ends}</joint>'
    file = tmp_path / "r.urdf"
    file.write_text(f'<robot name="r"><link name="a"/><link name="b"/>{joint}</robot>')
    with pytest.raises(AssetError, match=cause):
        Object("r", "r", file)


@pytest.mark.parametrize("name", MESHES)
def test_meshes_without_volume_are_rejected(tmp_path: Path, world: BulletWorld, name: str) -> None:
    content, cause = MESHES[name]
    file = tmp_path / name
    file.write_text(content)
    with pytest.raises(AssetError, match=cause):
        Object("r", "r", file)
    assert not world.objects


def test_a_urdf_needs_a_robot_name(tmp_path: Path, world: BulletWorld) -> None:
    file = tmp_path / "r.urdf"
    file.write_text(f'<robot><link name="a"><visual>{BOX}</visual></link></robot>')
    with pytest.raises(AssetError, match="has no name"):
        Object("r", "r", file)
    file.write_text(f'<robot name="r"><link name="a"><collision>{BOX}</collision></link></robot>')
    assert Object("r", "r", file).get_AABB()[1][0] == pytest.approx(0.5, abs=0.01)


def test_changed_files_are_loaded_again(tmp_path: Path, world: BulletWorld) -> None:
    file, mesh = tmp_path / "crate.urdf", tmp_path / "crate.obj"
    shape = '<geometry><mesh filename="crate.obj"/></geometry>'
    collides = f'<robot name="crate"><link name="crate"><collision>{shape}</collision></link></robot>'

    def height(name: str) -> float:
        body = Object(name, "crate", file)
        lowest, highest = body.get_AABB()
        body.remove()
        return highest[2] - lowest[2]

    def make(size: float) -> None:
        content = trimesh.creation.box((1, 1, size)).export(file_type="obj")
        mesh.write_text(content, encoding="utf-8")

    file.write_text(collides, encoding="utf-8")
    make(1.0)
    assert height("first") == height("again") == pytest.approx(1.0, abs=0.01)
    make(2.0)
    assert height("with another mesh") == pytest.approx(2.0, abs=0.01)
    file.write_text(collides.replace("<mesh", '<mesh scale="1 1 3"'), encoding="utf-8")
    assert height("scaled") == pytest.approx(6.0, abs=0.01)
    mesh.unlink()
    with pytest.raises(AssetError, match=r"the mesh crate\.obj doesn't exist"):
        height("without its mesh")
