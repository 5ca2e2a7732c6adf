"""Surfaces, drawers, doors and handles are found, and nothing else; a TOML file corrects them."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import AssetError, UnknownName
from pycram.models import level_faces, load
from pycram.models.corrections import SUFFIX
from pycram.models.furniture import furniture_of
from pycram.models.surfaces import DOOR, DRAWER, Furniture
from recorder import geometry
from tests.large_kitchen import CABINETS, TOP, write_row

if TYPE_CHECKING:
    from collections.abc import Sequence

RESOURCES = Path(__file__).parents[3] / "resources"


def table() -> dict[str, dict[str, Any]]:
    """The kitchen's links as they were measured, by name."""
    rows = json.loads((RESOURCES / "make" / "kitchen.json").read_text(encoding="utf-8"))["links"]
    return {row["link"]: row for row in rows}


@cache
def kitchen() -> Furniture:
    return furniture_of(load.load("kitchen.urdf"))


def height(name: str) -> float:
    """How high a surface of the closed kitchen is above the floor."""
    surface = kitchen().surfaces[name]
    urdf = load.load("kitchen.urdf").urdf
    return geometry.transform(urdf.forward_kinematics({}, surface.link), surface.position)[2]


def box(name: str, size: str, at: str = "0 0 0") -> str:
    return f'<collision name="{name}"><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision>'


def joint(kind: str, child: str, rest: str, parent: str = "case") -> str:
    return f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{rest}</joint>'


def link(name: str, *shapes: str) -> str:
    return f'<link name="{name}">{"".join(shapes)}</link>'


#: 0.6 m wide, deep and high, on the floor, with a shelf in the middle; x points out of its open front.
CASE = link(
    "case",
    box("bottom", "0.6 0.6 0.02", "0 0 0.01"),
    box("top", "0.6 0.6 0.02", "0 0 0.59"),
    box("left", "0.6 0.02 0.56", "0 0.29 0.3"),
    box("right", "0.6 0.02 0.56", "0 -0.29 0.3"),
    box("back", "0.02 0.56 0.56", "-0.29 0 0.3"),
    box("shelf", "0.5 0.56 0.02", "-0.03 0 0.3"),
)
DOOR_LINKS = (
    link("door", box("leaf", "0.02 0.6 0.58", "0 -0.3 0")),
    link("door_handle", box("bar", "0.02 0.02 0.2")),
    joint(
        "revolute",
        "door",
        '<origin xyz="0.312 0.3 0.3"/><axis xyz="0 0 1"/><limit lower="0" upper="1.5" effort="1" velocity="1"/>',
    ),
    joint("fixed", "door_handle", '<origin xyz="0.05 -0.55 0"/>', parent="door"),
)


def found(folder: Path, *elements: str, corrections: str = "", name: str = "cupboard") -> Furniture:
    file = folder / f"{name}.urdf"
    file.write_text(f'<robot name="{name}">{"".join(elements)}</robot>')
    (folder / f"{name}{SUFFIX}").write_text(corrections)
    return furniture_of(load.load(file))


def names(furniture: Furniture) -> list[str]:
    return sorted(furniture.surfaces)


# --- the kitchen -----------------------------------------------------------------------------------------------------


def test_worktops_and_tables_are_found_at_their_height() -> None:
    heights = {"counter": 0.85, "island": 0.851, "table": 0.725, "hob": 0.856, "draining board": 0.856}
    assert {name: round(height(name), 3) for name in heights} == heights
    rows = table()
    tops = {"counter": "sink_area_surface", "island": "kitchen_island_surface"}
    for name, top in tops.items():
        assert kitchen().surfaces[name].link == top
        size = rows[top]["box"]["size"]
        assert max(kitchen().surfaces[name].size) <= max(size[:2])
        assert kitchen().surfaces[name].clearance == math.inf


