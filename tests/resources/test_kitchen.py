"""The kitchen and the floor: layout as in the table, doors and drawers that open, things that lie inside."""

from __future__ import annotations

import itertools
import json
import math
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from tests.resources.conftest import Bench

UPPER_DRAWER = "sink_area_left_upper_drawer_main"
FIXED, PRISMATIC = 4, 1
THINGS = ("milk", "bowl", "spoon", "plate")
TUCKED = {
    "shoulder_pan": 1.71,
    "shoulder_lift": -0.26,
    "upper_arm_roll": 1.4,
    "elbow_flex": -2.12,
    "forearm_roll": 0.0,
    "wrist_flex": -0.07,
    "wrist_roll": 0.0,
}
MIRRORED = {"shoulder_pan", "upper_arm_roll", "forearm_roll", "wrist_roll"}


@pytest.fixture(scope="session")
def table(resources: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads((resources / "make" / "kitchen.json").read_text(encoding="utf-8"))["links"]
    return rows


@pytest.fixture(scope="session")
def robot(resources: Path) -> ET.Element:
    return ET.parse(resources / "kitchen.urdf").getroot()


def numbers(text: str | None) -> list[float]:
    return [float(value) for value in (text or "").split()]


def moving_group(bench: Bench, kitchen: int) -> dict[int, int]:
    """For each link the movable link that carries it, or -1."""
    infos = [bench.info(kitchen, joint) for joint in range(bench.joint_count(kitchen))]
    groups = {-1: -1}
    for link in range(len(infos)):
        at = link
        while at >= 0 and infos[at][2] == FIXED:
            at = infos[at][16]
        groups[link] = at
    return groups


def test_links_and_joints_are_those_of_the_table(robot: ET.Element, table: list[dict[str, Any]]) -> None:
    assert [link.get("name") for link in robot.findall("link")] == [row["link"] for row in table]
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    jointed = [row for row in table if "joint" in row]
    assert len(joints) == len(jointed) == len(table) - 1

    for row in jointed:
        joint = joints[row["joint"]]
        parent, child, origin = joint.find("parent"), joint.find("child"), joint.find("origin")
        assert parent is not None
        assert child is not None
        assert origin is not None
        assert (joint.get("type"), parent.get("link"), child.get("link")) == (row["type"], row["parent"], row["link"])
        assert numbers(origin.get("xyz")) == pytest.approx(row["xyz"], abs=1e-6)
        assert numbers(origin.get("rpy")) == pytest.approx(row["rpy"], abs=1e-6)
        axis, limit = joint.find("axis"), joint.find("limit")
        if row["type"] == "fixed":
            assert axis is None
            continue
        assert axis is not None
        assert limit is not None
        assert numbers(axis.get("xyz")) == pytest.approx(row["axis"], abs=1e-6)
        limits = [float(limit.get("lower", "nan")), float(limit.get("upper", "nan"))]
        assert limits == pytest.approx(row["limits"], abs=1e-6)
        assert limits[0] < limits[1]


def test_shapes_keep_to_the_boxes_of_the_table(robot: ET.Element, table: list[dict[str, Any]]) -> None:
    links = {link.get("name"): link for link in robot.findall("link")}
    compared = 0
    for row in table:
        # the island's described box is that of its top, which stands over its body
        if "box" not in row or "note" in row or row["link"] == "kitchen_island":
            continue
        corners = []
        for shape in links[row["link"]].findall("collision"):
            origin, box = shape.find("origin"), shape.find("geometry/box")
            assert origin is not None
            assert box is not None
            centre, size = np.array(numbers(origin.get("xyz"))), np.array(numbers(box.get("size")))
            corners.append((centre - size / 2, centre + size / 2))
        low, high = np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)
        centre, size = np.array(row["box"]["centre"]), np.array(row["box"]["size"])
        assert (low >= centre - size / 2 - 0.031).all(), row["link"]
        assert (high <= centre + size / 2 + 0.031).all(), row["link"]
        assert (high - low >= 0.4 * size).all(), row["link"]  # of a knob only what sticks out of its panel
        compared += 1
    assert compared > 50


