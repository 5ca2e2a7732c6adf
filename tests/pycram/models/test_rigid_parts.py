"""The rigid parts of a model collide as the model does: the engine compares them at random poses."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.models import load, shapes
from pycram.physics.engine import Engine
from pycram.reasoning.collision import simulation_clone
from recorder import geometry
from tests import large_kitchen

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NEAR = 0.3  # m


@pytest.fixture
def row(world: BulletWorld, tmp_path: Path) -> Object:
    """Furniture of boxes and meshes that stands askew, with open drawers."""
    urdf = large_kitchen.write_row(tmp_path, "row", 0)
    made = Object("row", "environment", urdf, [0.3, -0.2, 0.1], geometry.from_rpy(0.1, -0.2, 0.7), world=world)
    made.set_joint_positions({joint: random.Random(0).uniform(0, large_kitchen.OPEN) for joint in made.joints})
    return made


@pytest.fixture
def engine() -> Iterator[Engine]:
    made = Engine()
    yield made
    made.close()


def nearest(engine: Engine, probe: object, bodies: list[object]) -> float:
    return min((p.distance for body in bodies for p in engine.closest_points(probe, body, NEAR)), default=math.inf)


@pytest.mark.slow
def test_rigid_parts_and_single_links_are_where_the_model_is(world: BulletWorld, row: Object, engine: Engine) -> None:
    def loaded(path: Path, link: str) -> object:
        return engine.load(path, row.get_link_position_and_orientation(link), fixed=True)

    path = row.model.path
    rigid = [loaded(part.path, part.frame) for part in simulation_clone.divided(path)]
    assert len(rigid) == 1 + len(row.joints), "what never moves, and each drawer"
    solid = shapes.shapes_of(path, "collision").links
    assert sorted(link for part in simulation_clone.divided(path) for link in part.links) == sorted(solid)
    single = [loaded(simulation_clone.single_link(path, link), link) for link in solid]
    model = load.load("knife.stl")
    probe, there = engine.load(model.path, geometry.IDENTITY, fixed=False), Object("knife", "knife", "knife.stl")
    rng, near = random.Random(1), 0
    low, high = row.get_AABB()
    for _ in range(200):
        at = [rng.uniform(a, b) for a, b in zip(low, high, strict=True)]
        turn = geometry.from_rpy(rng.uniform(-3, 3), rng.uniform(-1, 1), rng.uniform(-3, 3))
        there.set_position_and_orientation(at, turn)
        engine.set_pose(probe, (at, turn))
        expected = nearest(world.engine, there.handle, [row.handle])
        near += expected < NEAR
        for bodies in (rigid, single):
            assert nearest(engine, probe, bodies) == pytest.approx(expected, abs=1e-5)
    assert near > 50


def test_links_with_different_friction_are_different_parts(tmp_path: Path) -> None:
    link = '<link name="{}"><collision><geometry><box size="1 1 1"/></geometry></collision>{}</link>'
    ice = '<contact><lateral_friction value="0.01"/></contact>'
    links = "".join(link.format(name, ice if name == "b" else "") for name in "abc")
    joint = '<joint name="{0}" type="fixed"><parent link="a"/><child link="{0}"/></joint>'
    file = tmp_path / "floor.urdf"
    file.write_text(f'<robot name="floor">{links}{joint.format("b")}{joint.format("c")}</robot>')
    found = simulation_clone.divided(load.load(file).path)
    assert [part.links for part in found] == [("a", "c"), ("b",)]
    assert [b"0.01" in part.path.read_bytes() for part in found] == [False, True]


@pytest.mark.parametrize("name", ["kitchen.urdf", "pr2.urdf", "bowl.stl", "knife.stl"])
def test_bounds_of_pieces_contain_their_corners(name: str) -> None:
    path = load.load(name).path
    expected = [(link, *corners.min(axis=0), *corners.max(axis=0)) for link, corners in shapes.pieces_of(path)]
    found = [(link, *low, *high) for link, (low, high) in shapes.piece_bounds(path)]
    assert [link for link, *_ in found] == [link for link, *_ in expected]
    for (_, *ends), (_, *right) in zip(found, expected, strict=True):
        assert ends == pytest.approx(right, abs=1e-9)