def test_parts_that_stand_on_a_surface_are_left_out() -> None:
    # 0.8 m of the island's 2.45 are the hob's and what is beside it; the basin is a hole in the counter
    assert kitchen().surfaces["island"].size == pytest.approx((0.8, 1.705), abs=1e-3)
    assert kitchen().surfaces["counter"].size == pytest.approx((0.553, 1.063), abs=1e-3)
    assert height("basin") == pytest.approx(0.85 - 0.177, abs=2e-3)


def test_each_drawer_is_found_with_its_joint_its_handle_and_its_bottom() -> None:
    sliding = {row["joint"]: row for row in table().values() if row.get("type") == "prismatic"}
    drawers = {each.joint: each for each in kitchen().containers.values() if each.kind == DRAWER}
    assert drawers.keys() == sliding.keys()
    for joint_name, drawer in drawers.items():
        row = sliding[joint_name]
        assert (drawer.link, drawer.closed, drawer.open) == (row["link"], 0.0, row["limits"][1])
        assert drawer.handle == row["link"].replace("_main", "_handle")
        assert drawer.surfaces


@pytest.mark.parametrize(
    ("drawer", "bottom", "free"),
    [
        ("sink left upper drawer", 0.704, 0.126),
        ("island middle lower drawer", 0.12, 0.28),
        ("sink trash drawer", 0.124, 0.542),
    ],
)
def test_drawers_have_a_bottom_and_room_for_their_contents(drawer: str, bottom: float, free: float) -> None:
    assert kitchen().containers[drawer].surfaces == (drawer,)
    assert height(drawer) == pytest.approx(bottom, abs=1e-3)
    assert kitchen().surfaces[drawer].clearance == pytest.approx(free, abs=1e-3)


def test_doors_are_found_by_the_surfaces_that_they_hide() -> None:
    doors = {name: each for name, each in kitchen().containers.items() if each.kind == DOOR}
    assert {name: (door.link, door.handle) for name, door in doors.items()} == {
        "fridge": ("iai_fridge_door", "iai_fridge_door_handle"),
        "oven": ("oven_area_oven_door", "oven_area_oven_door_handle"),
        "dish washer": ("sink_area_dish_washer_door", "sink_area_dish_washer_door_handle"),
    }
    shelves, racks = doors["fridge"].surfaces[:4], doors["fridge"].surfaces[4:]
    assert [round(height(shelf), 3) for shelf in shelves] == [0.51, 0.768, 0.998, 1.228]
    assert {kitchen().surfaces[rack].link for rack in racks} == {"iai_fridge_door"}
    assert doors["oven"].surfaces == ("oven floor", "oven rack")


def test_nothing_else_is_found_in_the_kitchen() -> None:
    open_ones = [surface for surface in kitchen().surfaces.values() if not surface.container]
    assert {surface.link for surface in open_ones} == {
        "sink_area", "sink_area_surface", "sink_area_sink", "oven_area_area", "kitchen_island_surface",
        "kitchen_island_stove", "fridge_area", "table_area_main",
    }  # fmt: skip
    assert len(kitchen().surfaces) == 43
    assert not any("wall" in surface.link or "handle" in surface.link for surface in kitchen().surfaces.values())


@pytest.mark.slow
def test_objects_stand_on_every_open_surface_of_the_kitchen() -> None:
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.81])
        body = Object("kitchen", "environment", "kitchen.urdf", world=world)
        for surface in body.surfaces.values():
            if surface.clearance < math.inf or surface.container:
                continue
            x, y, z = body.surface_pose(surface)[0]
            milk = Object("milk", "milk", "milk.stl", [x, y, z + 0.11], world=world)
            world.simulate(0.5)
            low, _ = milk.get_AABB()
            assert low[2] == pytest.approx(z, abs=5e-3), surface.name
            milk.remove()


# --- objects ---------------------------------------------------------------------------------------------------------


def test_a_surface_moves_with_its_drawer() -> None:
    with BulletWorld() as world:
        body = Object("kitchen", "environment", "kitchen.urdf", [1, 2, 0], world=world)
        drawer = body.container("sink left upper drawer")
        closed = body.surface_pose(drawer.surfaces[0])[0]
        body.set_joint_position(drawer.joint, drawer.open)
        opened = body.surface_pose(drawer.surfaces[0])[0]
        assert closed == pytest.approx((1 + 1.524, 2 + 0.89, 0.704), abs=1e-3)
        assert opened == pytest.approx((closed[0] - 0.48, closed[1], closed[2]), abs=1e-3)


