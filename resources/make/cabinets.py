"""Cabinets: the fixed bodies of the kitchen and their doors, each in the frame of its link.

The front edges of partitions next to a tilting door are set back, because the lower edge of the door swings inwards.
"""

from __future__ import annotations

from make.furniture import rack
from make.urdf import Shape, span


def sink_area() -> list[Shape]:
    """Body of the long counter, and the part of the worktop outside the surface link; the basin hangs in a hole."""
    depth, tall = (-0.266, 0.238), (-0.327, 0.418)
    return [
        span((-0.290, 0.288), (-1.026, -1.002), (-0.410, 0.418), "front"),
        span((-0.290, 0.288), (1.002, 1.026), (-0.410, 0.418), "front"),
        span((-0.290, -0.266), (-1.002, 1.002), (-0.410, 0.418), "carcass"),
        span(depth, (-1.002, 1.002), (-0.337, -0.327), "carcass"),
        span((0.200, 0.215), (-1.002, 1.002), (-0.410, -0.337), "plinth"),
        span(depth, (-0.209, -0.191), tall, "carcass"),
        span(depth, (0.391, 0.409), tall, "carcass"),
        span((-0.2875, 0.2875), (0.880, 1.026), (0.420, 0.440), "worktop"),
        span((0.205, 0.2875), (0.575, 0.880), (0.420, 0.440), "worktop"),
        span((-0.2875, -0.195), (0.575, 0.880), (0.420, 0.440), "worktop"),
    ]


def sink_area_surface() -> list[Shape]:
    """The worktop, 1.6 m long, with a hole for the basin."""
    z = (-0.010, 0.010)
    return [
        span((-0.2875, 0.2875), (-1.025, 0.430), z, "worktop"),
        span((0.205, 0.2875), (0.430, 0.575), z, "worktop"),
        span((-0.2875, -0.195), (0.430, 0.575), z, "worktop"),
    ]


def sink() -> list[Shape]:
    """Basin, draining board and tap of steel."""
    rim, deep = (-0.0014, 0.0046), (-0.1850, -0.0014)
    ridges = [
        span((-0.17, 0.17), (-0.385 + 0.05 * k, -0.365 + 0.05 * k), (0.0046, 0.0066), "dark_steel", solid=False)
        for k in range(6)
    ]
    return [
        span((-0.252, 0.252), (-0.432, -0.034), rim, "steel"),
        span((-0.252, 0.252), (0.404, 0.432), rim, "steel"),
        span((0.194, 0.252), (-0.034, 0.404), rim, "steel"),
        span((-0.252, -0.194), (-0.034, 0.404), rim, "steel"),
        span((-0.198, 0.198), (-0.038, 0.408), (-0.1850, -0.1780), "steel"),
        span((0.192, 0.198), (-0.038, 0.408), deep, "steel"),
        span((-0.198, -0.192), (-0.038, 0.408), deep, "steel"),
        span((-0.192, 0.192), (-0.038, -0.032), deep, "steel"),
        span((-0.192, 0.192), (0.402, 0.408), deep, "steel"),
        span((-0.240, -0.210), (0.170, 0.200), (0.0046, 0.230), "steel", round_about="z"),
        span((-0.240, -0.050), (0.174, 0.196), (0.220, 0.242), "steel", round_about="x"),
        span((-0.070, -0.050), (0.175, 0.195), (0.195, 0.225), "steel", solid=False, round_about="z"),
        span((-0.030, 0.030), (0.155, 0.215), (-0.178, -0.1765), "dark_steel", solid=False, round_about="z"),
        *ridges,
    ]


def dish_washer() -> list[Shape]:
    """A tub that is open in front, with two racks."""
    x = (-0.272, 0.222)
    return [
        span(x, (-0.2535, 0.2535), (-0.333, -0.265), "steel"),
        span(x, (-0.2535, 0.2535), (0.317, 0.337), "steel"),
        span(x, (-0.2535, -0.2400), (-0.265, 0.317), "steel"),
        span(x, (0.2400, 0.2535), (-0.265, 0.317), "steel"),
        span((-0.272, -0.258), (-0.2400, 0.2400), (-0.265, 0.317), "steel"),
        *rack((-0.24, 0.215), 0.23, -0.200, 0.10),
        *rack((-0.24, 0.215), 0.23, 0.060, 0.08),
    ]


