"""Convex hulls of few corners are those that scipy finds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from pycram.models import load
from pycram.models.shapes import convex_hull, pieces_of


@pytest.mark.parametrize("model", ["kitchen.urdf", "bowl.stl", "pot.stl", "spoon.stl", "breakfast_cereal.stl"])
def test_the_planes_around_pieces_are_those_that_scipy_finds(model: str) -> None:
    every = [corners for _, corners in pieces_of(load.load(model).path)]
    assert every
    for corners in every:
        hull = convex_hull(corners)
        assert hull is not None
        assert _distinct(hull.planes) == _distinct(ConvexHull(corners).equations)


def test_corners_may_be_repeated_and_lie_inside() -> None:
    cube = np.array([(x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.2) for z in (0.0, 0.3)])
    hull = convex_hull(np.concatenate([cube, cube, [[0.05, 0.1, 0.15], [0.05, 0.1, 0.3]]]))
    assert hull is not None
    assert _distinct(hull.planes) == _distinct(ConvexHull(cube).equations)


@pytest.mark.parametrize("count", [2, 3, 30, 300])
def test_what_is_flat_has_no_hull(count: int) -> None:
    corners = np.column_stack([np.random.default_rng(0).random((count, 2)), np.full(count, 0.7)])
    assert convex_hull(corners) is None


@pytest.mark.slow
def test_surfaces_and_grasps_of_household_things_are_found_without_loading_scipy(
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


def _distinct(planes: np.ndarray) -> list[list[float]]:
    return (np.unique(planes.round(9), axis=0) + 0.0).tolist()  # 0.0: no -0.0