def test_unknown_names_are_rejected_with_the_nearest_name() -> None:
    with BulletWorld() as world:
        body = Object("kitchen", "environment", "kitchen.urdf", world=world)
        with pytest.raises(UnknownName, match="did you mean island") as refused:
            body.surface("iland")
        assert refused.value.kind == "surface"
        with pytest.raises(UnknownName, match="did you mean fridge"):
            body.container("frige")


def test_the_floor_and_household_objects_are_not_furniture() -> None:
    with BulletWorld() as world:
        for thing in ("plane.urdf", "milk.stl", "spoon.stl"):
            body = Object(thing, "thing", thing, [0, 0, 1], world=world)
            assert (dict(body.surfaces), dict(body.containers)) == ({}, {})
            body.remove()


@pytest.mark.slow
def test_a_published_kitchen_has_its_worktops_and_drawers(tmp_path: Path) -> None:
    furniture = furniture_of(load.load(write_row(tmp_path, "kitchen_0", 0)))
    assert len(furniture.containers) == 2 * CABINETS
    for number in range(CABINETS):
        for drawer in (0, 1):
            container = furniture.containers[f"cabinet {number} drawer {drawer}"]
            assert container.handle == f"cabinet_{number}_drawer_{drawer}_handle"
            (inside,) = container.surfaces
            assert furniture.surfaces[inside].link == f"cabinet_{number}_drawer_{drawer}_floor"
        assert furniture.surfaces[f"cabinet {number} worktop"].position[2] + TOP - 0.02 == pytest.approx(TOP)
    # worktops before and beside jar and board, open shelves, drawers; nothing below and behind the drawers
    assert {surface.link.split("_", 2)[2] for surface in furniture.surfaces.values()} == {
        "worktop", "wall_bottom", "drawer_0_floor", "drawer_1_floor",
    }  # fmt: skip


# --- rules -----------------------------------------------------------------------------------------------------------


def test_a_face_that_nothing_makes_accessible_is_no_surface(tmp_path: Path) -> None:
    plate = link("plate", box("plate", "0.02 0.6 0.58"))
    fixed = joint("fixed", "plate", '<origin xyz="0.312 0 0.3"/>')
    assert names(found(tmp_path, CASE, plate, fixed)) == ["case"]


def test_shelves_of_an_open_case_are_in_no_container(tmp_path: Path) -> None:
    furniture = found(tmp_path, CASE)
    assert names(furniture) == ["case", "case 2", "case 3"]
    assert not furniture.containers
    assert furniture.surfaces["case"].clearance == math.inf
    assert furniture.surfaces["case 2"].clearance == pytest.approx(0.27)


def test_a_door_in_front_of_a_case_makes_it_a_container(tmp_path: Path) -> None:
    furniture = found(tmp_path, CASE, *DOOR_LINKS)
    (container,) = furniture.containers.values()
    assert (container.kind, container.link, container.handle) == (DOOR, "door", "door_handle")
    assert sorted(furniture.surfaces[name].position[2] for name in container.surfaces) == pytest.approx([0.02, 0.31])


def test_a_solid_drawer_opens_but_has_no_inside(tmp_path: Path) -> None:
    limit = '<limit lower="0" upper="0.4" effort="1" velocity="1"/>'
    furniture = found(
        tmp_path,
        CASE,
        link("drawer", box("block", "0.5 0.5 0.24")),
        link("grip", box("bar", "0.02 0.2 0.02")),
        joint("prismatic", "drawer", f'<origin xyz="0 0 0.15"/>{limit}'),
        joint("fixed", "grip", '<origin xyz="0.27 0 0"/>', parent="drawer"),
    )
    (drawer,) = furniture.containers.values()
    assert (drawer.kind, drawer.joint, drawer.handle, drawer.surfaces) == (DRAWER, "drawer_joint", "grip", ())
    assert "drawer" not in {surface.link for surface in furniture.surfaces.values()}


