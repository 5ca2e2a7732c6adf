"""Published URDFs load: with Gazebo's elements, in packages, in one line; errors give the cause."""

from __future__ import annotations

import math
import random
import sys
from typing import TYPE_CHECKING

import pytest
import trimesh

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError, BadArgument
from recorder import geometry

if TYPE_CHECKING:
    from pathlib import Path

INERTIAL = '<inertial><mass value="{}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
BOX = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
ENDS = '<parent link="a"/><child link="b"/>'


def urdf(folder: Path, inside: str, name: str = "thing.urdf") -> Path:
    file = folder / name
    file.write_text(f'<?xml version="1.0"?><robot name="thing">{inside}</robot>')
    return file


def joint(kind: str, inside: str = "") -> str:
    return f'<link name="a"/><link name="b"/><joint name="j" type="{kind}">{ENDS}{inside}</joint>'


def assert_as_written(body: Object) -> None:
    """Poses of links in the engine are those computed from the file, at random values of all joints."""
    numbers = random.Random(7)
    for _ in range(5):
        values = {}
        for name in set(body.joints) - set(body.urdf.mimics):
            lower, upper = body.joint_limits(name)
            values[name] = numbers.uniform(max(lower, -2.0), min(upper, 2.0))
        body.set_joint_positions(values)
        base = body.get_position_and_orientation()
        for link, pose in body.urdf.link_poses(values).items():
            position, orientation = geometry.multiply(base, pose)
            found = body.get_link_position_and_orientation(link)
            assert math.dist(position, found[0]) < 1e-5, link
            assert geometry.angle(orientation, found[1]) < 1e-5, link


def test_elements_that_are_not_urdf_are_removed_with_their_children(tmp_path: Path, world: BulletWorld) -> None:
    gazebo = (
        '<link name="ghost"><inertial><mass>0.17</mass></inertial></link>'
        '<joint name="j" type="ball"/><sensor><visual><geometry><mesh filename="gone.dae"/></geometry></visual></sensor>'
    )
    link = f'<link name="a">{INERTIAL.format(3)}{BOX}<gazebo>{gazebo}</gazebo><sensor><mesh/></sensor></link>'
    others = f'<gazebo reference="a">{gazebo}</gazebo><transmission><joint name="j"/></transmission>'
    own = '<x:link xmlns:x="http://example.org" name="y"><x:mass>heavy</x:mass></x:link>'
    body = Object("thing", "thing", urdf(tmp_path, link + others + own))
    assert body.links == ("a",)
    assert world.engine.center_of_mass(body.handle)[1] == pytest.approx(3)
    assert b"gazebo" not in body.model.files[0].content


def test_a_urdf_in_a_single_line_is_loaded_exactly(tmp_path: Path, world: BulletWorld) -> None:
    links, joints = '<link name="l0"/>', ""
    for number in range(1, 60):
        links += f'<link name="l{number}">{BOX}</link>'
        at = f"{0.0123456789 * number:.10f} {-0.0456789123:.10f} 0.0789123456"
        joints += (
            f'<joint name="j{number}" type="revolute"><origin xyz="{at}" rpy="0.1234567891 -0.2345678912 0.3456789123"/>'
            f'<parent link="l{number - 1}"/><child link="l{number}"/><axis xyz="0.6 0 0.8"/>'
            '<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>'
        )
    file = urdf(tmp_path, links + joints)
    assert len(file.read_text()) > 20_000
    assert "\n" not in file.read_text()
    body = Object("thing", "environment", file, [1, 2, 3], [0, 0, 0.6, 0.8])
    assert max(map(len, body.model.files[0].content.splitlines())) < 8191
    assert_as_written(body)


def test_planar_joints_are_two_slides_and_a_turn(tmp_path: Path, world: BulletWorld) -> None:
    origin = '<origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/>'
    body = Object("thing", "environment", urdf(tmp_path, joint("planar", f'{origin}<axis xyz="0 0 2"/>')))
    assert body.joints == ("j_x", "j_y", "j_yaw")
    body.set_joint_positions({"j_x": 0.5, "j_y": 0.25, "j_yaw": math.pi / 2})
    assert body.get_link_position("b") == pytest.approx([0.75, 2.5, 3])
    assert geometry.angle(body.get_link_orientation("b"), [0, 0, 1, 0]) < 1e-6
    assert_as_written(body)
    tilted = urdf(tmp_path, joint("planar", '<axis xyz="1 1 1"/>'), "tilted.urdf")
    body = Object("tilted", "environment", tilted)
    body.set_joint_positions({"j_x": 0.5, "j_y": -0.7})
    assert sum(body.get_link_position("b")) == pytest.approx(0, abs=1e-6)
    assert math.hypot(*body.get_link_position("b")) == pytest.approx(math.hypot(0.5, 0.7))


