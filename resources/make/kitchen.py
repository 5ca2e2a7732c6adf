"""The kitchen: frames and joints from the table of numbers in ``kitchen.json``, shapes from cabinets and furniture.

The table has the layout, names, joints and sizes of a real laboratory kitchen; its ``note`` explains the differences.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from make import cabinets
from make.furniture import MATERIALS, drawer, handle, knob, panel, tall_drawer
from make.urdf import Joint, Link, Shape, document, span

TABLE = Path(__file__).with_name("kitchen.json")


def kitchen() -> str:
    """The URDF of the kitchen; its root link ``world`` is the origin of the room, on the floor."""
    rows = json.loads(TABLE.read_text(encoding="utf-8"))["links"]
    shapes = _shapes()
    links = [Link(row["link"], tuple(shapes.get(row["link"]) or _as_described(row)), _joint(row)) for row in rows]
    return document("kitchen", links, MATERIALS, "Written by make_resources.py. Metres, kilograms, radians.")


def _joint(row: dict[str, Any]) -> Joint | None:
    if "joint" not in row:
        return None
    moves = row["type"] != "fixed"
    return Joint(
        row["joint"],
        row["type"],
        row["parent"],
        tuple(row["xyz"]),
        tuple(row["rpy"]),
        tuple(row["axis"]) if moves else None,
        tuple(row["limits"]) if moves else None,
    )


def _as_described(row: dict[str, Any]) -> list[Shape]:
    """A single box from the table: a wall, or a board of the right pull-out, whose rails clear the other fronts."""
    if "box" not in row:
        return []
    name = str(row["link"])
    if "barrier_right" in name:
        return [span((-0.245, 0.245), (-0.003, 0.010), (-0.025, 0.025), "steel")]
    material = "wall" if "wall" in name else "steel" if "barrier" in name else "drawer_wood"
    return [Shape(tuple(row["box"]["centre"]), tuple(row["box"]["size"]), material)]


def _shapes() -> dict[str, list[Shape]]:
    """The shapes of each link that consists of more than one box."""
    return {
        **_counter(),
        **_oven_tower(),
        **_island(),
        "fridge_area": cabinets.fridge_area(),
        "fridge_area_lower_drawer_main": drawer(0.6, 0.287, -0.262, 0.20),
        "fridge_area_lower_drawer_handle": handle(0.5055),
        "iai_fridge_main": cabinets.fridge(),
        "iai_fridge_door": cabinets.fridge_door(),
        "iai_fridge_door_handle": handle(0.8756, depth=0.0625, upright=True),
        "table_area_main": cabinets.table(),
        "kitchen_wall_5": [span((-1.637, 0.050), (-0.075, 0.075), (0.0, 0.7), "wall")],
        "kitchen_wall_6": [span((0.070, 0.500), (-0.075, 0.075), (0.0, 0.7), "wall")],
    }


def _counter() -> dict[str, list[Shape]]:
    back = -0.272
    return {
        "sink_area": cabinets.sink_area(),
        "sink_area_surface": cabinets.sink_area_surface(),
        "sink_area_sink": cabinets.sink(),
        "sink_area_right_panel": panel(0.6, -0.068, 0.062),
        "sink_area_trash_drawer_main": drawer(0.6, 0.5770, back, 0.42),
        "sink_area_trash_drawer_handle": handle(0.5055),
        "sink_area_left_upper_drawer_main": drawer(0.8, 0.1380, back, 0.09),
        "sink_area_left_middle_drawer_main": drawer(0.8, 0.2870, back, 0.20),
        "sink_area_left_bottom_drawer_main": drawer(0.8, 0.2870, back, 0.20),
        "sink_area_left_upper_drawer_handle": handle(0.7056),
        "sink_area_left_middle_drawer_handle": handle(0.7056),
        "sink_area_left_bottom_drawer_handle": handle(0.7056),
        "sink_area_dish_washer_main": cabinets.dish_washer(),
        "sink_area_dish_washer_door": cabinets.dish_washer_door(),
        "sink_area_dish_washer_door_handle": handle(0.5055),
    }


def _oven_tower() -> dict[str, list[Shape]]:
    back = -0.270
    knobs = ("stove_1", "stove_2", "stove_3", "stove_4", "oven")
    return {
        "oven_area_area": cabinets.oven_area(),
        "oven_area_oven_main": cabinets.oven(),
        "oven_area_oven_door": cabinets.oven_door(),
        "oven_area_oven_door_handle": handle(0.5055, depth=0.05256),
        "oven_area_oven_panel": cabinets.oven_panel(),
        **{f"oven_area_oven_knob_{name}": knob() for name in knobs},
        "oven_area_area_middle_upper_drawer_main": drawer(0.6, 0.1350, back, 0.09),
        "oven_area_area_middle_upper_drawer_handle": handle(0.5055),
        "oven_area_area_middle_lower_drawer_main": drawer(0.6, 0.5770, back, 0.42),
        "oven_area_area_middle_lower_drawer_handle": handle(0.5055),
        "oven_area_area_left_drawer_main": tall_drawer(),
        "oven_area_area_left_drawer_handle": handle(1.2354, depth=0.0635, upright=True),
        "oven_area_area_right_drawer_main": [span((-0.255, -0.245), (-0.130, 0.130), (-0.660, 0.450), "drawer_wood")],
        "drawer_oven_right_front_link": [span((-0.0125, 0.0125), (-0.138, 0.148), (-0.665, 0.665), "front")],
        "oven_area_area_right_drawer_handle": handle(1.24, depth=0.0375, upright=True),
    }


def _island() -> dict[str, list[Shape]]:
    links = {
        "kitchen_island": cabinets.kitchen_island(),
        "kitchen_island_surface": [span((-0.4, 0.4), (-1.225, 1.225), (-0.010, 0.010), "worktop")],
        "kitchen_island_stove": cabinets.stove(),
    }
    for place, width, bar in (("left", 0.6, 0.5055), ("middle", 1.0, 0.9107), ("right", 0.6, 0.5055)):
        links[f"kitchen_island_{place}_panel"] = panel(width, -0.066, 0.068, "island_front")
        for level in ("upper", "lower"):
            links[f"kitchen_island_{place}_{level}_drawer_main"] = drawer(width, 0.287, -0.275, 0.20, "island_front")
            links[f"kitchen_island_{place}_{level}_drawer_handle"] = handle(bar)
    return links