def test_a_sliding_door_is_not_a_drawer(tmp_path: Path) -> None:
    limit = '<limit lower="0" upper="0.5" effort="1" velocity="1"/>'
    furniture = found(
        tmp_path,
        CASE,
        link("slider", box("leaf", "0.02 0.6 0.58")),
        link("slider_handle", box("bar", "0.02 0.02 0.2")),
        joint("prismatic", "slider", f'<origin xyz="0.312 0 0.3"/><axis xyz="0 1 0"/>{limit}'),
        joint("fixed", "slider_handle", '<origin xyz="0.03 0.2 0"/>', parent="slider"),
    )
    (slider,) = furniture.containers.values()
    assert (slider.kind, slider.handle, len(slider.surfaces)) == (DOOR, "slider_handle", 2)


def test_a_button_and_a_lift_are_not_drawers(tmp_path: Path) -> None:
    limit = '<limit lower="0" upper="0.3" effort="1" velocity="1"/>'
    top = link("top", box("top", "0.6 0.6 0.02"))
    lift = joint("prismatic", "top", f'<origin xyz="0 0 0.7"/><axis xyz="0 0 1"/>{limit}')
    assert not found(tmp_path, CASE, top, lift).containers


def test_a_round_table_keeps_its_shape(tmp_path: Path) -> None:
    top = '<collision><origin xyz="0 0 0.7"/><geometry><cylinder radius="0.4" length="0.04"/></geometry></collision>'
    (surface,) = found(tmp_path, link("table_top", top), name="stand").surfaces.values()
    assert surface.name == "table top"
    assert surface.size == pytest.approx((0.8, 0.8), abs=0.01)
    assert len(surface.outline) > 8
    assert all(math.hypot(*corner) == pytest.approx(0.4, abs=1e-3) for corner in surface.outline)


def test_a_turned_table_has_a_turned_frame(tmp_path: Path) -> None:
    top = '<collision><origin xyz="0 0 0.7" rpy="0 0 0.3"/><geometry><box size="1 0.5 0.04"/></geometry></collision>'
    (surface,) = found(tmp_path, link("desk", top), name="stand").surfaces.values()
    assert surface.size == pytest.approx((1.0, 0.5), abs=1e-3)
    assert geometry.to_rpy(surface.orientation)[2] == pytest.approx(0.3, abs=1e-3)


def test_slopes_edges_and_gaps_are_not_surfaces(tmp_path: Path) -> None:
    slope = '<collision><origin xyz="0 0 0.7" rpy="0 0.2 0"/><geometry><box size="1 0.5 0.04"/></geometry></collision>'
    wall = box("wall", "2 0.1 1", "0 2 0.5")
    rail = box("rail", "1 0.04 0.04", "0 1 0.5")
    low = box("low", "0.5 0.5 0.1", "3 0 0.05") + box("lid", "0.5 0.5 0.1", "3 0 0.19")
    assert names(found(tmp_path, link("parts", slope, wall, rail, low))) == ["parts"]  # the lid's top


# --- corrections -----------------------------------------------------------------------------------------------------