def dish_washer_door() -> list[Shape]:
    """A door that tilts about its lower edge; the y axis of the frame points down, the x axis into the room."""
    return [
        span((-0.011, 0.011), (-0.684, 0.034), (-0.2985, 0.2985), "front"),
        span((-0.0125, -0.011), (-0.640, -0.020), (-0.230, 0.230), "steel", solid=False),
    ]


def oven_area() -> list[Shape]:
    """A tall cabinet with the oven above two drawers, between two pull-outs."""
    depth, tall = (-0.275, 0.225), (-0.625, 0.735)
    return [
        span((-0.290, 0.255), (-0.603, -0.592), (-0.755, 0.735), "front"),
        span((-0.290, 0.255), (0.592, 0.603), (-0.755, 0.735), "front"),
        span((-0.290, -0.275), (-0.592, 0.592), (-0.755, 0.735), "carcass"),
        span((-0.290, 0.288), (-0.603, 0.603), (0.735, 0.758), "front"),
        span((-0.275, 0.255), (-0.592, 0.592), (-0.640, -0.625), "carcass"),
        span((0.200, 0.215), (-0.592, 0.592), (-0.755, -0.640), "plinth"),
        span(depth, (-0.288, -0.276), tall, "carcass"),
        span(depth, (0.276, 0.288), tall, "carcass"),
    ]


def oven() -> list[Shape]:
    """A dark cavity that is open in front, with a rack."""
    side = (-0.270, 0.222)
    return [
        span(side, (-0.2535, 0.2535), (-0.290, -0.215), "enamel"),
        span((-0.270, 0.250), (-0.2535, 0.2535), (0.185, 0.300), "enamel"),
        span(side, (-0.2535, -0.2350), (-0.215, 0.185), "enamel"),
        span(side, (0.2350, 0.2535), (-0.215, 0.185), "enamel"),
        span((-0.270, -0.250), (-0.2350, 0.2350), (-0.215, 0.185), "enamel"),
        *rack((-0.245, 0.215), 0.230, -0.050, 0.0),
    ]


def oven_door() -> list[Shape]:
    """A steel frame with a window of dark glass; the y axis of the frame points down, the x axis outwards."""
    return [
        span((-0.0147, 0.0062), (-0.449, 0.035), (-0.2975, 0.2975), "steel"),
        span((0.0062, 0.0067), (-0.355, -0.045), (-0.2350, 0.2350), "glass", solid=False),
        span((-0.0152, -0.0147), (-0.355, -0.045), (-0.2250, 0.2250), "glass", solid=False),
    ]


def oven_panel() -> list[Shape]:
    """The panel above the oven's door, with a clock between the knobs."""
    return [
        span((-0.0105, 0.0105), (-0.2975, 0.2975), (-0.051, 0.0625), "steel"),
        span((0.0105, 0.0109), (0.045, 0.115), (-0.015, 0.025), "glass", solid=False),
        span((0.0109, 0.0112), (0.052, 0.108), (-0.004, 0.014), "display", solid=False),
    ]


def kitchen_island() -> list[Shape]:
    """Body under the top of the island; the top is wider on all sides."""
    return [
        span((-0.300, 0.283), (-1.130, -1.103), (-0.421, 0.409), "island_front"),
        span((-0.300, 0.283), (1.103, 1.130), (-0.421, 0.409), "island_front"),
        span((-0.300, -0.285), (-1.103, 1.103), (-0.421, 0.409), "island_front"),
        span((-0.285, 0.258), (-1.103, 1.103), (-0.340, -0.325), "carcass"),
        span((0.200, 0.215), (-1.103, 1.103), (-0.421, -0.340), "plinth"),
        span((-0.285, 0.258), (-0.509, -0.491), (-0.325, 0.409), "carcass"),
        span((-0.285, 0.258), (0.491, 0.509), (-0.325, 0.409), "carcass"),
    ]


