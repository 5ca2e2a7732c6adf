"""Household objects: their sizes, their hollows, and how they stand and lie."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh

if TYPE_CHECKING:
    from pathlib import Path

    from tests.resources.conftest import Bench

NAMES = (
    "apple",
    "bottle",
    "bowl",
    "breakfast_cereal",
    "cup",
    "fork",
    "glass",
    "knife",
    "milk",
    "plate",
    "pot",
    "spoon",
)
SIZES = {
    "milk": (0.064, 0.065, 0.194),
    "breakfast_cereal": (0.148, 0.058, 0.224),
    "bowl": (0.140, 0.139, 0.067),
    "spoon": (0.217, 0.046, 0.019),
}
CUTLERY = ("fork", "knife", "spoon")
ISLAND_TOP = 0.851
BOWL_HALF, SPOON_HALF = 0.067 / 2, 0.019 / 2


def half_height(resources: Path, name: str) -> float:
    return float(trimesh.load_mesh(resources / f"{name}.stl").extents[2]) / 2


def pieces_of(path: Path) -> list[trimesh.Trimesh]:
    groups: list[tuple[list[list[float]], list[list[int]]]] = []
    before = 0
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "o":
            before += len(groups[-1][0]) if groups else 0
            groups.append(([], []))
        elif kind == "v":
            groups[-1][0].append([float(value) for value in rest.split()])
        elif kind == "f":
            groups[-1][1].append([int(index) - 1 - before for index in rest.split()])
    return [trimesh.Trimesh(vertices, faces, process=False) for vertices, faces in groups]


def test_every_object_has_a_mesh_and_a_table(resources: Path, bench: Bench) -> None:
    assert sorted(path.stem for path in resources.glob("*.stl")) == list(NAMES)
    assert sorted(bench.table) == list(NAMES)


@pytest.mark.parametrize(("name", "size"), SIZES.items())
def test_sizes_are_those_of_the_thesis(resources: Path, name: str, size: tuple[float, float, float]) -> None:
    assert trimesh.load_mesh(resources / f"{name}.stl").extents == pytest.approx(size, abs=2e-6)


@pytest.mark.parametrize("name", NAMES)
def test_a_mesh_is_closed_and_about_its_origin(resources: Path, name: str) -> None:
    mesh = trimesh.load_mesh(resources / f"{name}.stl")

    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.bounds.mean(axis=0) == pytest.approx([0, 0, 0], abs=2e-6)
    assert len(mesh.faces) < 3000


@pytest.mark.parametrize("name", NAMES)
def test_pieces_for_collision_are_convex_and_within_the_mesh(resources: Path, name: str) -> None:
    mesh = trimesh.load_mesh(resources / f"{name}.stl")
    pieces = pieces_of(resources / f"{name}.collision.obj")

    for piece in pieces:
        assert piece.is_watertight
        assert piece.volume > 0
        assert piece.convex_hull.volume == pytest.approx(piece.volume, rel=0.02, abs=1e-11)
    bounds = np.array([piece.bounds for piece in pieces])
    assert (bounds[:, 0].min(axis=0) >= mesh.bounds[0] - 1e-5).all()
    assert (bounds[:, 1].max(axis=0) <= mesh.bounds[1] + 1e-5).all()


@pytest.mark.parametrize("name", NAMES)
def test_parts_cover_the_object_and_no_more(resources: Path, bench: Bench, name: str) -> None:
    mesh = trimesh.load_mesh(resources / f"{name}.stl")
    parts = [trimesh.load_mesh(resources / part["mesh"]) for part in bench.table[name]["visual"]]

    assert np.min([part.bounds[0] for part in parts], axis=0) == pytest.approx(mesh.bounds[0], abs=8e-4)
    assert np.max([part.bounds[1] for part in parts], axis=0) == pytest.approx(mesh.bounds[1], abs=8e-4)


def test_the_renderer_shows_the_colours_of_a_carton_of_milk(bench: Bench) -> None:
    bench.thing("milk", [0, 0, 0])

    pixels = bench.picture([0.35, -0.25, 0.15], [0, 0, 0])

    red, green, blue = pixels.T
    assert ((blue > red + 60) & (blue > green + 30)).sum() > 200, "blue print"
    assert ((red > green + 60) & (red > blue + 60)).sum() > 20, "red cap"
    assert ((abs(red - blue) < 20) & (red > 100) & (red < 250)).sum() > 1000, "white carton"


@pytest.mark.slow
def test_things_stand_upright_on_the_island(resources: Path, bench: Bench) -> None:
    bench.fixed(resources / "kitchen.urdf")
    standing = [name for name in NAMES if name not in CUTLERY]
    halves = {name: half_height(resources, name) for name in standing}
    bodies = {
        name: bench.thing(name, [-1.35 + 0.3 * (k % 3), 0.7 + 0.3 * (k // 3), ISLAND_TOP + halves[name] + 0.001])
        for k, name in enumerate(standing)
    }

    bench.simulate(0.25)
    start = {name: bench.pose(body)[0] for name, body in bodies.items()}
    bench.simulate(2.0)

    for name, body in bodies.items():
        end, turn = bench.pose(body)
        assert end[2] - halves[name] == pytest.approx(ISLAND_TOP, abs=3e-4), f"{name} on its real underside"
        assert np.linalg.norm(end - start[name]) < 0.0005, name
        assert turn[2, 2] > np.cos(np.radians(0.5)), name


@pytest.mark.slow
def test_cutlery_lies_still_on_the_counter(resources: Path, bench: Bench) -> None:
    bench.fixed(resources / "kitchen.urdf")
    halves = {name: half_height(resources, name) for name in CUTLERY}
    bodies = {
        name: bench.thing(name, [1.45, 0.4 + 0.2 * k, 0.85 + halves[name] + 0.002]) for k, name in enumerate(CUTLERY)
    }

    bench.simulate(0.5)
    start = {name: bench.pose(body)[0] for name, body in bodies.items()}
    bench.simulate(2.0)

    for name, body in bodies.items():
        end, turn = bench.pose(body)
        assert end[2] - halves[name] == pytest.approx(0.85, abs=1e-3), name
        assert np.linalg.norm(end - start[name]) < 0.0005, name
        assert turn[2, 2] > 0.999, name


@pytest.mark.parametrize(("name", "floor"), [("bowl", 0.0085), ("cup", 0.0065), ("glass", 0.011), ("pot", 0.0065)])
def test_vessels_are_hollow_for_collision(resources: Path, bench: Bench, name: str, floor: float) -> None:
    mesh = trimesh.load_mesh(resources / f"{name}.stl")
    bench.thing(name, [0, 0, 0])
    # the middle of the round body, which isn't that of the bounding box where there is a handle
    middle = float(mesh.vertices[mesh.vertices[:, 2] < mesh.bounds[0][2] + 1e-6][:, 0].mean())

    assert bench.touched_below(middle + 0.01, 0.0, 1.0) - mesh.bounds[0][2] < floor


@pytest.mark.parametrize("drop", [0.0, 0.012])
@pytest.mark.slow
def test_a_spoon_stays_where_it_is_laid_across_a_bowl(resources: Path, bench: Bench, drop: float) -> None:
    bench.fixed(resources / "kitchen.urdf")
    pairs = []
    for k, yaw in enumerate((0.0, 0.7, np.pi / 2, np.pi)):
        at = [-1.05, 0.8 + 0.3 * k]
        bowl = bench.thing("bowl", [*at, ISLAND_TOP + BOWL_HALF])
        spoon = bench.thing("spoon", [*at, ISLAND_TOP + 0.067 + SPOON_HALF + drop], (0, 0, yaw))
        pairs.append((bowl, spoon))

    bench.simulate(0.25)
    start = [bench.pose(spoon)[0] for _, spoon in pairs]
    bench.simulate(2.0)

    for (bowl, spoon), before in zip(pairs, start, strict=True):
        end, _ = bench.pose(spoon)
        assert np.linalg.norm(end - before) < 0.003
        assert np.linalg.norm((end - bench.pose(bowl)[0])[:2]) < 0.005
        assert ISLAND_TOP + 0.067 < end[2] < ISLAND_TOP + 0.067 + 0.019, "on the rim"


@pytest.mark.slow
def test_a_spoon_dropped_into_a_bowl_stays_in_it(resources: Path, bench: Bench) -> None:
    bench.fixed(resources / "kitchen.urdf")
    pitch, half_length = 1.0, 0.1085
    rim = ISLAND_TOP + 0.067
    height = rim + 0.05 + half_length * np.sin(pitch)
    pairs = []
    for k, place in enumerate((-0.03, 0.0)):
        x, y = -1.05, 0.8 + 0.4 * k
        bowl = bench.thing("bowl", [x, y, ISLAND_TOP + BOWL_HALF])
        pairs.append((bowl, bench.thing("spoon", [x + place, y, height], (0, pitch, 0))))

    bench.simulate(2.0)

    for bowl, spoon in pairs:
        position, turn = bench.pose(spoon)
        head = position + turn @ np.array([0.0765, 0.0, 0.0])
        assert head[2] < rim - 0.02, "its head is down in the bowl"
        assert np.linalg.norm((head - bench.pose(bowl)[0])[:2]) < 0.07
        assert bench.gap(spoon, bowl) < 0.001