def test_a_toml_next_to_the_urdf_renames_corrects_adds_and_removes(tmp_path: Path) -> None:
    furniture = found(
        tmp_path,
        CASE,
        *DOOR_LINKS,
        corrections="""
            [surfaces.case]
            name = "top"
            clearance = 0.5
            [surfaces."case 2"]
            remove = true
            [surfaces.hook]
            link = "door"
            position = [0.05, -0.3, 0]
            size = [0.06, 0.1]
            container = "larder"
            [containers.door]
            name = "larder"
            open = 1.2
            [containers.hatch]
            joint = "door_joint"
            kind = "door"
        """,
    )
    assert names(furniture) == ["case 3", "hook", "top"]
    assert furniture.surfaces["top"].clearance == 0.5
    assert furniture.surfaces["hook"].size == pytest.approx((0.06, 0.1))
    assert furniture.containers["larder"].surfaces == ("case 3", "hook")
    assert furniture.containers["larder"].open == 1.2
    assert furniture.containers["hatch"].surfaces == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("surfaces = 3", "surfaces: takes tables"),
        ("[surface.case]", "surface: unknown entry; known entries are surfaces and containers"),
        ("[surfaces.case]\nnam = 'top'", r"surfaces.'case'.nam: unknown entry; did you mean name"),
        ("[surfaces.case]\nlink = 'cose'", r"surfaces.'case'.link: no link 'cose'; did you mean case"),
        ("[containers.door]\njoint = 'dor_joint'", "no movable joint 'dor_joint'; did you mean door_joint"),
        ("[containers.door]\nhandle = 'handel'", "no link 'handel'; there are case, door, door_handle"),
        ("[surfaces.case]\nclearance = -1", "clearance"),
        ("[surfaces.case]\noutline = [[0, 0], [0, 1], [1, 1]]", "counter-clockwise"),
        ("[surfaces.case]\nsize = [0, 1]", "above 0 m"),
        ("[surfaces.case]\nsize = [1, 1]\noutline = [[0, 0], [1, 0], [1, 1]]", "give either size or outline, not both"),
        ("[containers.door]\nkind = 'lid'", "one of drawer, door"),
        ("[surfaces", "is not TOML"),
    ],
)
def test_wrong_corrections_are_rejected_when_the_model_is_loaded(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "cupboard.urdf"
    file.write_text(f'<robot name="cupboard">{CASE}{"".join(DOOR_LINKS)}</robot>')
    file.with_name(f"cupboard{SUFFIX}").write_text(text)
    with pytest.raises(AssetError, match=message) as refused:
        load.load(file)
    assert refused.value.path.endswith(f"cupboard{SUFFIX}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[surfaces.cas]\nname = 'top'", "no surface of that name was found; did you mean case"),
        ("[surfaces.case]\nname = 'case 2'", "two surfaces have that name"),
        ("[surfaces.case]\ncontainer = 'cellar'", "no container 'cellar'"),
        (
            "[containers.larder]\njoint = 'door_joint'\nkind = 'door'\nopen = 3",
            "open is 3, outside the limits of door_joint",
        ),
    ],
)
def test_corrections_of_unknown_names_are_rejected_when_furniture_is_found(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(AssetError, match=message):
        found(tmp_path, CASE, *DOOR_LINKS, corrections=text)


def test_a_model_restored_from_a_recording_has_the_same_furniture() -> None:
    model = load.load("kitchen.urdf")
    files: Sequence[tuple[str, bytes]] = [(file.key, file.content) for file in model.files]
    restored = load.restore(files, model.loading)
    assert furniture_of(restored) == kitchen()
    forged = [*files[:-1], (files[-1][0], files[-1][1] + b"[")]
    with pytest.raises(AssetError, match="the name of the file doesn't match its content"):
        load.restore(forged, model.loading)


def test_lines_hit_the_pieces_in_their_way_as_if_all_planes_were_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = load.load(write_row(tmp_path, "row", 3))  # jars, handles and hooks with hundreds of planes
    every = level_faces.pieces(row.path, row.urdf.link_poses({}))
    random = np.random.default_rng(1)
    corners = np.concatenate([piece.corners for piece in every])
    origins = random.uniform(corners.min(axis=0), corners.max(axis=0), (160, 3))
    origins[:80] = random.choice(corners, 80)  # along edges and sides, too
    directions = random.normal(size=(160, 3))
    directions[::2, 2] = 0.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = level_faces.vertical_extents(every, origins[:, :2]), level_faces.first_met(every, origins, directions)
    monkeypatch.setattr(level_faces, "_SIMPLE", np.inf)
    slowly = level_faces.vertical_extents(every, origins[:, :2]), level_faces.first_met(every, origins, directions)
    for each, other in zip(found, slowly, strict=True):
        assert all(np.array_equal(*pair) for pair in zip(each, other, strict=True))
    assert np.isfinite(found[0][0]).sum() > 200
