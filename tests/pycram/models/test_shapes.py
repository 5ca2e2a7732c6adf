"""Triangles of primitive shapes and OBJ files are closed, have the right volume and face outwards; hulls are SciPy's."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from pycram.models import load
from pycram.models.mesh import stl
from pycram.models.shapes import convex_hulls, piece_bounds, pieces_of, shapes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

URDF = '<robot name="t"><link name="a"><{0}><geometry>{1}</geometry></{0}></link></robot>'
#: A cube with a side of 2 m, of squares; numbers of normals and textures follow some corners, and some count backwards.
CUBE = """
o cube
v -1 -1 -1
v 1 -1 -1
v 1 1 -1
v -1 1 -1
v -1 -1 1
v 1 -1 1
v 1 1 1
v -1 1 1
vt 0 0
vn 0 0 1
f 1 4 3 2
f -4/1/1 -3/1/1 -2/1/1 -1/1/1
f 1//1 2//1 6//1 5//1
f 2 3 7 6
f 3 4 8 7
f 4/1 1/1 5/1 8/1
"""


def triangles(folder: Path, shape: str, role: str = "visual") -> NDArray[np.float64]:
    (folder / "thing.urdf").write_text(URDF.format(role, shape))
    return shapes_of(load.load(folder / "thing.urdf").path, role).triangles(0)


def volume(corners: NDArray[np.float64]) -> float:
    """Of what triangles enclose, m^3: negative if they are seen from inside."""
    return float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


def edges(corners: NDArray[np.float64]) -> list[tuple[bytes, bytes]]:
    """Ends of the edges of triangles, in their order."""
    ends = (corners.round(9) + 0.0).reshape(-1, 3, 3)
    return [(triangle[at].tobytes(), triangle[(at + 1) % 3].tobytes()) for triangle in ends for at in range(3)]


@pytest.mark.parametrize(
    ("shape", "size", "content"),
    [
        ('<box size="1 2 3"/>', (1, 2, 3), 6.0),
        ('<cylinder radius="0.5" length="2"/>', (1, 1, 2), math.pi / 2),
        ('<sphere radius="0.5"/>', (1, 1, 1), math.pi / 6),
        ('<capsule radius="0.5" length="2"/>', (1, 1, 3), math.pi / 2 + math.pi / 6),
        ('<mesh filename="cube.obj"/>', (2, 2, 2), 8.0),
    ],
)
@pytest.mark.parametrize("role", ["visual", "collision"])
def test_shapes_are_closed_and_have_the_right_volume(
    tmp_path: Path, shape: str, size: tuple[float, ...], content: float, role: str
) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    corners = triangles(tmp_path, shape, role)
    assert np.ptp(corners.reshape(-1, 3), axis=0) == pytest.approx(size)
    assert 0.97 * content < volume(corners) <= content * (1 + 1e-9)
    found = edges(corners)
    assert len(set(found)) == len(found)
    assert {(end, start) for start, end in found} == set(found), "each edge is that of two triangles, in turn"


@pytest.mark.parametrize("name", ["cube.STL", "cube.Obj"])
def test_a_mesh_may_have_an_upper_case_suffix(name: str, tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    if name.endswith("STL"):
        (tmp_path / name).write_bytes(stl(triangles(tmp_path, '<mesh filename="cube.obj"/>').astype("<f4")))
    else:
        (tmp_path / "cube.obj").rename(tmp_path / name)
    drawn = triangles(tmp_path, f'<mesh filename="{name}"/>', "collision")
    assert volume(drawn) == pytest.approx(8)
    model = load.load(tmp_path / "thing.urdf").path
    ((link, corners),) = pieces_of(model)
    assert (link, len(np.unique(corners, axis=0))) == ("a", 8)
    assert [ends for _, (low, high) in piece_bounds(model) for ends in (*low, *high)] == [-1] * 3 + [1] * 3


@pytest.mark.parametrize("model", ["kitchen.urdf", "bowl.stl", "pot.stl", "spoon.stl", "breakfast_cereal.stl"])
def test_hulls_have_the_planes_that_scipy_finds(model: str) -> None:
    every = [corners for _, corners in pieces_of(load.load(model).path)]
    assert every
    for corners in every:
        (hull,) = convex_hulls([corners])
        assert hull is not None
        assert _distinct(hull.planes) == _distinct(ConvexHull(corners).equations)


def test_corners_may_be_repeated_or_inside_the_hull() -> None:
    cube = np.array([(x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.2) for z in (0.0, 0.3)])
    (hull,) = convex_hulls([np.concatenate([cube, cube, [[0.05, 0.1, 0.15], [0.05, 0.1, 0.3]]])])
    assert hull is not None
    assert _distinct(hull.planes) == _distinct(ConvexHull(cube).equations)


@pytest.mark.parametrize("count", [2, 3, 30, 300])
def test_coplanar_points_have_no_hull(count: int) -> None:
    corners = np.column_stack([np.random.default_rng(0).random((count, 2)), np.full(count, 0.7)])
    assert convex_hulls([corners]) == [None]


@pytest.mark.slow
def test_surfaces_and_grasps_of_household_objects_need_no_scipy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYCRAM_CACHE", str(tmp_path / "cache"))
    program = """
import sys
from pycram.models import load
from pycram.models.shapes import solids_of
from pycram.models.furniture import furniture_of
print(len(furniture_of(load.load("kitchen.urdf")).surfaces), len(solids_of(load.load("milk.stl").path).links))
print("scipy" in sys.modules)
"""
    repo = Path(__file__).parents[3]
    for loaded in (True, False):  # at first the mesh is converted
        ended = subprocess.run([sys.executable, "-c", program], cwd=repo, capture_output=True, text=True, check=True)
        assert ended.stdout == f"43 3\n{loaded}\n"


@pytest.mark.slow
def test_round_meshes_need_scipy_in_the_first_process_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYCRAM_CACHE", str(tmp_path / "cache"))
    trimesh.creation.icosphere(subdivisions=3, radius=0.1).export(tmp_path / "ball.stl")
    (tmp_path / "ball.urdf").write_text(URDF.format("collision", '<mesh filename="ball.stl"/>'))
    program = """
import sys
from pycram.bullet_world import BulletWorld, Object
from pycram.bullet_world_reasoning import blocking
from pycram.models.shapes import solids_of
with BulletWorld():
    robot = Object("ur5", "robot", "ur5.urdf")
    ball = Object("ball", "ball", sys.argv[1], [0.5, 0.1, 0.3])
    blocking(ball, robot, next(iter(robot.description.arms.values())).tool_frame)
    solids = solids_of(ball.model.path)
print("scipy" in sys.modules, solids.normals.tobytes().hex(), solids.offsets.tobytes().hex())
"""
    command = [sys.executable, "-c", program, str(tmp_path / "ball.urdf")]

    def scipy_and_planes() -> list[str]:
        ended = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True, check=True)
        return ended.stdout.split()

    loaded, *planes = scipy_and_planes()
    assert loaded == "True"
    assert len(planes[1]) == 1286 * 8 * 2
    assert scipy_and_planes() == ["False", *planes]
    for entry in (tmp_path / "cache").iterdir():
        entry.write_bytes(entry.read_bytes()[:-1])
    assert scipy_and_planes() == ["True", *planes]


def _distinct(planes: np.ndarray) -> list[list[float]]:
    return (np.unique(planes.round(9), axis=0) + 0.0).tolist()  # 0.0: no -0.0