def test_links_have_few_primitive_shapes_and_all_have_a_mass(robot: ET.Element) -> None:
    assert len(robot.findall("link/collision")) < 250
    assert robot.find("link/collision/geometry/mesh") is None
    materials = {material.get("name") for material in robot.findall("material")}
    for link in robot.findall("link"):
        mass = link.find("inertial/mass")
        assert mass is not None
        assert float(mass.get("value", "0")) > 0
        inertia = link.find("inertial/inertia")
        assert inertia is not None
        assert all(float(inertia.get(axis, "0")) > 0 for axis in ("ixx", "iyy", "izz"))
        assert {material.get("name") for material in link.findall("visual/material")} <= materials


def test_worktops_are_where_plans_expect_them(resources: Path, bench: Bench) -> None:
    kitchen = bench.fixed(resources / "kitchen.urdf")
    links = bench.names(kitchen)[1]

    counter = bench.extent(kitchen, links["sink_area_surface"])
    # the engine grows the bounding box of a link of several boxes by 1 mm
    grown = np.array([[1.2465, -0.286, 0.829], [1.8235, 1.316, 0.851]])
    assert counter == pytest.approx(grown, abs=1e-4)
    assert bench.extent(kitchen, links["kitchen_island_surface"])[1][2] == pytest.approx(0.851, abs=1e-4)
    for x, y in ((1.3, 1.0), (1.3, 0.8), (1.3, 0.6)):
        assert bench.touched_below(x, y, 2.0) == pytest.approx(0.85, abs=1e-4)
    for x, y in ((-0.8, 1.0), (-0.8, 1.2), (-1.0, 1.0)):
        assert bench.touched_below(x, y, 2.0) == pytest.approx(0.851, abs=1e-4)
    assert bench.touched_below(-1.4, -1.05, 2.0) == pytest.approx(0.725, abs=1e-4)


def test_the_sink_is_a_basin(resources: Path, bench: Bench) -> None:
    bench.fixed(resources / "kitchen.urdf")

    assert bench.touched_below(1.53, -0.36, 0.95) < 0.85 - 0.17


def test_the_floor_is_at_zero_and_wide(resources: Path, bench: Bench) -> None:
    floor = bench.fixed(resources / "plane.urdf")

    assert list(bench.names(floor)[1]) == ["floor"]
    for x, y in ((0.0, 0.0), (14.9, -14.9), (990.0, -990.0)):
        assert bench.touched_below(x, y, 1.0) == pytest.approx(0.0, abs=1e-6)


def test_things_lie_on_the_floor_a_kilometre_away_as_in_the_middle(resources: Path, bench: Bench) -> None:
    bench.fixed(resources / "plane.urdf")
    places = ((0, 0), (990, 1), (200, -990))
    things = [[bench.thing(name, [x + k, y, 0.1]) for x, y in places] for k, name in enumerate(THINGS)]

    bench.simulate(2.0)
    for name, (middle, *far) in zip(THINGS, things, strict=True):
        height = bench.pose(middle)[0][2]
        assert [bench.pose(thing)[0][2] for thing in far] == pytest.approx([height] * 2, abs=2e-5), name


def test_nothing_touches_its_neighbours_wherever_it_is_opened(resources: Path, bench: Bench) -> None:
    kitchen, floor = bench.fixed(resources / "kitchen.urdf"), bench.fixed(resources / "plane.urdf")
    groups = moving_group(bench, kitchen)
    movable = sorted({group for group in groups.values() if group >= 0})
    assert len(movable) == 23

    for a, b in itertools.combinations(groups, 2):
        if groups[a] != groups[b]:
            assert bench.gap(kitchen, kitchen, a, b) > 0.0015, (a, b)
    for joint in movable:
        name, upper = bench.info(kitchen, joint)[1].decode(), bench.info(kitchen, joint)[9]
        for part in (0.03, 0.1, 0.25, 0.5, 1.0):
            bench.set_joint(kitchen, joint, part * upper)
            for a in (link for link, group in groups.items() if group == joint):
                for b in (link for link, group in groups.items() if group != joint):
                    assert bench.gap(kitchen, kitchen, a, b) > 0.001, (name, part, b)
                assert bench.gap(kitchen, floor, a, -1) > 0.01, (name, part)
        bench.set_joint(kitchen, joint, 0.0)