def test_floating_joints_reach_any_pose_and_hold_it(tmp_path: Path, world: BulletWorld) -> None:
    inside = joint("floating", '<axis xyz="0 0 0"/>').replace('<link name="b"/>', f'<link name="b">{BOX}</link>')
    body = Object("thing", "environment", urdf(tmp_path, inside))
    assert body.joints == ("j_x", "j_y", "j_z", "j_yaw", "j_pitch", "j_roll")
    body.set_joint_positions({"j_x": 1, "j_y": 2, "j_z": 3, "j_yaw": 0.3, "j_pitch": 0.2, "j_roll": 0.1})
    assert body.get_link_position("b") == pytest.approx([1, 2, 3])
    assert geometry.angle(body.get_link_orientation("b"), geometry.from_rpy(0.1, 0.2, 0.3)) < 1e-6
    world.simulate(1)
    assert body.get_link_position("b") == pytest.approx([1, 2, 3], abs=1e-3)
    assert_as_written(body)


def test_continuous_joints_have_no_limits_even_if_they_are_given(tmp_path: Path, world: BulletWorld) -> None:
    limit = '<axis xyz="0 0 1"/><limit lower="-0.1" upper="0.1" effort="1" velocity="1"/>'
    body = Object("thing", "environment", urdf(tmp_path, joint("continuous", limit)))
    assert body.joint_limits("j") == (-math.inf, math.inf)
    body.set_joint_position("j", 3)
    world.simulate(0.5)
    assert body.get_joint_position("j") == pytest.approx(3, abs=1e-3)


# --- packages ------------------------------------------------------------------------------------------------------

MESH = "package://my_robot/meshes/crate.stl"


@pytest.fixture
def robot_in_package(tmp_path: Path) -> Path:
    """A URDF whose mesh is in a package elsewhere, in ``ws/src/stack/folder_of_another_name``."""
    package = tmp_path / "ws" / "src" / "stack" / "folder_of_another_name"
    (package / "meshes").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>\n my_robot </name></package>")
    trimesh.creation.box((0.2, 0.2, 0.2)).export(package / "meshes" / "crate.stl")
    (tmp_path / "home").mkdir()
    mesh = f'<collision><geometry><mesh filename="{MESH}"/></geometry></collision>'
    return urdf(tmp_path / "home", f'<link name="a">{mesh}</link>')


@pytest.mark.parametrize("folder", ["ws", "ws/src", "ws/src/stack", "ws/src/stack/folder_of_another_name"])
@pytest.mark.parametrize("way", ["argument", "PYCRAM_PACKAGES", "ROS_PACKAGE_PATH"])
def test_meshes_are_found_in_packages(
    tmp_path: Path, robot_in_package: Path, world: BulletWorld, monkeypatch: pytest.MonkeyPatch, way: str, folder: str
) -> None:
    packages = []
    if way == "argument":
        packages = [tmp_path / folder]
    else:
        monkeypatch.setenv(way, f"/nowhere:{tmp_path / folder}")
    body = Object("thing", "thing", robot_in_package, packages=packages)
    assert body.get_AABB()[1] == pytest.approx([0.1, 0.1, 0.1], abs=5e-3)


@pytest.mark.parametrize("way", ["argument", "PYCRAM_PACKAGES", "ROS_PACKAGE_PATH"])
def test_a_mesh_of_another_package_with_the_same_path_is_not_used(
    tmp_path: Path, robot_in_package: Path, world: BulletWorld, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    (tmp_path / "home" / "meshes").mkdir()
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "home" / "meshes" / "crate.stl")
    monkeypatch.setenv(way, str(tmp_path / "ws"))
    body = Object("thing", "thing", robot_in_package, packages=[tmp_path / "ws"] if way == "argument" else [])
    assert body.get_AABB()[1] == pytest.approx([0.1, 0.1, 0.1], abs=5e-3)


def test_the_folder_of_another_package_is_not_searched(
    tmp_path: Path, robot_in_package: Path, world: BulletWorld
) -> None:
    (tmp_path / "home" / "meshes").mkdir()
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "home" / "meshes" / "crate.stl")
    Object("in a folder of any name", "thing", robot_in_package)
    (tmp_path / "home" / "package.xml").write_text("<package><name>another_robot</name></package>")
    with pytest.raises(AssetError, match="no package 'my_robot' is known"):
        Object("in another package", "thing", robot_in_package)


