"""The rasteriser against geometry: rays through the centers of pixels, triangle by triangle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pycram import vision
from pycram.vision import Window, rasterize

WINDOW = Window(-0.7, -0.5, 0.6, 0.4)
SIZE = (26, 18)
NEAR, FAR = 0.1, 6.0


def by_rays(triangles: np.ndarray) -> np.ndarray:
    """Depth at each pixel, each ray against each triangle (Moeller and Trumbore)."""
    width, height = SIZE
    x = WINDOW.left + (np.arange(width) + 0.5) / width * (WINDOW.right - WINDOW.left)
    y = WINDOW.top + (np.arange(height) + 0.5) / height * (WINDOW.bottom - WINDOW.top)
    rays = np.stack([*np.meshgrid(x, y), np.ones((height, width))], axis=-1)
    depth = np.full((height, width), np.inf)
    for a, b, c in triangles:
        across = np.cross(rays, c - a)
        share = across @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = across @ -a / share
            normal = np.cross(-a, b - a)
            v = rays @ normal / share
            t = (c - a) @ normal / share
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > NEAR) & (t <= FAR)
        depth = np.where(hit & (t < depth), t, depth)
    return depth


@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 40), spread=st.sampled_from([0.05, 0.5, 5.0]))
def test_the_visible_triangle_is_the_one_that_a_ray_hits(seed: int, count: int, spread: float) -> None:
    random = np.random.default_rng(seed)
    triangles = random.normal(size=(count, 1, 3)) * [1, 1, 2] + random.normal(size=(count, 3, 3)) * spread + [0, 0, 2]
    depth, seen = rasterize(triangles, WINDOW, SIZE, NEAR, FAR)
    truth = by_rays(triangles)
    same = np.isclose(depth, truth, rtol=1e-6) | (np.isinf(depth) & np.isinf(truth))
    assert (~same).sum() <= 2, "but for edges that pass through the center of a pixel"
    assert ((seen >= 0) == np.isfinite(depth)).all()


@pytest.mark.parametrize("z", [0.0, -0.0, NEAR, 1e-300])
def test_corners_in_the_plane_of_the_eye_or_the_near_plane(z: float) -> None:
    triangles = np.array([[[0.3, 0.2, z], [-5.0, 0.2, 3.0], [5.0, 0.2, 3.0]], [[0, 0, z], [1, 0, z], [0, 1, z]]])
    depth, seen = rasterize(triangles, WINDOW, SIZE, NEAR, FAR)
    assert set(np.unique(seen)) == {-1, 0}
    assert (depth[seen == 0] > NEAR).all()


def test_the_nearest_of_large_and_small_triangles_is_visible() -> None:
    wall = np.array([[[-9, -9, 5.0], [9, -9, 5.0], [9, 9, 5.0]], [[-9, -9, 5.0], [9, 9, 5.0], [-9, 9, 5.0]]])
    grid = np.linspace(-0.9, 0.9, 7)
    tiles = np.array([[[x, y, 3.0], [x + 0.2, y, 3.0], [x, y + 0.2, 3.0]] for x in grid for y in grid])
    depth, seen = rasterize(np.concatenate([wall, tiles]), WINDOW, (260, 180), NEAR, FAR)
    assert (seen >= 0).all()
    assert depth[seen < 2] == pytest.approx(5.0)
    assert depth[seen >= 2] == pytest.approx(3.0)
    assert len(np.unique(seen[seen >= 2])) > 40


@pytest.mark.slow
@pytest.mark.parametrize("flat", [False, True])
def test_large_triangles_drawn_in_bands_are_complete(flat: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(3)
    for _ in range(12):
        triangles = random.normal(size=(8, 3, 3)) * random.choice([0.3, 2, 20]) + [0, 0, 2]
        if flat:
            triangles[:, 1, 1:] = triangles[:, 0, 1:]  # an edge along the rows
        drawn = []
        for large in (-1, 1 << 30):
            monkeypatch.setattr(vision, "_LARGE", large)
            drawn.append(rasterize(triangles, WINDOW, (60, 80), NEAR, FAR))
        assert (drawn[0][1] == drawn[1][1]).all()
        assert drawn[0][0] == pytest.approx(drawn[1][0])


def test_without_triangles_nothing_is_seen() -> None:
    depth, seen = rasterize(np.zeros((0, 3, 3)), WINDOW, SIZE, NEAR, FAR)
    assert np.isinf(depth).all()
    assert (seen == -1).all()
