"""Common names of the kitchen's surfaces and containers, by the names that PyCRAM finds in the links."""

from __future__ import annotations

SURFACES = {
    "sink": "counter",
    "sink 2": "draining board",
    "sink 3": "basin",
    "sink 4": "counter beside the sink",
    "island 2": "island beside the hob",
    "island 3": "island behind the hob",
    "island 4": "island before the hob",
    "island stove": "hob",
    "sink dish washer": None,  # its floor: the lower rack leaves no room
    "sink dish washer 2": "dish washer lower rack",
    "sink dish washer 3": "dish washer upper rack",
    "oven": "top of the oven tower",
    "oven 2": "oven floor",
    "oven 3": "oven rack",
    "drawer oven right board 0": "oven right drawer",
    "drawer oven right board 1": "oven right drawer 2",
    "drawer oven right board 2": "oven right drawer 3",
    "drawer oven right board 3": "oven right drawer 4",
    "fridge": "top of the fridge",
    "iai fridge": "fridge shelf 1",
    "iai fridge 2": "fridge shelf 2",
    "iai fridge 3": "fridge shelf 3",
    "iai fridge 4": "fridge shelf 4",
    "iai fridge door": "fridge door rack 1",
    "iai fridge door 2": "fridge door rack 2",
}
CONTAINERS = {"iai fridge": "fridge", "sink dish washer": "dish washer"}


def kitchen_names() -> str:
    """The TOML with the common names; other surfaces and containers keep the found names."""
    lines = ["# Written by make_resources.py: what kitchen.urdf's surfaces and containers are called."]
    for kind, names in (("surfaces", SURFACES), ("containers", CONTAINERS)):
        for found, name in names.items():
            lines += ["", f'[{kind}."{found}"]', "remove = true" if name is None else f'name = "{name}"']
    return "\n".join(lines) + "\n"