def test_folders_named_like_a_package_are_packages(tmp_path: Path, robot_in_package: Path, world: BulletWorld) -> None:
    stack = tmp_path / "ws" / "src" / "stack"
    (stack / "folder_of_another_name" / "package.xml").unlink()
    (stack / "folder_of_another_name").rename(stack / "my_robot")
    for number, folder in enumerate((stack, stack / "my_robot", tmp_path / "ws")):
        Object(f"thing {number}", "thing", robot_in_package, packages=[str(folder)])


def test_errors_of_missing_packages_and_meshes_say_what_to_do(
    tmp_path: Path, robot_in_package: Path, world: BulletWorld
) -> None:
    with pytest.raises(AssetError, match=r"no package 'my_robot' is known.*packages=\[.*ROS_PACKAGE_PATH"):
        Object("thing", "thing", robot_in_package)
    package = tmp_path / "ws" / "src" / "stack" / "folder_of_another_name"
    (package / "meshes" / "crate.stl").unlink()
    with pytest.raises(AssetError, match=r"the package is .*folder_of_another_name, which has no meshes/crate\.stl"):
        Object("thing", "thing", robot_in_package, packages=[package])
    for wrong in ("ws", [tmp_path / "gone"], [3]):
        with pytest.raises(BadArgument, match="packages"):
            Object("thing", "thing", robot_in_package, packages=wrong)
    assert not world.objects


# --- what can't be loaded ------------------------------------------------------------------------------------------

XACRO = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r">{}</robot>'


@pytest.mark.parametrize(
    ("name", "content", "command"),
    [
        ("arm.urdf.xacro", XACRO.format('<link name="a"/>'), r"xacro arm\.urdf\.xacro > arm\.urdf"),
        ("arm.xacro", XACRO.format('<xacro:property name="x" value="1"/>'), r"xacro arm\.xacro > arm\.urdf"),
        ("arm.urdf", XACRO.format('<xacro:include filename="x"/>'), r"xacro arm\.urdf > expanded_arm\.urdf"),
        ("arm.urdf", '<robot name="r"><xacro:arm side="left"/></robot>', r"xacro arm\.urdf > expanded_arm\.urdf"),
    ],
)
def test_xacro_is_rejected_with_the_command_that_expands_it(
    tmp_path: Path, world: BulletWorld, name: str, content: str, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)  # isn't installed
    file = tmp_path / name
    file.write_text(content)
    with pytest.raises(AssetError, match=command):
        Object("arm", "robot", file)


@pytest.mark.needs("xacro")
def test_xacro_is_expanded_in_its_package(tmp_path: Path, world: BulletWorld) -> None:
    folder = tmp_path / "arm_on_disk" / "urdf"
    folder.mkdir(parents=True)
    (folder.parent / "package.xml").write_text("<package><name>my_arm</name></package>")
    macro = f'<xacro:macro name="part" params="name"><link name="${{name}}">{BOX}</link></xacro:macro>'
    (folder / "parts.xacro").write_text(XACRO.format(macro))
    (folder / "arm.urdf.xacro").write_text(
        XACRO.format('<xacro:include filename="$(find my_arm)/urdf/parts.xacro"/><xacro:part name="a${1 + 1}"/>')
    )
    assert Object("arm", "robot", folder / "arm.urdf.xacro").links == ("a2",)
    for wrong, message in (
        ('<xacro:include filename="$(find other)/a.xacro"/>', "no package 'other' is known"),
        (
            '<link name="$(arg side)"/>',
            "xacro can't expand the file .*side.*; give its arguments to the command: xacro",
        ),
    ):
        (folder / "wrong.xacro").write_text(XACRO.format(wrong))
        with pytest.raises(AssetError, match=message):
            Object("wrong", "robot", folder / "wrong.xacro")


def test_an_expanded_xacro_is_a_urdf(tmp_path: Path, world: BulletWorld) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(XACRO.format(f'<link name="a">{BOX}</link>'))
    assert Object("arm", "robot", file).links == ("a",)


@pytest.mark.parametrize(("kind", "count"), [("fixed", 127), ("revolute", 121)])
def test_too_many_joints_are_rejected_with_their_number_and_the_maximum(
    tmp_path: Path, world: BulletWorld, kind: str, count: int
) -> None:
    def chain(joints: int) -> Path:
        links = "".join(f'<link name="l{number}"/>' for number in range(joints + 1))
        parts = "".join(
            f'<joint name="j{number}" type="{kind}"><origin xyz="0.01 0 0"/><parent link="l{number}"/>'
            f'<child link="l{number + 1}"/><limit lower="-1" upper="1"/></joint>'
            for number in range(joints)
        )
        return urdf(tmp_path, links + parts)

    most = Object("most", "environment", chain(count))
    assert most.get_link_position(f"l{count}") == pytest.approx([0.01 * count, 0, 0])
    most.set_joint_positions(dict.fromkeys(most.joints, 0.01))
    assert most.get_joint_positions() == pytest.approx(dict.fromkeys(most.joints, 0.01))
    with pytest.raises(AssetError, match=rf"has {count + 1} .*joints.*takes at most {count}$"):
        Object("more", "environment", chain(count + 1))


