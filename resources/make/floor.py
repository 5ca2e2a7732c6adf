"""The floor: a slab of 30 x 30 m whose upper side is z = 0, with visible joints between tiles that don't collide."""

from __future__ import annotations

from make.urdf import Link, Material, document, span

MATERIALS = {
    "tile": Material((0.78, 0.76, 0.72), 2000.0),
    "joint": Material((0.66, 0.64, 0.60), 2000.0),
}

HALF = 15.0
TILED = 6
"""Tiles are drawn as far as this many metres from the origin, one metre wide."""


def floor() -> str:
    """The URDF of the floor with its one link ``floor``."""
    slab = span((-HALF, HALF), (-HALF, HALF), (-0.1, 0.0), "tile")
    reach, line, height = (-float(TILED), float(TILED)), 0.005, (0.0, 0.0006)
    joints = []
    for k in range(-TILED, TILED + 1):
        beside = (k - line, k + line)
        joints.append(span(beside, reach, height, "joint", solid=False))
        joints.append(span(reach, beside, height, "joint", solid=False))
    return document(
        "floor", [Link("floor", (slab, *joints))], MATERIALS, "Written by make_resources.py. Metres, kilograms."
    )
