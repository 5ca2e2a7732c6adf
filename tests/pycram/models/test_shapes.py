"""What is drawn of shapes that files only name, and of OBJ files: closed, as large as they say, seen from outside."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram.models import load
from pycram.models.mesh import stl
from pycram.models.shapes import piece_bounds, pieces_of, shapes_of

if TYPE_CHECKING:
    from pathlib import Path

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
    (drawn,) = shapes_of(load.load(folder / "thing.urdf").path, role).triangles
    return drawn


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
def test_shapes_are_closed_and_as_large_as_they_say(
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
def test_a_mesh_may_have_its_suffix_in_capitals(name: str, tmp_path: Path) -> None:
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