DEEP = 100_000
BROKEN = {
    "deep in Gazebo's": (
        "<link name='a'/><gazebo>" + "<x>" * DEEP + "</x>" * DEEP + "</gazebo>",
        None,
    ),
    "deep in a link": (f"<link name='a'>{'<link>' * DEEP}{'</link>' * DEEP}</link>", None),
    "deep in a geometry": (
        f"<link name='a'><visual><geometry>{'<box>' * DEEP}{'</box>' * DEEP}</geometry></visual></link>",
        "link 'a', visual, box: size takes 3 finite numbers",
    ),
    "cut off": ("<link name='a'><visual>", "is not well-formed XML: .*line 1"),
    "many entities": ("&x;", "is not well-formed XML: undefined entity"),
    "an unknown joint": (joint("ball"), "joint j is 'ball', not one of fixed, .*planar, floating"),
    "an infinite limit": (joint("revolute", "<limit lower='-inf' upper='1'/>"), "limit lower of joint j is '-inf'"),
    "a limit in words": (joint("prismatic", "<limit lower='0' upper='1m'/>"), "limit upper of joint j is '1m'"),
    "no limits": (joint("revolute"), "revolute joint j has no limits"),
    "an axis of two": (joint("continuous", "<axis xyz='0 1'/>"), "axis xyz of joint j is '0 1', not three numbers"),
    "a mimic in words": (
        joint("continuous", "<mimic joint='j' multiplier='x'/>"),
        "mimic multiplier of joint j is 'x'",
    ),
    "an unknown parent": (
        "<link name='b'/><link name='aa'/>" + joint("fixed")[32:],
        "parent 'a' of joint j isn't a link",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_name_file_element_and_cause(tmp_path: Path, world: BulletWorld, name: str) -> None:
    inside, cause = BROKEN[name]
    file = urdf(tmp_path, inside)
    if cause is None:
        assert Object("thing", "thing", file).links == ("a",)
        return
    with pytest.raises(AssetError, match=cause) as raised:
        Object("thing", "thing", file)
    assert raised.value.path == str(file)
    assert not world.objects


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_files_are_read_in_the_encoding_that_they_declare(tmp_path: Path, world: BulletWorld, encoding: str) -> None:
    file = tmp_path / "thing.urdf"
    text = f'<?xml version="1.0" encoding="{encoding}"?><robot name="Küche"><link name="Tür">{BOX}</link></robot>'
    file.write_bytes(text.encode(encoding))
    body = Object("thing", "thing", file)
    assert body.links == ("Tür",)
    assert body.urdf.name == "Küche"


@pytest.mark.parametrize("element", ["robot", "link", "joint"])
def test_names_that_would_crash_the_engine_are_rejected(tmp_path: Path, world: BulletWorld, element: str) -> None:
    long = "x" * 1100
    text = urdf(tmp_path, joint("continuous")).read_text()
    named = {"robot": ("thing", long), "link": ('"a"', f'"{long}"'), "joint": ('"j"', f'"{long}"')}[element]
    file = tmp_path / "long.urdf"
    file.write_text(text.replace(*named))
    with pytest.raises(AssetError, match="a name has 1100 bytes, xxxx"):
        Object("thing", "thing", file)
    assert not world.objects


def test_a_document_may_declare_a_namespace_for_its_own_elements(tmp_path: Path, world: BulletWorld) -> None:
    file = urdf(tmp_path, joint("continuous") + '<o:link xmlns:o="http://example.org" name="other"/>')
    file.write_text(file.read_text().replace("<robot", '<robot xmlns="http://drake.mit.edu"'))
    assert Object("thing", "thing", file).links == ("a", "b")


def test_a_joint_without_axis_turns_about_x_and_prints_nothing(
    tmp_path: Path, world: BulletWorld, capfd: pytest.CaptureFixture[str]
) -> None:
    body = Object("thing", "thing", urdf(tmp_path, joint("continuous")))
    assert body.urdf.joint("j").axis == (1.0, 0.0, 0.0)
    assert_as_written(body)
    assert capfd.readouterr() == ("", "")