def stove() -> list[Shape]:
    """A flat glass hob with four rings."""
    rings = [
        span((x - r, x + r), (y - r, y + r), (0.0035, 0.0042), "ring", solid=False, round_about="z")
        for x, y, r in ((0.12, 0.14, 0.075), (0.12, -0.14, 0.095), (-0.12, 0.14, 0.095), (-0.12, -0.14, 0.075))
    ]
    discs = [
        span((x - r, x + r), (y - r, y + r), (0.0042, 0.0047), "glass", solid=False, round_about="z")
        for x, y, r in ((0.12, 0.14, 0.067), (0.12, -0.14, 0.087), (-0.12, 0.14, 0.087), (-0.12, -0.14, 0.067))
    ]
    return [span((-0.251, 0.251), (-0.286, 0.286), (-0.0035, 0.0035), "glass"), *rings, *discs]


def fridge_area() -> list[Shape]:
    """A tall cabinet: the fridge above one drawer."""
    return [
        span((-0.290, 0.255), (-0.2995, -0.2850), (-0.740, 0.740), "front"),
        span((-0.290, 0.255), (0.2850, 0.2995), (-0.740, 0.740), "front"),
        span((-0.290, -0.266), (-0.2850, 0.2850), (-0.740, 0.740), "carcass"),
        span((-0.290, 0.288), (-0.2995, 0.2995), (0.740, 0.770), "front"),
        span((-0.266, 0.250), (-0.2850, 0.2850), (-0.585, -0.570), "carcass"),
        span((0.200, 0.215), (-0.2850, 0.2850), (-0.740, -0.585), "plinth"),
        span((-0.266, 0.250), (-0.2850, 0.2850), (-0.268, -0.253), "carcass"),
        span((0.258, 0.281), (-0.2985, 0.2985), (-0.270, -0.2425), "front"),
    ]


def fridge() -> list[Shape]:
    """A white cavity that is open in front, with three shelves."""
    x = (-0.252, 0.240)
    shelves = [span((-0.235, 0.185), (-0.262, 0.262), (z, z + 0.008), "fridge_glass") for z in (0.02, 0.25, 0.48)]
    return [
        span(x, (-0.282, 0.282), (-0.250, -0.230), "fridge_white"),
        span(x, (-0.282, 0.282), (0.715, 0.735), "fridge_white"),
        span(x, (-0.282, -0.262), (-0.230, 0.715), "fridge_white"),
        span(x, (0.262, 0.282), (-0.230, 0.715), "fridge_white"),
        span((-0.252, -0.235), (-0.262, 0.262), (-0.230, 0.715), "fridge_white"),
        *shelves,
    ]


def fridge_door() -> list[Shape]:
    """A door that turns about its left edge, with two racks for bottles inside; the panel extends along -y."""
    panel = span((-0.0225, -0.0025), (-0.5975, -0.0030), (-0.4835, 0.4835), "front")
    racks = []
    for z in (-0.40, 0.05):
        racks += [
            span((-0.095, -0.0225), (-0.530, -0.090), (z, z + 0.008), "fridge_white"),
            span((-0.095, -0.087), (-0.530, -0.090), (z + 0.008, z + 0.070), "fridge_glass"),
        ]
    return [panel, *racks]


def table() -> list[Shape]:
    """A table for six, 0.725 m high."""
    top = span((-0.802, 0.802), (-0.402, 0.402), (0.690, 0.725), "table_wood")
    legs = [
        span((x - 0.035, x + 0.035), (y - 0.035, y + 0.035), (0.0, 0.690), "table_wood")
        for x in (-0.74, 0.74)
        for y in (-0.34, 0.34)
    ]
    rail = (0.610, 0.690)
    rails = [span((-0.705, 0.705), (y - 0.012, y + 0.012), rail, "table_wood", solid=False) for y in (-0.34, 0.34)]
    rails += [span((x - 0.012, x + 0.012), (-0.305, 0.305), rail, "table_wood", solid=False) for x in (-0.74, 0.74)]
    return [top, *legs, *rails]
