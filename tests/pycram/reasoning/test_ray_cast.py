"""Ray casts: where lines enter and leave convex pieces is where rays of the engine hit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.physics.engine import bullet
from pycram.reasoning.collision.ray_cast import RayCaster, Scan
from recorder import geometry

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.geometry import Pose

PADS = (-0.01, 0.0, 0.01)


def cast_by_engine(body: Object, frame: Pose, xs: list[float], zs: tuple[float, ...], sign: float) -> np.ndarray:
    """(xs, zs): the y at which a ray along the frame's y axis (times the sign) first hits something; nan if nothing."""
    client = body.world.engine._client
    bullet.performCollisionDetection(physicsClientId=client)
    starts = [geometry.transform(frame, (x, -sign, z)) for x in xs for z in zs]
    ends = [geometry.transform(frame, (x, sign, z)) for x in xs for z in zs]
    hits = bullet.rayTestBatch(starts, ends, physicsClientId=client)
    found = [sign * (2 * hit[2] - 1) if hit[0] >= 0 else math.nan for hit in hits]
    return np.array(found).reshape(len(xs), len(zs))


@pytest.mark.parametrize("name", ["milk", "breakfast_cereal", "bowl", "cup", "plate", "bottle", "fork", "apple", "pot"])
def test_extents_agree_with_the_engines_rays(world: BulletWorld, name: str) -> None:
    body = Object(name, name, f"{name}.stl", [1, 2, 1], list(geometry.from_rpy(0.2, -0.3, 0.7)))
    caster = RayCaster(body)
    for turn in (geometry.from_rpy(0, 0, 0.3), geometry.from_rpy(0.5, math.pi / 2, 0)):
        frame = (caster.center, turn)
        xs = np.linspace(-0.1, 0.1, 41).tolist()
        low, high = cast_by_engine(body, frame, xs, PADS, 1.0), cast_by_engine(body, frame, xs, PADS, -1.0)
        (found,) = caster.extents([Scan(frame, -0.1, 0.005)], 41, PADS)
        there = ~np.isnan(found[:, 0])
        found_there = ~np.isnan(low).all(axis=1) & ~np.isnan(high).all(axis=1)
        assert (there == found_there).mean() > 0.85, "they differ where a ray grazes an edge"
        both = there & found_there
        wrong = np.abs(found[both] - np.column_stack([np.nanmin(low[both], axis=1), np.nanmax(high[both], axis=1)]))
        assert np.median(wrong) < 1e-3


@pytest.mark.parametrize(("name", "inside"), [("bowl", 0.0625), ("glass", 0.0285), ("pot", 0.0944)])
def test_walls_of_hollow_objects(world: BulletWorld, name: str, inside: float) -> None:
    body = Object(name, name, f"{name}.stl", [1, 2, 1])
    caster = RayCaster(body)
    x, y, _ = caster.center
    high, low = caster.high[2] - 0.012, caster.low[2] - 0.01
    frames = [((x, y, 0.0), geometry.from_rpy(0, 0, yaw)) for yaw in (0.0, 1.0, 2.0)]
    for rim, below in caster.walls([Scan(frame, high, low - high) for frame in frames], 2, PADS):
        assert rim[0] == pytest.approx(inside, abs=0.002)
        assert rim[0] + 0.003 < rim[1]
        assert np.isnan(below).all()


def test_solid_or_missing_pieces_have_no_inner_wall(world: BulletWorld) -> None:
    caster = RayCaster(Object("apple", "apple", "apple.stl", [1, 2, 1]))
    x, y, z = caster.center
    ((within, above),) = caster.walls([Scan(((x, y, 0.0), (0, 0, 0, 1)), z, 1.0)], 2, (0.0,))
    assert math.isnan(within[0])
    assert within[1] == pytest.approx(0.04, abs=0.01)
    assert np.isnan(above).all()
    beside, through = caster.extents([Scan(((x, y, at), (0, 0, 0, 1)), 0.0, 0.0) for at in (z + 1, z)], 1, PADS)
    assert np.isnan(beside).all()
    assert through[0, 0] == pytest.approx(-through[0, 1])


def test_rays_hit_shapes_of_all_kinds(world: BulletWorld, tmp_path: Path) -> None:
    """Boxes, cylinders, spheres on links that have moved; and nothing at all."""
    parts = {"l0": '<box size="0.1 0.2 0.3"/>', "l1": '<cylinder radius="0.05" length="0.2"/>'}
    links = "".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial><collision><geometry>{shape}</geometry></collision></link>"
        for name, shape in parts.items()
    )
    joint = (
        '<joint name="slide" type="prismatic"><parent link="l0"/><child link="l1"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="1" effort="9" velocity="9"/></joint>'
    )
    file = tmp_path / "two.urdf"
    file.write_text(f'<robot name="two">{links}{joint}</robot>')
    two = Object("two", "two", file, [0, 0, 1])
    for value, far in ((0.0, 0.1), (0.4, 0.45)):
        two.set_joint_position("slide", value)
        (((low, high),),) = RayCaster(two).extents([Scan(((0, 0, 1), (0, 0, 0, 1)), 0.0, 0.0)], 1, (0.0,))
        assert low == pytest.approx(-0.1, abs=0.002)
        assert high == pytest.approx(far, abs=0.002)
    bare = tmp_path / "frame.urdf"
    bare.write_text('<robot name="frame"><link name="nothing"/></robot>')
    frame = RayCaster(Object("frame", "frame", bare))
    scan = Scan(((0, 0, 0), (0, 0, 0, 1)), 0.0, 0.0)
    assert np.isnan(frame.extents([scan], 1, (0.0,))).all()
    assert np.isnan(frame.walls([scan], 1, (0.0,))).all()
