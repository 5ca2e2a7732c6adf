"""A file in another unit than metres is loaded with ``Object(..., scale=0.001)``, recorded and executed again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import trimesh

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError, BadArgument, JointLimitError
from pycram.models import store
from pycram.models.files import find
from pycram.world import object as objects
from pycram.world.object import Oversized
from recorder.records import Mutation
from replay.restore.verify import verify

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink

CHEST = """<robot name="chest">
  <link name="body">
    <collision><origin xyz="0 0 {h}"/><geometry><box size="{a} {a} {a}"/></geometry></collision>
    <inertial><origin xyz="0 0 {h}"/><mass value="8"/>
      <inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="drawer">
    <collision><geometry><mesh filename="{cup}"/></geometry></collision>
    <visual><geometry><cylinder radius="{h}" length="{a}"/></geometry></visual>
    <inertial><mass value="1"/><inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="lid"><collision><geometry><sphere radius="{h}"/></geometry></collision></link>
  <joint name="slide" type="prismatic">
    <origin xyz="{a} 0 {h}"/><parent link="body"/><child link="drawer"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="{a}" effort="1" velocity="{a}"/>
  </joint>
  <joint name="turn" type="revolute">
    <origin xyz="0 0 {a}"/><parent link="body"/><child link="lid"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
    <mimic joint="slide" multiplier="{m}" offset="0.1"/>
  </joint>
</robot>"""


def in_millimetres(folder: Path, kind: str, name: str = "cup") -> Path:
    """A mesh of PyCRAM in millimetres, as CAD programs export it."""
    mesh = trimesh.load(find(f"{name}.stl"), force="mesh")
    mesh.apply_scale(1000.0)
    mesh.export(folder / f"{name}.{kind}")
    return folder / f"{name}.{kind}"


def chest(folder: Path, millimetre: float) -> Path:
    """A chest; ``millimetre`` is 1 mm in the unit of its file."""
    numbers = {
        "h": 200 * millimetre,
        "a": 400 * millimetre,
        "i": 0.2 * (1000 * millimetre) ** 2,
        "m": 2 / (1000 * millimetre),
    }
    cup = find("cup.stl") if millimetre == 1e-3 else in_millimetres(folder, "stl")
    file = folder / f"chest-{millimetre:g}.urdf"
    file.write_text(CHEST.format(cup=cup, **numbers))
    return file


@pytest.mark.parametrize("kind", ["stl", "obj"])
def test_a_mesh_in_millimetres_falls_as_the_same_mesh_in_metres(tmp_path: Path, world: BulletWorld, kind: str) -> None:
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    file = in_millimetres(tmp_path, kind, "milk")  # convex: nothing to decompose
    trimesh.load(find("milk.stl"), force="mesh").export(tmp_path / f"own.{kind}")
    own = Object("own", "milk", tmp_path / f"own.{kind}", [0, 0, 0.2])
    scaled = Object("scaled", "milk", file, [1, 0, 0.2], scale=0.001)
    assert objects.width(scaled.model.path) == pytest.approx(objects.width(own.model.path), rel=1e-4)
    assert inertia(scaled) == pytest.approx(inertia(own), rel=1e-4)
    world.simulate(2)
    assert scaled.get_position()[2] == pytest.approx(own.get_position()[2], abs=5e-4)


def inertia(body: Object) -> list[float]:
    """Mass and moments of inertia in an object's model."""
    element = store.document(body.model.path).find("link/inertial")
    return [
        float(element.find(tag).get(key)) for tag, key in (("mass", "value"), ("inertia", "ixx"), ("inertia", "izz"))
    ]


def test_all_lengths_of_a_urdf_are_scaled(tmp_path: Path, world: BulletWorld) -> None:
    own = Object("own", "chest", chest(tmp_path, 1e-3), [0, 0, 1])
    scaled = Object("scaled", "chest", chest(tmp_path, 1.0), [3, 0, 1], scale=0.001)
    for each in (own, scaled):
        each.set_joint_position("slide", 0.3)
    assert scaled.get_joint_positions() == pytest.approx(own.get_joint_positions())
    for link in own.links:
        x, y, z = own.get_link_position(link)
        assert scaled.get_link_position(link) == pytest.approx((x + 3, y, z), abs=1e-6)
    with pytest.raises(JointLimitError, match=r"0 to 0\.4"):
        scaled.set_joint_position("slide", 0.5)


@pytest.mark.slow
def test_a_scaled_object_is_restored_and_executed_again_bit_for_bit(tmp_path: Path) -> None:
    file = in_millimetres(tmp_path, "stl")
    with recorder.record(tmp_path / "run.mcap"), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("cup", "cup", file, [0, 0, 0.3], [0.1, 0, 0, 1], scale=0.001)
        Object("chest", "chest", chest(tmp_path, 1.0), [3, 0, 0.5], scale=0.001)
        world.simulate(1)
    file.unlink()
    with replay.open(tmp_path / "run.mcap") as log:
        loads = [each.load_body for each in log.records(Mutation) if each.HasField("load_body")]
        assert [load.scale for load in loads] == [0.0, 0.001, 0.001]
        assert verify(log).exact
        end = next(each.seq for each in log.records(Mutation) if each.HasField("simulate"))
        with log.world_at(end) as restored, log.world_at(end, exact=True) as again:
            assert restored.get_object("cup").scale == 0.001
            cup, same = restored.get_object("cup"), again.get_object("cup")
            recorded = log.state_at(end).world().bodies["cup"]
            position, orientation = same.get_position_and_orientation()
            assert (tuple(position), tuple(orientation)) == (recorded.position, recorded.orientation)
            assert cup.get_position() == position
            assert cup.load_record.scale == 0.001


def test_a_file_in_millimetres_is_asked_about(tmp_path: Path, world: BulletWorld, sink: MemorySink) -> None:
    block = trimesh.creation.box((50, 50, 50))
    block.export(tmp_path / "block.stl")
    with pytest.raises(
        AssetError, match=r"block.stl: the mesh is 50 x 50 x 50 m large: is it in millimetres\? .*scale=0.001"
    ):
        Object("block", "block", tmp_path / "block.stl")
    trimesh.creation.box((10, 10, 20)).export(tmp_path / "screw.stl")
    with pytest.warns(Oversized, match=r"screw is 20 m wide: is its file in millimetres\? .*scale=0.001") as raised:
        Object("screw", "screw", tmp_path / "screw.stl", [0, 0, 50])
    assert raised[0].filename == __file__
    Object("hall", "environment", tmp_path / "screw.stl", [0, 0, -50])  # environments are that large
    Object("small", "screw", tmp_path / "screw.stl", [0, 90, 0], scale=0.001)
    with pytest.raises(AssetError, match=r"ixx is .*in millimetres\?"):
        Object("chest", "chest", heavy(tmp_path))


def heavy(folder: Path) -> Path:
    file = folder / "heavy.urdf"
    file.write_text(chest(folder, 1.0).read_text().replace('ixx="200000.0"', 'ixx="2e9"'))
    return file


@pytest.mark.parametrize("scale", [0, -1, float("nan"), "mm"])
def test_impossible_scales_are_rejected(world: BulletWorld, scale: object) -> None:
    with pytest.raises(BadArgument, match="scale"):
        Object("cup", "cup", "cup.stl", scale=scale)