@pytest.mark.parametrize(
    ("door", "falls"),
    [("sink_area_dish_washer_door", True), ("oven_area_oven_door", True), ("iai_fridge_door", False)],
)
def test_doors_open_into_the_room(resources: Path, bench: Bench, door: str, falls: bool) -> None:
    kitchen = bench.fixed(resources / "kitchen.urdf")
    joints, links = bench.names(kitchen)
    handle = links[f"{door}_handle"]
    closed = bench.link_position(kitchen, handle)
    bench.set_joint(kitchen, joints[f"{door}_joint"], math.radians(90))

    moved = bench.link_position(kitchen, handle) - closed

    assert moved[0] < -0.3, "towards the room, which is at smaller x"
    assert (moved[2] < -0.3) == falls


def test_drawers_open_by_48_centimetres_towards_the_room(resources: Path, bench: Bench) -> None:
    kitchen = bench.fixed(resources / "kitchen.urdf")
    drawers = [joint for joint in range(bench.joint_count(kitchen)) if bench.info(kitchen, joint)[2] == PRISMATIC]
    assert len(drawers) == 15
    for joint in drawers:
        closed = bench.link_position(kitchen, joint)
        bench.set_joint(kitchen, joint, 0.48)
        moved = bench.link_position(kitchen, joint) - closed
        inwards = 1.0 if "island" in bench.info(kitchen, joint)[1].decode() else -1.0
        assert moved[0] == pytest.approx(inwards * 0.48, abs=1e-3)


@pytest.mark.slow
def test_a_spoon_rests_inside_the_drawer(resources: Path, bench: Bench) -> None:
    kitchen = bench.fixed(resources / "kitchen.urdf")
    joints, links = bench.names(kitchen)
    drawer = links[UPPER_DRAWER]
    bench.set_joint(kitchen, joints[f"{UPPER_DRAWER}_joint"], 0.48)
    bench.simulate(1 / 240)
    x, y, z = bench.link_position(kitchen, drawer)
    bottom, rim = z - 0.051, z + 0.029
    spoon = bench.thing("spoon", [x, y, bottom + 0.0095 + 0.005], (0, 0, 0.8))

    bench.simulate(1.0)
    position, _ = bench.pose(spoon)
    low, high = bench.extent(spoon, -1)

    assert position[2] - 0.0095 == pytest.approx(bottom, abs=1e-3)
    assert high[2] < rim
    assert high[2] < 0.83, "under the counter"
    outer = bench.extent(kitchen, drawer)
    assert (low[:2] > outer[0][:2]).all()
    assert (high[:2] < outer[1][:2]).all()
    before = position
    bench.simulate(1.0)
    assert np.linalg.norm(bench.pose(spoon)[0] - before) < 5e-4


def test_a_spoon_in_the_closed_drawer_is_not_pushed_out(resources: Path, bench: Bench) -> None:
    kitchen = bench.fixed(resources / "kitchen.urdf")
    x, y, z = bench.link_position(kitchen, bench.names(kitchen)[1][UPPER_DRAWER])
    spoon = bench.thing("spoon", [x, y, z - 0.051 + 0.0095], (0, 0, 1.57))

    bench.simulate(1.0)

    assert bench.pose(spoon)[0] == pytest.approx([x, y, z - 0.0415], abs=2e-3)


def test_the_pr2_has_room_at_the_counter_and_at_the_island(resources: Path, bench: Bench, pr2: Path) -> None:
    kitchen, robot = bench.fixed(resources / "kitchen.urdf"), bench.fixed(pr2)
    drawer = bench.names(kitchen)[0][f"{UPPER_DRAWER}_joint"]
    joints = bench.names(robot)[0]
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for name, value in TUCKED.items():
            bench.set_joint(robot, joints[f"{side}_{name}_joint"], value * (sign if name in MIRRORED else 1.0))
    bench.set_joint(robot, joints["torso_lift_joint"], 0.2)

    bench.place(robot, [0.65, 0.7, 0.0], 0.0)
    assert bench.gap(robot, kitchen) > 0.04
    bench.set_joint(kitchen, drawer, 0.3)
    assert bench.gap(robot, kitchen) > 0.04
    bench.set_joint(kitchen, drawer, 0.0)
    bench.place(robot, [-0.3, 1.0, 0.0], math.pi)
    assert bench.gap(robot, kitchen) > 0.04
