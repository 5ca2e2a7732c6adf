"""The floor: a slab whose upper side is z = 0, with visible joints between tiles that don't collide.

The slab extends 1 km from the origin. On wider boxes, PyBullet's contacts are less exact: on a box of 5 km, some
resting objects tremble for longer; on a box of 1,000 km, some lie 0.5 mm too high. Only the middle is visible and has
a mass, because viewers fit their view to visible shapes.
"""

from __future__ import annotations

from dataclasses import replace

from make.urdf import Link, Material, document, span

MATERIALS = {
    "tile": Material((0.78, 0.76, 0.72), 2000.0),
    "joint": Material((0.66, 0.64, 0.60), 2000.0),
}

HALF = 15.0  # half the width of the visible middle, metres
WIDTH = 2_000.0  # width of the whole slab, metres
TILED = 6  # distance from the origin in metres up to which tiles are visible; a tile is one metre wide


def floor() -> str:
    """The URDF of the floor with its one link ``floor``."""
    middle = span((-HALF, HALF), (-HALF, HALF), (-0.1, 0.0), "tile")
    slab = replace(middle, collides=(WIDTH, WIDTH, 0.1))
    reach, line, height = (-float(TILED), float(TILED)), 0.005, (0.0, 0.0006)
    joints = []
    for k in range(-TILED, TILED + 1):
        beside = (k - line, k + line)
        joints.append(span(beside, reach, height, "joint", solid=False))
        joints.append(span(reach, beside, height, "joint", solid=False))
    return document(
        "floor", [Link("floor", (slab, *joints))], MATERIALS, "Written by make_resources.py. Metres, kilograms."
    )
